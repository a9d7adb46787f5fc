"""A state that is whole but cannot be true is refused with the reason; what is taken up gives estimates of a string."""

import copy
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.errors import StateError
from tests.engine.packs import database, plan, traffic

STRANGE = [None, True, "x", [], {}, -1, 0, 1, 1e-300, -1e9, 1e9, 1e30, 1e300, float("nan"), float("inf"), 2**70, 5000.0]


@cache
def stored() -> str:
    engine = Engine(plan(), database())
    for _ in drive(engine, [traffic(90)]):
        pass
    return json.dumps(engine.snapshot())


@cache
def frames_after():
    frames = traffic(100)
    return frames[int(np.searchsorted(frames.time_ns, frames.time_ns[-1] - 6 * 10**9)) :]


def fresh() -> Engine:
    return Engine(plan(), database())


def observer(state):
    return state["estimators"]["observers"][0]["state"]


def core_of_5000(state):
    observer(state)["state"]["x"][1][2] = 5000.0


def core_of_nan(state):
    observer(state)["state"]["x"][0][0] = None


def negative_variance(state):
    observer(state)["state"]["P"][0][0][0] = -4.0


def variance_negative_in_a_direction(state):
    P = observer(state)["state"]["P"][1]
    P[0][1] = P[1][0] = 10.0 * (P[0][0] + P[1][1])


def unequal_covariance(state):
    P = observer(state)["state"]["P"][1]
    P[0][1] = P[0][1] + 5.0


def wrong_shape(state):
    observer(state)["state"]["x"][0].append(25.0)


def resistance_of_a_kiloohm(state):
    identifier = state["estimators"]["strings"]["string_2"]["identifier"]
    identifier["mean"][identifier["names"].index("R_e")] = float(np.log(1e3))


def surface_of_negative_heat_capacity(state):
    observer(state)["parameters"][0]["C_s"][0] = -0.5


def negative_covariance_of_parameters(state):
    state["estimators"]["strings"]["string_1"]["identifier"]["cov"][0][0] = -1.0


def time_before_time(state):
    state["tick_end_ns"] = -5


def time_beyond_time(state):
    state["tick_end_ns"] = 10**30


def time_beyond_floats(state):
    state["tick_end_ns"] = -(10**400)


def resistance_as_text(state):
    observer(state)["parameters"][0]["R_e"][1] = "9" * 5000


def variance_beyond_all(state):
    observer(state)["surprise"]["own"][0][1] = 1e19


def strings_as_list(state):
    state["estimators"]["strings"] = []


def nothing(state):
    state["estimators"] = None


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (core_of_5000, "string_2: core of cell 2 is 5000 °C; possible: -60 to 200 °C"),
        (core_of_nan, "not numbers"),
        (negative_variance, "string_1: the matrix of its temperatures is no covariance"),
        (variance_negative_in_a_direction, "string_2: the matrix of its temperatures is no covariance"),
        (unequal_covariance, "string_2: the matrix of its temperatures is no covariance"),
        (wrong_shape, "not of these strings"),
        (resistance_of_a_kiloohm, "string_2: R_e is 1e+06 mOhm"),
        (surface_of_negative_heat_capacity, "C_s is -0.5 J/K; possible: 0.1 to 5000 J/K"),
        (negative_covariance_of_parameters, "string_1: the matrix of its parameters is no covariance"),
        (time_before_time, "is not the time of any clock"),
        (time_beyond_time, "is not the time of any clock"),
        (time_beyond_floats, "is not the time of any clock"),
        (resistance_as_text, "not of these strings"),
        (variance_beyond_all, "holds 1e+19"),
        (strings_as_list, "does not fit this program"),
        (nothing, "does not fit this program"),
    ],
)
def test_what_cannot_be_true_is_refused_with_the_reason(spoil, says):
    state = json.loads(stored())
    spoil(state)
    with pytest.raises(StateError) as refused:
        fresh().restore(state)
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)


def test_the_state_itself_is_taken_up_and_comes_back_the_same():
    engine = fresh()
    engine.restore(json.loads(stored()))
    assert json.dumps(engine.snapshot()) == stored()


def leaves(value, path=()):
    """Paths of all numbers, texts and containers of a JSON value."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from leaves(inner, (*path, key))


@cache
def places():
    return sorted(leaves(json.loads(stored())), key=str)


@settings(deadline=None, max_examples=150, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_whatever_stands_in_a_state_only_our_error_or_sane_estimates_come_of_it(data):
    state = copy.deepcopy(json.loads(stored()))
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from(places()))
        new = data.draw(st.sampled_from(STRANGE) | st.floats(-1e4, 1e4))
        if not path:
            continue
        inside = state
        try:
            for key in path[:-1]:
                inside = inside[key]
            inside[path[-1]] = new
        except (TypeError, KeyError, IndexError):
            continue  # the first change took its place away
    engine = fresh()
    with np.errstate(all="ignore"):
        try:
            engine.restore(state)
        except StateError:
            return
        for event in drive(engine, [frames_after()]):
            if isinstance(event, Estimated):
                known = np.isfinite(event.core)
                assert np.all((event.core[known] > -100.0) & (event.core[known] < 300.0))
                assert np.all(event.core_sd[known] > 0.0)
