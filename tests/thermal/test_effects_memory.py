"""Effects that remember: the same in one call or many, and near to their equations solved finely."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

from bms_gateway.thermal.effects import effect_named
from bms_gateway.thermal.effects.laws import FEW, lag
from bms_gateway.thermal.physics import Physics
from tests.thermal.balances import VALUES, drive, model
from tests.thermal.effect_fields import FIELDS


def stretch(u, first, last):
    return type(u)(u.dt, *(getattr(u, f)[first:last] for f in FIELDS), known=u.known)


currents = st.lists(
    st.sampled_from([0.0, -80.0, 60.0, 0.05, -0.05, 150.0]) | st.floats(-200, 200), min_size=2, max_size=40
)


def plain(amps):
    """Intervals of one current each."""
    return {"I": amps, "I2": amps * amps, "I_abs": np.abs(amps)}


@given(currents, st.data(), st.sampled_from([0.5, 1.0, 10.0]))
@settings(deadline=None, max_examples=150)
def test_cuts_leave_no_trace_in_a_memory(amps, data, dt):
    amps = np.array(amps)
    N = len(amps)
    u = drive(N, dt=dt, T_in=20 + amps / 10, **plain(amps))
    cuts = sorted({0, N, *data.draw(st.lists(st.integers(1, N - 1), max_size=N))})
    for name, p in (
        ("hysteresis", {"V": 0.02, "Q": data.draw(st.floats(7.2, 18000))}),
        ("polarization", {"R_1": 1e-3, "tau": data.draw(st.floats(5, 400))}),
        ("coolant_delay", {"tau": data.draw(st.just(0.0) | st.floats(0, 120))}),
    ):
        e = effect_named(name)
        whole, end = e.follow(u, p, None)
        parts, carry = [], None
        for first, last in pairwise(cuts):
            part, carry = e.follow(stretch(u, first, last), p, carry)
            parts.append(part)
        assert np.array_equal(np.concatenate(parts), whole), name
        assert np.array_equal(carry, end), name


@given(currents, st.floats(10.0, 20000.0))
@settings(deadline=None, max_examples=100)
def test_hysteresis_builds_up_with_the_charge_since_the_reversal(amps, Q):
    amps = np.array([x for x in amps if abs(x) > 0.02 * Q] or [200.0])  # reversals that count at once
    u = drive(len(amps), **plain(amps))
    built, _ = effect_named("hysteresis").follow(u, {"V": 0.02, "Q": Q}, None)
    moved, fine = 0.0, 4000
    for k, x in enumerate(amps):
        if k and x * amps[k - 1] < 0:
            moved = 0.0
        inside = moved + abs(x) * (np.arange(fine) + 0.5) / fine
        assert built[k, 0] == pytest.approx(np.mean(1 - np.exp(-inside / Q)), abs=1e-5)
        moved += abs(x)


def test_a_sensors_noise_at_rest_is_no_reversal():
    noise = np.random.default_rng(5).normal(0, 0.1, 1800)
    amps = np.concatenate([np.full(600, 30.0), noise, np.full(10, 30.0), np.full(10, -30.0)])
    u = drive(len(amps), **plain(amps))
    built = effect_named("hysteresis").follow(u, {"V": 0.02, "Q": 540.0}, None)[0][:, 0]
    assert built[2400:2410].min() > 0.99
    assert built[2410:].max() < 0.5
    heat = Physics(model(1, ("hysteresis", None, {"V": 0.02, "Q": 540.0})))
    v = heat.numbers()
    X = np.full((len(amps), 2), 25.0)
    gain = heat.rates(X, u, v, heat.memory(u, v)[0])[:, 0] * VALUES["C_c"] - amps * amps * VALUES["R_e"]
    assert gain == pytest.approx(np.abs(amps) * 0.02 * built, abs=1e-9)


@pytest.mark.parametrize("tau", [5.0, 40.0, 400.0])
@pytest.mark.parametrize("dt", [1.0, 10.0])
def test_polarization_is_the_rc_pair_solved_finely(tau, dt):
    rng = np.random.default_rng(2)
    amps = np.repeat(rng.choice([-80.0, 0.0, 120.0], 12), 5)
    u = drive(len(amps), dt=dt, **plain(amps))
    p = {"R_1": 2e-3, "tau": tau}
    fine, V, heat = 2000, 0.0, []
    h = dt / fine
    for x in amps:
        path = []
        for _ in range(fine):  # trapezium
            new = (V * (1 - h / 2 / tau) + h / tau * x * 2e-3) / (1 + h / 2 / tau)
            path.append((V * V + V * new + new * new) / 3)
            V = new
        heat.append(np.mean(path) / 2e-3)
    own = Physics(model(1, ("polarization", None, p)))
    v = own.numbers()
    rates = own.rates(np.full((len(amps), 2), 25.0), u, v, own.memory(u, v)[0])
    assert rates[:, 0] * VALUES["C_c"] - amps * amps * VALUES["R_e"] == pytest.approx(
        np.array(heat), rel=1e-5, abs=1e-9
    )


def smoothed(x, tau):
    """First-order lag of a finely sampled series; tau in samples."""
    kept = np.exp(-1 / tau)
    return lfilter([1 - kept], [1, -kept], x, zi=[kept * x[0]])[0]


@pytest.mark.parametrize("tau", [0.0, 0.3, 50.0, 1e4])
def test_a_lag_stepped_through_is_the_filter_of_it_bit_for_bit(tau):
    x = np.random.default_rng(3).normal(size=4 * FEW) * 50.0
    kept = np.exp(-0.7 / tau) if tau else 0.0
    whole, mean = lag(x, 0.7, tau, 21.5)
    assert whole[1:].tolist() == lfilter([1 - kept], [1, -kept], x, zi=[kept * 21.5])[0].tolist()
    y, parts = 21.5, []
    for part in np.split(x, [1, 2, 12, 12 + FEW, 12 + 2 * FEW]):
        at, of = lag(part, 0.7, tau, y)
        y = float(at[-1])
        parts.append((at[1:], of))
    assert np.concatenate([at for at, _ in parts]).tolist() == whole[1:].tolist()
    assert np.concatenate([of for _, of in parts]).tolist() == mean.tolist()


@pytest.mark.parametrize("tau", [0.4, 6.0, 30.0, 120.0])
def test_the_delay_is_transport_and_mixing(tau):
    t, parts = np.arange(1200), 200
    step, swing = np.where(t < 100, 20.0, 30.0), 25 + 5 * np.sin(t / 300 * 2 * np.pi)
    for T_in in (step, swing):
        u = drive(len(t), T_in=T_in)
        got = T_in + effect_named("coolant_delay").follow(u, {"tau": tau}, None)[0][:, 0]
        fine = np.repeat(T_in, parts)
        late = np.interp(np.arange(fine.size) - 0.65 * tau * parts, np.arange(fine.size), fine)
        expected = smoothed(late, 0.35 * tau * parts).reshape(-1, parts).mean(axis=1)
        assert np.abs(got - expected).max() < 0.06 * 10  # of a jump within one interval
        if T_in is step:  # no heat is lost, however short the delay is against the interval
            assert np.sum(T_in - got) == pytest.approx(10.0 * tau, rel=1e-6)


@pytest.mark.parametrize("tau", [0.0, 0.3, 2.0, 20.0])
def test_a_thermocouple_answers_late_by_its_time_constant(tau):
    own = Physics(model(1, ("thermocouple_lag", None, {"tau": tau})))
    v = own.numbers()
    u = drive(1, I=np.zeros(1), I2=np.zeros(1), I_abs=np.zeros(1), flow=np.ones(1))
    # the surface as a ramp of 0.5 K/s that the bead follows; its own balance is not asked
    bead = lambda t, b: own.rates(np.array([[25.0, 25.0 + 0.5 * t, b[0]]]), u, v, {})[0, 2:]  # noqa: E731
    end = 20 * max(tau, 1.0)
    b = solve_ivp(bead, (0.0, end), [25.0], method="LSODA", rtol=1e-9, atol=1e-9).y[0, -1]
    y = own.readings(np.array([[25.0, 25.0 + 0.5 * end, b]]), u, v, {})[0, 0]
    assert y == pytest.approx(25.0 + 0.5 * (end - tau), abs=1e-4)
    assert own.start(np.array([40.0]), np.array([30.0]), v)[2] == 30.0


def test_a_slow_thermocouple_is_the_first_order_lag():
    own = Physics(model(1, ("thermocouple_lag", None, {"tau": 20.0})))
    v, u = own.numbers(), drive(1)
    bead = lambda t, b: own.rates(np.array([[25.0, 35.0, b[0]]]), u, v, {})[0, 2:]  # noqa: E731
    for t in (1.0, 10.0, 60.0):
        b = solve_ivp(bead, (0.0, t), [25.0], method="LSODA", rtol=1e-9, atol=1e-9).y[0, -1]
        y = own.readings(np.array([[25.0, 35.0, b]]), u, v, {})[0, 0]
        assert y == pytest.approx(35.0 - 10.0 * np.exp(-t / 20.0), abs=0.01)


def shells(phi, rings=300):
    """The cell as a cylinder of thin shells of equal thickness (finite volumes): ẋ = A x + b q, casing last."""
    C_c, C_s, R_c, R_u = (VALUES[k] for k in ("C_c", "C_s", "R_c", "R_u"))
    edge = np.arange(rings + 1) / rings
    w = np.diff(edge**2)
    r = (edge[1:] + edge[:-1]) / 2
    # uniform heat, solid cylinder: mean-to-edge resistance 1/(8 pi k L) = phi R_c
    k = 1 / (4 * phi * R_c)
    G = np.append(k / np.log(r[1:] / r[:-1]), 1 / (np.log(1 / r[-1]) / k + (1 - phi) * R_c))
    A = np.zeros((rings + 1, rings + 1))
    for i, g in enumerate(G):
        A[[i, i + 1], [i, i + 1]] -= g
        A[[i, i + 1], [i + 1, i]] += g
    A[-1, -1] -= 1 / R_u
    C = np.append(w * C_c, C_s)
    return A / C[:, None], np.append(w, 0.0) / C, np.append(w, 0.0)


def modes(phi):
    """The same cell as the effect has it; linear, so its Jacobian tells all."""
    own = Physics(model(1, ("radial_gradient", None, {"phi": phi})))
    u = drive(1, I=np.zeros(1), I2=np.zeros(1), I_abs=np.zeros(1), T_in=np.zeros(1))
    A = own.linearised(np.full(own.states, 20.0), u, own.numbers(), {})
    b = np.zeros(own.states)
    b[0] = 1 / VALUES["C_c"]
    return A, b, np.eye(own.states)[0], 1


TIMES = (1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 5000.0)


def step(A, b, core, casing, watts=40.0):
    """Core and casing after a step of heat, K."""
    end = np.linalg.solve(A, -b * watts)
    x = np.array([end - expm(A * t) @ end for t in TIMES])
    return np.column_stack([x @ core, x[:, casing]])


@pytest.mark.parametrize(("phi", "apart"), [(0.05, 1e-4), (0.1, 2e-4), (0.3, 5e-4), (0.6, 3e-3), (1.0, 0.03)])
def test_the_radial_modes_are_the_fine_cylinder(phi, apart):
    # 40 W: 85 K at the core in the end; without the effect the surface is up to 1.9 K off on the way at phi = 1
    fine = step(*shells(phi), -1)
    got = step(*modes(phi))
    assert np.abs(got - fine).max() < apart
    lumped = step(*modes(0.0))
    assert np.abs(lumped - fine).max() > 80 * np.abs(got - fine).max()


@pytest.mark.parametrize("phi", [0.0, 0.01, 0.3, 1.0])
def test_a_steady_core_rise_is_that_of_r_c_for_every_share(phi):
    A, b, core, casing = modes(phi)
    x = np.linalg.solve(A, -b * 40.0)
    assert x @ core - x[casing] == pytest.approx(40.0 * VALUES["R_c"], rel=1e-9)
    # and the profile that it starts from is the steady one
    own = Physics(model(1, ("radial_gradient", None, {"phi": phi})))
    assert own.start(x[:1], x[1:2], own.numbers()) == pytest.approx(x, rel=1e-9)


@given(st.floats(0.0, 1.0), st.floats(0.01, 50.0), st.floats(1.0, 2e4))
@settings(deadline=None, max_examples=100)
def test_the_radial_modes_are_stable_and_never_stiff(phi, R_c, C_c):
    own = Physics(model(1, ("radial_gradient", None, {"phi": phi})))
    u = drive(1, I=np.zeros(1), I2=np.zeros(1), I_abs=np.zeros(1), T_in=np.zeros(1))
    v = own.numbers({"R_c": R_c, "C_c": C_c, "C_s": C_c / 5})
    poles = np.linalg.eigvals(own.linearised(np.full(own.states, 20.0), u, v, {}))
    lumped = np.linalg.eigvals(
        Physics(model(1)).linearised(
            np.full(2, 20.0), u, Physics(model(1)).numbers({"R_c": R_c, "C_c": C_c, "C_s": C_c / 5}), {}
        )
    )
    assert poles.real.max() < 0
    assert np.abs(poles.imag).max() < 1e-6
    # a mode is at most 1/2 s, an edge film of zero makes it up to eight times that together with the lumped poles'
    assert -poles.real.min() < 8 * (0.5 - lumped.real.min())


def test_the_lumped_model_is_reached_without_a_step():
    lumped = step(*modes(0.0))
    ways = [np.abs(step(*modes(phi)) - lumped).max() for phi in (1e-9, 1e-4, 1e-3, 1e-2)]
    assert ways[0] < 1e-7
    assert ways[1] < ways[2] < ways[3] < 0.06
