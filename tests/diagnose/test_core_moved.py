"""Whether a named effect may be said to make the core better known: it must move it by more than it is known to."""

from functools import cache

import numpy as np
import pytest

from bms_gateway.diagnose.core_band import core_bands, core_moved
from bms_gateway.diagnose.diagnosis import diagnose
from tests.benchmarks.diagnosis_case import core_error
from tests.diagnose.hidden_record import hidden


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
