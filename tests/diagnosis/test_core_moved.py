"""Whether a named effect may be said to make the core better known: it must move it by more than it is known to."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.adding import Wanted, add_effects
from bms_gateway.diagnosis.core_band import core_bands, core_moved
from bms_gateway.diagnosis.core_known import known_core
from bms_gateway.diagnosis.diagnosis import diagnose
from tests.benchmarks.diagnosis_case import core_error
from tests.diagnosis.hidden_record import hidden


@cache
def drift(inlet):
    """One cell whose R_e drifts; with a still inlet the surface ties R_e to R_u, and the core hangs on neither."""
    log, record, model = hidden(
        "resistance_drift", cells=1, sensors=(1,), inlet=inlet, cycle="urban", noise=0.05, seconds=2400, seed=6_100_900
    )
    return log, record, diagnose(model, [record])


@pytest.mark.parametrize("inlet", ["constant", "steps"])
def test_both_inlets_show_the_effect(inlet):
    _, _, d = drift(inlet)
    assert [s.candidate.name for s in d.selected] == ["resistance_drift"]


def test_a_core_that_moves_within_its_band_is_not_called_better_known():
    _, _, d = drift("constant")
    moved, half_width = core_moved(*d.fits)
    assert moved < half_width
    assert "The core is not known better by it" in d.sentence
    assert len(d.alarms) == 1


def test_a_core_that_moves_by_more_is_and_its_error_falls():
    log, record, d = drift("steps")
    moved, half_width = core_moved(*d.fits)
    assert moved > half_width
    assert d.alarms == ()
    assert "not known better" not in d.sentence
    before, after = (core_error(log, record, f) for f in d.fits)
    assert after < before


def test_the_way_it_moves_and_the_band_are_those_of_the_cores():
    _, _, d = drift("steps")
    before, after = d.fits
    moved, half_width = core_moved(before, after)
    apart = after.prediction.X[0][:, 0] - before.prediction.X[0][:, 0]
    assert moved == pytest.approx(np.linalg.norm(apart) / np.sqrt(len(apart)))
    assert half_width == pytest.approx(1.96 * np.sqrt(np.mean(core_bands(after)[0].sd_K ** 2)))


def added(inlet):
    """The drift added to the model, as the diagnosis found it."""
    _, record, d = drift(inlet)
    (selected,) = d.selected
    model = d.search.baseline.problem.model
    return record, add_effects(model, [record], [Wanted(selected.candidate.effect)], ask=lambda *_, **__: d)


def test_the_doubt_of_a_diagnosis_goes_into_the_model_that_add_writes():
    """It was said by `diagnose` only: the model file, and so the bus, knew the core to a third of its error."""
    record, a = added("constant")
    assert not a.refused
    assert any("less than the" in why for why in a.model.doubts)
    assert a.model.doubts == a.core[1].why
    before, after = (core.half_width_K for core in a.core)
    assert (after >= before).all()
    # whoever asks of the file that was written hears the same
    again = known_core(parse_model(format_model(a.model)), [record])
    assert (again.sd_K, again.why) == (a.core[1].sd_K, a.core[1].why)


def test_a_core_that_is_known_better_by_it_is_proven_and_its_band_falls():
    log, _, _ = drift("steps")
    _, a = added("steps")
    assert a.model.doubts == ()
    assert a.core[1].half_width_K < a.core[0].half_width_K
    (band,) = a.core[1].bands
    truth = np.interp(band.time_s, np.arange(len(log.core)), log.core[:, 0])
    assert np.mean(np.abs(truth - band.T_c[:, 0]) <= 2.0 * band.total_K[:, 0]) >= 0.9
