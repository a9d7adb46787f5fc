"""The observer with numbers of each cell's own: taken at once, stated in the band, kept over a restart."""

import json

import numpy as np
import pytest

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import Prior, StringModel
from tests.truth.string import C_F, TABLE_1
from tests.truth.unequal import drives

SENSORS = (1, 5)
HOT = np.array([1.0, 4.3 / 3.5, 4.3 / 3.5, 4.3 / 3.5, 1.0])


def model(**priors):
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    made = {k: Prior(v, 0.0) for k, v in values.items()} | priors
    return StringModel(5, SENSORS, "full", made, coolant="ntu")


@pytest.fixture(scope="module")
def pack():
    return drives([3], minutes=40)


def run(observer, d, first, last):
    e = None
    for k in range(first, last):
        y = np.full((1, 5), np.nan)
        y[0, [0, 4]] = d.readings[0, k, [0, 4]]
        e = observer.step(np.array([d.current[k] ** 2]), np.full((1, 5), np.nan), np.array([d.inlet[k + 1]]), y,
                          np.zeros((1, 5)))  # fmt: skip
    return e


def test_unlike_cells_taken_on_the_way_are_where_they_would_always_have_been(pack) -> None:
    """Heat is linear in R_e: the unread cells' rise is scaled at once instead of creeping up for twenty minutes."""
    always = AdaptiveObserver([model(R_e=Prior(3.5e-3 * HOT))], 1.0)
    late = AdaptiveObserver([model()], 1.0)
    truth = run(always, pack, 0, 1500)
    before = run(late, pack, 0, 1500)
    late.set_parameters(0, {"R_e": 3.5e-3 * HOT}, (), np.zeros((0, 0)))
    after = late.estimate()
    was, now = (np.abs(e.core - truth.core)[0, 1:4] for e in (before, after))
    assert was.min() > 2.0
    assert (now < 0.35 * was).all()


def test_the_band_states_what_is_not_known_of_each_cell(pack) -> None:
    observer = AdaptiveObserver([model()], 1.0)
    run(observer, pack, 0, 1500)
    known = observer.estimate().core_sd[0]
    own = np.zeros((5, 3, 3))
    own[2] = 0.1**2 * np.array([[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 0.0]])
    observer.set_parameters(0, {}, (), np.zeros((0, 0)), own)
    stated = observer.estimate()
    assert stated.core_sd[0, 2] > 1.3 * known[2]
    x = stated.core[0, 2]
    assert stated.core_sd[0, 2] < 0.1 * (x - 15.0)
    assert (stated.core_sd[0, [0, 1, 3, 4]] <= known[[0, 1, 3, 4]]).all()


def test_a_correlation_between_heat_and_cooling_counts(pack) -> None:
    """R_e too high and R_u too low leave the surface where it is."""
    sd = []
    for c in (-0.99, 0.99):
        observer = AdaptiveObserver([model()], 1.0)
        run(observer, pack, 0, 1500)
        own = np.zeros((5, 3, 3))
        own[:, :2, :2] = 0.1**2 * np.array([[1.0, c], [c, 1.0]])
        observer.set_parameters(0, {}, (), np.zeros((0, 0)), own)
        sd.append(observer.estimate().core_sd[0, 2])
    assert sd[0] < 0.7 * sd[1]


def test_a_restart_keeps_the_cells_apart(pack) -> None:
    one, two = AdaptiveObserver([model()], 1.0), AdaptiveObserver([model()], 1.0)
    run(one, pack, 0, 300)
    own = np.broadcast_to(np.diag([0.03**2, 0.02**2, 0.01**2]), (5, 3, 3))
    one.set_parameters(0, {"R_e": 3.5e-3 * HOT}, (), np.zeros((0, 0)), own)
    state = json.loads(json.dumps(one.snapshot()))
    two.restore(state)
    a, b = run(one, pack, 300, 400), run(two, pack, 300, 400)
    assert a.core.tobytes() == b.core.tobytes()
    assert a.core_sd.tobytes() == b.core_sd.tobytes()
    old = replace_cells(state)
    three = AdaptiveObserver([model()], 1.0)
    three.restore(old)  # a state of before cells were told apart
    assert np.isfinite(three.estimate().core_sd).all()


def replace_cells(state):
    return {k: v for k, v in state.items() if k != "cells"}


def test_without_numbers_of_each_cells_own_the_tolerances_hold_again(pack) -> None:
    """Values common to the cells, taken when the voltages had ceased, kept the narrow band of the cells told apart."""
    usual, told = AdaptiveObserver([model()], 1.0), AdaptiveObserver([model()], 1.0)
    told.set_parameters(0, {}, (), np.zeros((0, 0)), np.zeros((5, 3, 3)))
    narrow, wide = (run(o, pack, 0, 900).core_sd[0] for o in (told, usual))
    assert (narrow[1:4] < 0.97 * wide[1:4]).all()
    told.set_parameters(0, {}, (), np.zeros((0, 0)))
    assert told.estimate().core_sd[0] == pytest.approx(wide, rel=1e-3)
