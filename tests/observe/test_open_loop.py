"""The two observers without covariance, and the paper's figures about them."""

import numpy as np
import pytest

from bms_gateway.observe import Disturbance, stack
from bms_gateway.observe.luenberger import Luenberger
from bms_gateway.observe.open_loop import OpenLoop
from bms_gateway.thermal import StringParameters
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4


def run(observer, n, current, y, start):
    state = observer.init(np.append(np.full(2 * n, start), [0.0, 0.0])[None])
    T, cores = np.array([25.0]), []
    for k, i in enumerate(current):
        state = observer.predict(state, np.full((1, n), i**2 * 3.5e-3), T, T)
        state = observer.update(state, y[[k + 1]], np.zeros((1, n)))
        cores.append(state.x[0, 0 : 2 * n : 2])
    return np.array(cores)


def settling(error, limit):
    late = np.flatnonzero(np.abs(error) > limit)
    return 0 if not len(late) else late[-1] + 1


def truth(n, minutes, start):
    current = repeated(minutes)
    core, surface = rk4(TruthString.of(n, R_cc=4.0, C_f=C_F), current, np.full(len(current) + 1, 25.0), start)
    return current, core[1:], surface


def test_open_loop_forgets_a_wrong_start_in_half_an_hour():
    """Fig 9: 0.25 K after 31 to 36 minutes; the first cell forgets soonest."""
    current, core, surface = truth(5, 50, 25.0)
    m = stack([StringParameters.of(5, **TABLE_1, R_cc=4.0, C_f=C_F)], 1.0, Disturbance())
    error = run(OpenLoop(m), 5, current, surface, 32.0) - core
    minutes = [settling(e, 0.25) / 60 for e in error.T]
    assert 29 < min(minutes) < max(minutes) < 38


def test_the_papers_gain_is_hardly_better_and_a_greater_one_is():
    current, core, surface = truth(1, 70, 25.0)
    m = stack([StringParameters.of(1, **TABLE_1)], 1.0, Disturbance())
    cell = np.zeros((1, 1), np.int64)

    def minutes(core_gain, surface_gain):
        L = np.array([core_gain, surface_gain, 0.0, 0.0]).reshape(1, 4, 1)
        return settling((run(Luenberger(m, cell, L), 1, current, surface, 35.0) - core)[:, 0], 1.0) / 60

    none = settling((run(OpenLoop(m), 1, current, surface, 35.0) - core)[:, 0], 1.0) / 60
    assert 0.6 * none < minutes(0.0, 0.01) < none
    assert minutes(0.1, 0.3) < 0.2 * none


def test_luenberger_skips_missing_readings_and_minds_the_age():
    m = stack([StringParameters.of(1, **TABLE_1)], 1.0, Disturbance())
    observer = Luenberger(m, np.zeros((1, 1), np.int64), np.ones((1, 4, 1)))
    state = observer.predict(
        observer.init(np.array([[40.0, 30.0, 0.0, 0.0]])), np.zeros((1, 1)), np.array([25.0]), np.array([25.0])
    )
    assert (observer.update(state, np.array([[np.nan]]), np.zeros((1, 1))).x == state.x).all()
    half_way = (state.x[0, 1] + 30.0) / 2
    same = observer.update(state, np.array([[half_way]]), np.array([[0.5]])).x
    assert same == pytest.approx(state.x, abs=1e-12)
