"""Forecasts of strings with effects, held against the truth integrated on by itself."""

import numpy as np
import pytest

from bms_gateway.observe.ahead import CENTRE, CORE, PATH_S, SURFACE
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.observe.forecast_start import Coming, Profile
from bms_gateway.observe.measured import Measured
from bms_gateway.observe.outlook_effects import EffectOutlook
from bms_gateway.thermal import AddedEffect, Prior, StringModel
from tests.truth.string import TABLE_1, TruthString, rk4

NOW, LOAD, B = 900, 70.0, 3000.0
NONE = np.zeros((1, 1))
STEADY = np.concatenate(
    (np.repeat(np.random.default_rng(3).choice([0.0, 40.0, -60.0, 90.0], NOW // 20), 20), np.full(600, LOAD))
)


def coming(current):
    return Coming(np.full(1, np.nan), np.zeros((4, 1)), NONE, NONE, NONE, NONE, NONE, np.array([current]))


def observed(core, surface, current, effect, rel_sd=0.1):
    priors = {k: Prior(v, rel_sd if k in ("R_e", "R_c", "R_u") else 0.0) for k, v in TABLE_1.items()}
    observer = EffectObserver(StringModel(1, (1,), "single", priors, effects=(effect,)), 1.0)
    for k in range(NOW):
        m = Measured(current[k], current[k] ** 2, abs(current[k]), inlet=25.0)
        observer.step(m, surface[k + 1], np.zeros(1))
    return observer.standing()


@pytest.fixture(scope="module")
def warm():
    """A cell whose resistance falls with its temperature, its truth, and how the observer stands after 15 min."""
    string = TruthString.of(1, B=B)
    core, surface = rk4(string, STEADY, np.full(len(STEADY) + 1, 25.0), 25.0)
    effect = AddedEffect("resistance_temperature", None, {"B": B}, {"B": 300.0})
    return string, core, surface, observed(core, surface, STEADY, effect)


def test_a_steady_load_and_a_profile_end_where_the_truth_does(warm) -> None:
    string, core, surface, standing = warm
    outlook, at = EffectOutlook(), NOW + PATH_S.astype(int)
    T = outlook.ahead(standing, coming(LOAD)).under(np.array([LOAD**2]))
    # the secant of now stands for the whole course: R_e falls by a tenth as the cell warms by 3 K
    sd = outlook.ahead(standing, coming(LOAD)).sd(np.array([LOAD**2]))
    assert np.abs(T[CORE, :, 0] - core[at]).max() < 0.6
    assert abs(T[CORE, -1, 0, 0] - core[at][-1, 0]) < sd[CORE, -1, 0, 0]
    each = np.random.default_rng(5).choice([0.0, 60.0, 120.0], 60)
    later, shell = rk4(string, np.repeat(each, 10), np.full(601, 25.0), (core[NOW], surface[NOW]))
    profile = Profile(each[:, None], each[:, None] ** 2, np.full((60, 1), 25.0))
    T = outlook.under(standing, coming(LOAD), profile).under(np.zeros(1))
    assert np.abs(T[CORE, :, 0] - later[PATH_S.astype(int)]).max() < 0.2
    assert np.abs(T[SURFACE, :, 0] - shell[PATH_S.astype(int)]).max() < 0.2


def test_a_permitted_current_brings_the_truth_near_the_limit(warm) -> None:
    string, core, surface, standing = warm
    limit = float(core[NOW, 0]) + 8.0
    current = float(np.sqrt(EffectOutlook().ahead(standing, coming(LOAD)).permitted(limit, sds=0.0))[-1, 0])
    later, shell = rk4(string, np.full(600, current), np.full(601, 25.0), (core[NOW], surface[NOW]))
    centre = later[-1] + 0.5 * (later[-1] - shell[-1])
    assert limit - 2.0 < float(centre[0]) < limit + 0.3


def test_charge_and_discharge_are_told_apart_where_the_effect_does() -> None:
    a = 0.3
    effect = AddedEffect("resistance_asymmetry", None, {"a": a}, {"a": 0.05})
    heat = STEADY**2 * TABLE_1["R_e"] * (1.0 + a * (STEADY < 0.0))
    core, surface = rk4(TruthString.of(1), 0.0 * STEADY, np.full(len(STEADY) + 1, 25.0), 25.0, heat=heat[:, None])
    standing = observed(core, surface, STEADY, effect)
    one, other = (EffectOutlook().ahead(standing, coming(c)) for c in (LOAD, -LOAD))
    square = np.array([LOAD**2])
    rise = [x.under(square)[CENTRE, -1, 0, 0] - x.under(np.zeros(1))[CENTRE, -1, 0, 0] for x in (one, other)]
    limit = float(core[NOW, 0]) + 10.0
    ways = (
        [one.permitted(limit, sds=0.0, way=w)[-1, 0] for w in (1, -1)],
        [other.permitted(limit, sds=0.0, way=w)[-1, 0] for w in (-1, 1)],
    )
    assert ways[0] == pytest.approx(ways[1], rel=0.01)
    assert rise[1] / rise[0] == pytest.approx(1.0 + a, rel=0.01)
    assert ways[0][0] > 1.1 * ways[0][1]
