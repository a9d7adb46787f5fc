"""What usually flows: against the weighted mean of all that was seen, and what a restart makes of it."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.errors import StateError
from bms_gateway.observe import AdaptiveObserver, Disturbance, Measured
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.observe.unseen import FULL, Usual
from bms_gateway.thermal import AddedEffect
from tests.observe.rig import model, truth
from tests.truth.string import lsoda

DT, CORRELATION = 1.0, 60.0
SHARE = 1.0 - np.exp(-DT / CORRELATION)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(st.none(), st.floats(0.0, 90.0)), min_size=1, max_size=600), st.integers(0, 500))
def test_it_is_the_mean_of_all_that_was_seen_fading_with_time(seen, gap):
    """Weights e^(-age/τ): whatever is missing, however long nobody looked, and from the first value on."""
    cut = len(seen) // 2
    usual, ages, values, age = Usual.nothing(1, 1), [], [], 0.0
    for k, q in enumerate(seen):
        if k == cut:
            usual, age = usual.aged(1.0 - np.exp(-gap / CORRELATION)), age + gap
        usual = usual.after(np.array([[np.nan if q is None else q]]), SHARE, np.array([[q is not None]]))
        age += DT
        if q is not None:
            ages.append(age)
            values.append(q)
    if not values:
        assert usual.mean == 0.0
        return
    weights = np.exp((np.array(ages) - age) / CORRELATION)
    assert usual.mean[0, 0] == pytest.approx(np.average(values, weights=weights), abs=90.0 * (1.0 - FULL))


def test_strings_of_which_all_is_known_go_the_short_way_to_the_same():
    rng = np.random.default_rng(2)
    short = long = Usual.nothing(2, 3)
    for _ in range(1000):
        q = rng.gamma(1.0, 10.0, (2, 3))
        short, long = short.after(q, SHARE), long.after(q, SHARE, np.ones((2, 1), np.bool_))
    assert short.full
    np.testing.assert_allclose(short.mean, long.mean, rtol=1e-12)


def test_a_restart_in_the_first_minutes_of_a_drive_goes_on_with_its_heat():
    observer = AdaptiveObserver([model(3, (1, 3))], 1.0)
    y = np.array([[25.0, np.nan, 25.0]])
    for _ in range(90):
        observer.step(np.array([7200.0]), None, np.array([25.0]), y, np.zeros((1, 3)))
    again = AdaptiveObserver([model(3, (1, 3))], 1.0)
    again.restore(json.loads(json.dumps(observer.snapshot())))
    before = again.estimate().core[0]
    after = again.propagate(2.0, unseen=True).core[0]
    heat = model(3, (1, 3)).nominal
    warmed = heat.R_e * 7200.0 * 2.0 / heat.C_c
    assert np.all(after - before > 0.5 * warmed)


def test_a_state_of_before_there_were_weights_has_seen_all_of_its_time():
    usual = Usual(np.full((1, 2), 5.0), np.full((1, 1), 0.3))
    own = usual.snapshot()
    assert usual.restored(json.loads(json.dumps(own))).weight == 0.3
    del own["usual_weight"]
    assert usual.restored(own).full


@pytest.mark.parametrize(
    "spoilt", [{"usual": [[None, 1.0, 1.0]]}, {"usual_weight": [[2.0]]}, {"usual_weight": [[None]]}]
)
def test_a_state_whose_mean_is_none_is_refused(spoilt):
    observer = AdaptiveObserver([model(3, (1, 3))], 1.0)
    snapshot = observer.snapshot()
    snapshot["own"] |= spoilt
    with pytest.raises(StateError, match="usual"):
        observer.restore(snapshot)


def by_effects(cells):
    """The string as the observer with effects has it: one that does nothing while the flow is nominal."""
    effect = AddedEffect("flow_dependent_cooling", None, {"n": 0.6}, {"n": 0.0})
    observer = EffectObserver(replace(model(cells, (1, cells)), effects=(effect,)), 1.0)
    return lambda A, y: observer.step(Measured(A, A * A, abs(A), 25.0, 1.0), y, np.zeros(cells))


def by_resistances(cells):
    observer = AdaptiveObserver([model(cells, (1, cells))], 1.0)
    return lambda A, y: observer.step(np.array([A * A]), None, np.array([25.0]), y[None], np.zeros((1, cells)))


@pytest.mark.parametrize("string", [by_resistances, by_effects])
def test_a_burst_right_after_the_current_was_lost_is_inside_the_band_from_the_first_second_on(string):
    """It stood, and then climbs at two and a half times the heat of a cell at work, of which no surface tells."""
    step, y = string(3), np.array([25.0, np.nan, 25.0])
    for _ in range(300):
        step(0.0, y)
    climb = np.sqrt(2.5 * Disturbance().heat_unknown / 3.5e-3)
    core, _ = lsoda(truth(3), np.full(60, climb), np.full(61, 25.0), 25.0)
    for k in range(1, 61):
        e = step(np.nan, np.full(3, np.nan))
        assert (np.abs(core[k] - e.core[0]) < 2.0 * e.core_sd[0]).all(), k
    assert core[-1].min() > 29.0  # the test has something to see
    assert e.core_sd.max() < 5.0


@pytest.mark.parametrize("string", [by_resistances, by_effects])
def test_a_current_missed_for_a_second_costs_next_to_nothing(string):
    step, y = string(3), np.array([25.0, np.nan, 25.0])
    for _ in range(300):
        before = step(60.0, y)
    step(np.nan, y)
    after = step(60.0, y)
    assert (after.core_sd < before.core_sd + 0.1).all()
    assert (np.abs(after.core - before.core) < 0.1).all()
