"""Responses to the carried effects against LSODA on their own equations, written out here for two cells in a stream."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bms_gateway.identify.carried import NAMES, Course, columns
from bms_gateway.thermal import StringParameters

R_E, R_C, R_U, C_C, C_S, R_CC, C_F, CAPACITY = 3.5e-3, 1.266, 0.79, 268.0, 18.8, 4.0, 11.33, 8.0
STEP_S, STEPS, START = 40.0, 15, (31.0, 27.0, 33.0, 28.0)
CURRENT = np.random.default_rng(3).choice([-70.0, -20.0, 0.0, 40.0, 90.0], STEPS)
INLET = (24.0, 26.0)  # °C at the start and at the end, a straight line between


def inlet(t):
    return INLET[0] + (INLET[1] - INLET[0]) * t / (STEP_S * STEPS)


def charge(t):
    """Charge moved by an instant, over the capacity, about its mean over the window."""
    edges = np.arange(STEPS + 1) * STEP_S
    moved = np.concatenate([[0.0], np.cumsum(CURRENT)]) * STEP_S / 3600 / CAPACITY
    ticks = np.interp(np.arange(0.0, STEPS * STEP_S, 8.0) + 4.0, edges, moved)
    return np.interp(t, edges, moved) - ticks.mean()


def rates(t, x, current, effect, v):
    """Heat balances of two cells. x: core and casing of each."""
    core, casing = x.reshape(2, 2).T
    stream = np.array([inlet(t), inlet(t) + (casing[0] - inlet(t)) / (R_U * C_F)])
    over, kelvin = casing - stream, core + 273.15
    rms = np.sqrt(np.mean(CURRENT**2))
    ohmic, flow = current**2 * R_E * np.ones(2), np.zeros(2)
    extra = {
        "entropic": -0.25e-3 * current * kelvin,
        "entropic_slope": -1e-3 * charge(t) * current * kelvin,
        "charge_transfer": 0.3 * R_E * (rms * abs(current) - current**2) * np.ones(2),
        "asymmetry": 0.15 * R_E * current**2 * (current < 0) * np.ones(2),
        "end_loss": -0.1 * (core - stream) / (R_C + R_U),
    }
    cooled = {
        "sink": 0.4 / R_U * np.ones(2),
        "ambient_loss": -0.06 * (casing - INLET[0]) / R_U,
        "convection": -0.1 * np.log(np.abs(over) / 5 + 0.05) * over / R_U,
    }
    ohmic = ohmic + v * extra.get(effect, 0.0)
    flow = flow + v * cooled.get(effect, 0.0)
    between = (casing[1] - casing[0]) / R_CC * np.array([1.0, -1.0])
    outward = (core - casing) / R_C
    return np.column_stack([(ohmic - outward) / C_C, (outward - over / R_U + flow + between) / C_S]).ravel()


def surfaces(effect, v):
    """Surfaces (K + 1, 2) of the truth at every second."""
    x = np.array(START)
    out = [x[1::2]]
    for k, amps in enumerate(CURRENT):
        span = (k * STEP_S, (k + 1) * STEP_S)
        found = solve_ivp(
            rates, span, x, "LSODA", np.arange(span[0] + 1, span[1] + 1), args=(amps, effect, v), rtol=1e-9,
            atol=1e-9,
        )  # fmt: skip
        x = found.y[:, -1]
        out += list(found.y.T[:, 1::2])
    return np.array(out)


@pytest.fixture(scope="module")
def found():
    current = np.repeat(CURRENT, int(STEP_S))
    K = len(current)
    p = StringParameters.of(2, C_c=C_C, C_s=C_S, R_e=R_E, R_c=R_C, R_u=R_U, R_cc=R_CC, C_f=C_F)
    course = Course.of(current**2, np.zeros(K), current, inlet(np.arange(K + 1.0)), 1.0, CAPACITY)
    plain = surfaces("", 0.0)
    return columns(p, course, np.array(START), plain, [0, 1]).readings, plain


@pytest.mark.parametrize(
    "effect", ["entropic", "entropic_slope", "charge_transfer", "asymmetry", "end_loss", "sink", "ambient_loss"]
)
def test_a_response_is_that_of_the_equations(found, effect):
    added, plain = found
    truth = (surfaces(effect, 1e-2) - plain) / 1e-2
    mine = added[:, :, NAMES.index(effect)]
    assert np.abs(truth).max() > 0.02
    assert np.abs(mine - truth).max() < 0.06 * np.abs(truth).max()


def test_convection_is_followed_where_gaps_are_small(found):
    added, plain = found
    truth = (surfaces("convection", 1e-2) - plain) / 1e-2
    assert np.abs(added[:, :, NAMES.index("convection")] - truth).max() < 0.15 * np.abs(truth).max()


def test_a_thermocouple_in_the_stream_and_one_that_lags_are_told_by_what_they_read(found):
    added, plain = found
    stream = np.column_stack([inlet(np.arange(len(plain)) * 1.0), np.zeros(len(plain))])
    stream[:, 1] = stream[:, 0] + (plain[:, 0] - stream[:, 0]) / (R_U * C_F)
    assert added[:, :, NAMES.index("contact")] == pytest.approx(0.03 * (stream - plain), abs=0.02)
    late = np.array([np.interp(np.arange(len(plain)) - 1.5e-3, np.arange(len(plain)), y) for y in plain.T]).T
    truth = (late - plain)[2:] / 1e-3
    assert np.abs(added[2:, :, NAMES.index("lag")] - truth).mean() < 0.1 * np.abs(truth).max()


def test_the_gain_of_heat_from_voltage_is_that_heat_times_its_sd():
    K, heat = 600, np.full(600, 9.0)
    p = StringParameters.of(1, C_c=C_C, C_s=C_S, R_e=R_E, R_c=R_C, R_u=R_U)
    course = Course.of(np.zeros(K), heat, np.zeros(K), np.full(K + 1, 25.0), 1.0, CAPACITY)
    effects = columns(p, course, np.full(2, 25.0), np.full((K + 1, 1), 25.0), [0])
    warmed = solve_ivp(
        lambda _, x: [(9.0 * 0.25 - (x[0] - x[1]) / R_C) / C_C, ((x[0] - x[1]) / R_C - x[1] / R_U) / C_S],
        (0, K), [0.0, 0.0], "LSODA", rtol=1e-9, atol=1e-9,
    )  # fmt: skip
    assert effects.readings[-1, 0, NAMES.index("heat_gain")] == pytest.approx(warmed.y[1, -1], rel=0.01)
    assert effects.last[:, NAMES.index("heat_gain")] == pytest.approx(warmed.y[:, -1], rel=0.01)
    assert effects.shares[0, NAMES.index("heat_gain")] == pytest.approx(0.25)
