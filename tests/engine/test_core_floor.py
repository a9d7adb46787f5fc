"""A core below everything around it is not good, and no core that physics allows is called so."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bms_gateway.engine.core_floor import Floor, Step
from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Prior, StringModel
from tests.engine.doubtful_runs import run
from tests.engine.packs import plan

C_c, C_s, R_e, R_c, R_u = 268.0, 18.8, 3.5e-3, 1.266, 0.79
MODEL = StringModel(
    1,
    (1,),
    "single",
    {k: Prior(v, 0.3) for k, v in zip(("C_c", "C_s", "R_e", "R_c", "R_u"), (C_c, C_s, R_e, R_c, R_u), strict=True)},
)


@cache
def drive(seed, minutes=60):
    """Core, surface (K + 1,), inlet (K + 1,), current (K,) of a cell with reversible heat, by scipy; dt 5 s."""
    rng = np.random.default_rng(seed)
    K = minutes * 12
    current = np.repeat(rng.choice([-60.0, -10.0, 0.0, 5.0, 20.0, 80.0], K // 24 + 1), 24)[:K]
    inlet = 20 + np.repeat(rng.uniform(-15, 15, K // 60 + 2), 60)[: K + 1]
    potential = rng.uniform(-0.15, 0.15)

    def slope(t, x):
        k = min(int(t / 5), K - 1)
        q = current[k] ** 2 * R_e - current[k] * potential
        return [(q - (x[0] - x[1]) / R_c) / C_c, ((x[0] - x[1]) / R_c - (x[1] - inlet[k]) / R_u) / C_s]

    start = rng.uniform(-10, 40)
    t = 5.0 * np.arange(K + 1)
    x = solve_ivp(slope, (0, t[-1]), [start, start], t_eval=t, max_step=5.0).y
    return x[0], x[1], inlet, current


@pytest.mark.parametrize("seed", range(8))
def test_a_core_that_physics_allows_is_never_called_too_cold(seed):
    core, surface, inlet, current = drive(seed)
    floor, one = Floor.of([MODEL]), np.ones((1, 1))
    for k, amps in enumerate(current):
        at = [np.array([[x]]) for x in (core[k + 1], surface[k + 1])]
        step = Step(at[0], one, at[1], inlet[k : k + 1], np.array([amps]), np.array([amps**2]), 5.0)
        assert floor.below(step) is None


@pytest.mark.parametrize("seed", range(8))
def test_a_core_below_all_around_it_is_called_too_cold_at_once(seed):
    core, surface, inlet, current = drive(seed)
    floor, one = Floor.of([MODEL]), np.ones((1, 1))
    reversible = np.maximum(0.0, 0.15 * np.abs(current) - current**2 * R_e / 1.3).max()
    lowest = min(core[0] - 2.0, surface.min(), inlet.min()) - 0.5 - 1.3 * R_c * reversible - 0.1
    for k, amps in enumerate(current):
        away = np.array([[lowest if k else core[0]]])
        own, amps_of_it = surface[None, k + 1 : k + 2], np.array([amps])
        found = floor.below(Step(away, one, own, inlet[k : k + 1], amps_of_it, amps_of_it**2, 5.0))
        assert (found is not None) == (k > 0)


def test_without_a_current_nothing_is_said_and_without_an_inlet_the_surfaces_decide():
    nothing, cold, sound = np.array([np.nan]), np.array([[0.0, 20.0]]), np.array([[20.0, 20.0]])
    surface, sd = np.array([[20.0, 21.0]]), np.ones((1, 2))
    one = np.array([1.0])
    two = Floor.of([replace(MODEL, cells=2, sensors=(1, 2))])
    assert two.below(Step(sound, sd, surface, nothing, one, one, 1.0)) is None
    assert two.below(Step(cold, sd, surface, nothing, nothing, nothing, 1.0)) is None
    found = two.below(Step(cold, sd, surface, nothing, one, one, 1.0))
    assert found.tolist() == [[True, False]]


def test_the_gateway_sends_a_core_that_cannot_be_as_doubtful(monkeypatch):
    cold = np.zeros((2, 4), bool)
    cold[0, 1] = True
    monkeypatch.setattr(Floor, "below", lambda *_: cold)
    found, _ = run(plan(2))
    assert found[-1].quality[1] == Quality.DOUBTFUL
    assert found[-1].quality[0] == Quality.GOOD
