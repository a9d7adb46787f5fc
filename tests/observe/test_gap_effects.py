"""A gap over which the first step afterwards knows more: where inlet and flow have gone meanwhile."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.observe import Measured
from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.thermal import AddedEffect
from tests.observe.rig import model, truth
from tests.truth.string import C_F, TABLE_1, rk4

NAN = np.nan
N = 3
START_C = 25.0
DELAY = AddedEffect("coolant_delay", None, {"tau": 40.0}, {"tau": 0.0})
FLOW = AddedEffect("flow_dependent_cooling", None, {"n": 0.6}, {"n": 0.0})
MELTING = AddedEffect("phase_change", None, {"L": 1500.0, "T_m": 31.0, "w": 0.5}, {"L": 0.0, "T_m": 0.0, "w": 0.0})


def driven(effect):
    """A string after five minutes of 60 A at a steady inlet and nominal flow."""
    observer = EffectObserver(replace(model(N, (1, N), tolerances={}), effects=(effect,)), 1.0)
    y = np.full(N, START_C)
    for k in range(301):
        observer.step(Measured(60.0, 3600.0, 60.0, START_C, 1.0), y if k < 2 else np.full(N, NAN), np.zeros(N))
    return observer


def after(observer, inlet, flow):
    return observer.step(Measured(0.0, 0.0, 0.0, inlet, flow), np.full(N, NAN), np.zeros(N))


@pytest.mark.parametrize(
    ("effect", "warmer", "flow", "off"), [(DELAY, 8.0, 1.0, 0.4), (FLOW, 1.0, 0.1, 0.1), (MELTING, 8.0, 1.0, 0.1)]
)
def test_a_gap_ends_where_steps_that_saw_inlet_and_flow_go_would_have_ended(effect, warmer, flow, off):
    one, many = driven(effect), driven(effect)
    for k in range(1, 301):
        after(many, START_C + warmer * k / 300, flow ** (k / 300))
    one.propagate(300.0)
    blind = one.estimate()
    found, seen = (after(o, START_C + warmer, flow) for o in (one, many))
    assert np.abs(blind.surface - seen.surface).max() > 2.0  # the test has something to see
    assert np.abs(found.core - seen.core).max() < 0.1
    assert np.abs(found.surface - seen.surface).max() < off
    assert (found.core_sd > 0.85 * seen.core_sd).all()


@pytest.mark.parametrize("at", [12, 60, 108])
@pytest.mark.parametrize("what", ["inlet", "flow"])
def test_the_band_holds_whenever_in_the_gap_it_was_that_inlet_or_flow_jumped(what, at):
    """Current flows on as it did; the truth has its coolant changed at one moment of two minutes."""
    observer = driven(FLOW)
    start = observer.estimate()
    inlet, flow = (START_C + 8.0, 1.0) if what == "inlet" else (START_C, 0.4)
    string = truth(N), truth(N, R_u=TABLE_1["R_u"] * flow**-0.6, C_f=C_F * flow)
    core, surface = start.core[0], start.surface[0]
    for s, T, seconds in ((string[0], START_C, at), (string[1], inlet, 121 - at)):
        c, f = rk4(s, np.full(seconds, 60.0), np.full(seconds + 1, T), (core, surface))
        core, surface = c[-1], f[-1]
    observer.propagate(120.0, unseen=True)
    e = observer.step(Measured(60.0, 3600.0, 60.0, inlet, flow), np.full(N, NAN), np.zeros(N))
    assert (np.abs(e.core[0] - core) < 2.0 * e.core_sd[0]).all()
    assert (np.abs(e.surface[0] - surface) < 2.0 * e.surface_sd[0]).all()


def test_an_inlet_that_may_have_jumped_leaves_a_wider_band_than_one_that_stayed():
    sd = []
    for inlet, flow in ((START_C, 1.0), (START_C + 8.0, 1.0), (START_C, 0.4), (START_C, NAN)):
        observer = driven(FLOW)
        observer.propagate(60.0)
        sd.append(after(observer, inlet, flow).surface_sd.mean())
    stayed, jumped, stepped, unmeasured = sd
    assert jumped > 1.5 * stayed
    assert stepped > 1.1 * stayed
    assert unmeasured < stayed  # a flow that nobody measures is taken for nominal, as before


def test_parameters_that_come_between_a_gap_and_the_first_step_are_kept():
    observer = driven(FLOW)
    observer.propagate(60.0, unseen=True)
    observer.set_parameters(0, {"R_e": 4.0e-3}, ("R_e",), np.array([[1e-4]]))
    after(observer, START_C + 2.0, 0.9)
    assert observer.parameters[0].R_e == pytest.approx(4.0e-3)


def test_a_state_stored_between_a_gap_and_the_first_step_goes_on():
    observer, other = driven(FLOW), driven(FLOW)
    observer.propagate(60.0, unseen=True)
    other.restore(json.loads(json.dumps(observer.snapshot())))
    a, b = (after(o, START_C + 1.0, 1.0) for o in (observer, other))
    assert np.abs(a.core - b.core).max() < 0.5  # the one knew where the inlet went while it was carried
    assert (b.core_sd < 20.0).all()
