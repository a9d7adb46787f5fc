"""The regime of model error: what averaging keeps, when it is entered, and that it finds what is plain."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.diagnosis.core_band import UNPROVEN, core_bands
from bms_gateway.diagnosis.model_error import ModelError, averaged, first_part
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.search import search
from bms_gateway.diagnosis.second_search import needs_second, second_search
from tests.diagnosis.hidden_record import hidden

ALONE = {"cells": 1, "sensors": (1,), "columns": ("soc",)}


def prepared(*effect, **scenario):
    log, record, model = hidden(*effect, **ALONE, **scenario)
    return log, measured(record, model), model


def test_averaging_keeps_heat_charge_and_readings():
    _, m, _ = prepared(seconds=1800)
    a = averaged(m, ModelError())
    k = a.drive.N * round(a.drive.dt / m.drive.dt)
    for name in ("I", "I2", "T_in"):
        assert getattr(a.drive, name).mean() == pytest.approx(getattr(m.drive, name)[:k].mean(), rel=1e-12)
    before = m.y[(m.row + m.share) < k]
    size = round(a.drive.dt / m.drive.dt)
    assert len(a.y) == pytest.approx(len(before) / size, abs=2)
    assert a.y.mean() == pytest.approx(before.mean(), abs=0.01)
    assert a.used.all()
    # a straight line of readings stays on its line, at the averaged stamps
    line = averaged(replace(m, y=0.01 * (m.row + m.share)), ModelError())
    assert np.allclose(line.y, 0.01 * size * (line.row + line.share), atol=1e-9)


def test_first_part_holds_out_the_end_only():
    _, m, _ = prepared(seconds=1800)
    part = first_part(averaged(m, ModelError()), 0.6)
    at = part.row + part.share
    assert at[part.used].max() < 0.6 * at.max() <= at[~part.used].min()


def test_a_pack_whose_effect_the_first_search_names_needs_no_second():
    _, m, model = prepared("resistance_temperature", "medium", seed=31, seconds=2400)
    found = search(model, [m])
    assert [c.candidate.name for c in found.chosen] == ["resistance_temperature"]
    assert not needs_second(found)


@pytest.mark.slow
def test_the_second_names_a_strong_effect_too_and_bands_the_core():
    log, m, model = prepared("resistance_temperature", "strong", seed=31)
    found = second_search(model, [m])
    assert "resistance_temperature" in {c.candidate.name for c in found.chosen}
    (band,) = core_bands(found.best, share=UNPROVEN)
    true = np.interp(band.time_s, np.arange(len(log.core)), log.core[:, 0])
    assert np.mean(np.abs(band.T_c[:, 0] - true) < 2.0 * band.total_K[:, 0]) >= 0.9


@pytest.mark.slow
def test_the_same_record_gives_the_same_answer_to_the_last_bit():
    _, m, model = prepared("resistance_temperature", "strong", seed=31, seconds=1800)
    one, two = second_search(model, [m]), second_search(model, [m])
    assert one.ranking == two.ranking
    bands = core_bands(one.best)[0], core_bands(two.best)[0]
    assert np.array_equal(bands[0].T_c, bands[1].T_c)
    assert np.array_equal(bands[0].sd_K, bands[1].sd_K)
