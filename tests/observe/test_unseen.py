"""What usually flows: against the weighted mean of all that was seen, and what a restart makes of it."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.errors import StateError
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.unseen import FULL, Usual
from tests.observe.rig import model

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
