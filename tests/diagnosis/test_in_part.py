"""An effect that removes most of the error may be added, although something acts beside it that is in no catalogue."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnosis.adding import MOST, add_effects, asked_for
from bms_gateway.diagnosis.core_band import BAND_SD
from bms_gateway.diagnosis.diagnosis import diagnose
from bms_gateway.diagnosis.error_words import UNKNOWN
from bms_gateway.diagnosis.verdict_parts import errors
from tests.diagnosis.hidden_record import record_of
from tests.truth.effects import lagged
from tests.truth.hidden import make_log
from tests.truth.suites import suited, unknowns

LATE_S = 16.0


@cache
def late_log():
    """R_e falls with the temperature, and the thermocouple of cell 5 answers late: log, record, model, verdict."""
    s = suited({"resistance_temperature": "strong"}, 5, 310_001)
    log = make_log(s)
    late = np.interp(log.table["time_s"], np.arange(len(log.surface)), lagged(log.surface[:, 4], LATE_S))
    late += s.noise * np.random.default_rng(1).normal(size=len(late))
    log = replace(log, table={**log.table, "surface_5_C": np.round(late / s.step) * s.step})
    record, model = record_of(log)
    return log, record, model, diagnose(model, [record])


def held(core):
    return errors(core.identified.fit).heldout_rmse_K


def added(record, model, d, key):
    return add_effects(model, [record], asked_for([key], model), ask=lambda *_a, **_k: d)


@pytest.mark.slow
def test_what_removes_most_of_the_error_is_added_with_an_unproven_core():
    log, record, model, d = late_log()
    assert d.verdict == "unknown_effect"
    found = added(record, model, d, "resistance_temperature")
    before, after = found.core
    assert found.in_part
    assert not found.refused
    assert "explains a part only" in found.remark
    assert held(after) <= MOST * held(before)
    assert not after.proven
    assert UNKNOWN in after.why
    assert (after.half_width_K >= 0.999 * before.half_width_K).all()
    (band,) = after.bands
    true = np.stack([np.interp(band.time_s, np.arange(len(log.core)), x) for x in log.core.T], axis=1)
    (first,) = before.bands
    assert np.sqrt(np.mean((band.T_c - true) ** 2)) < 0.5 * np.sqrt(np.mean((first.T_c - true) ** 2))
    assert (np.abs(band.T_c - true) <= BAND_SD * band.total_K).mean() > 0.95


@pytest.mark.slow
def test_what_only_resembles_the_unknown_effect_stays_refused():
    """A load beside the shunt looks like entropic heat, which leaves almost half of the error."""
    (scenario,) = [s for s in unknowns(77) if s.seed == 774_005]
    record, model = record_of(make_log(scenario))
    d = diagnose(model, [record])
    assert d.verdict == "unknown_effect"
    found = added(record, model, d, "entropic_heat")
    before, after = found.core
    assert found.in_part
    assert MOST * held(before) < held(after) < held(before)
    assert "explains a part only" in found.refused
    assert not after.proven
