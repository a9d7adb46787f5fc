"""Whole trajectories against an independent integrator, and their sensitivities against differences of trajectories."""

from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.thermal import AddedEffect, Prior, StringModel
from bms_gateway.thermal.drive import Drive, Span, cut
from bms_gateway.thermal.physics import Physics
from bms_gateway.thermal.recursion import Recursion
from bms_gateway.thermal.system import System
from bms_gateway.thermal.trajectory import Variation, reference, sensitivities, simulate
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TABLE_1, TruthString, rk4, wavy_inlet

SECONDS = 1500


def string_of(cells, *effects):
    """Physics, numbers and a drive of the urban cycle with a wavy inlet, and the inlet at the instants."""
    priors = {k: Prior(v) for k, v in TABLE_1.items()}
    if cells > 1:
        priors |= {"R_cc": Prior(4.0), "C_f": Prior(C_F)}
    model = StringModel(cells, (1,), "full" if cells > 1 else "single", priors, effects=effects)
    current, inlet = repeated(SECONDS / 60), wavy_inlet(SECONDS)
    one, none = np.ones(SECONDS), np.full(SECONDS, np.nan)
    drive = Drive(
        dt=1.0, I=current, I2=current**2, I_abs=np.abs(current), T_in=(inlet[1:] + inlet[:-1]) / 2, flow=one,
        soc=0.5 * one, V=none, IV=none, hours=np.arange(SECONDS) / 3600, known=frozenset(),
    )  # fmt: skip
    physics = Physics(model)
    return physics, physics.numbers(), drive, current, inlet


def run(physics, v, drive, start, *, guess=None, spans=None, tolerance=1e-6):
    spans = spans or [Span(0, drive.N)]
    memory, _ = physics.memory(drive, v)
    system = System(physics, drive, v, memory, spans)
    recursion = reference(system, start + 5.0)
    X, settled = simulate(system, [start] * len(spans), recursion, guess, tolerance)
    return X, settled, recursion


@pytest.mark.parametrize(("cells", "B"), [(1, 0.0), (1, 4000.0), (4, 0.0), (4, 6000.0)])
def test_a_trajectory_is_the_independent_integrators(cells, B):
    added = (AddedEffect("resistance_temperature", None, {"B": B}),) if B else ()
    physics, v, drive, current, inlet = string_of(cells, *added)
    X, settled, _ = run(physics, v, drive, physics.start(np.full(cells, 24.0), np.full(cells, 24.0), v))
    conduction = {"R_cc": 4.0, "C_f": C_F} if cells > 1 else {}
    core, surface = rk4(TruthString.of(cells, B=B, **conduction), current, inlet, 24.0)
    assert settled
    assert np.abs(X[:, 0 : 2 * cells : 2] - core).max() < 1e-3
    assert np.abs(X[:, 1 : 2 * cells : 2] - surface).max() < 1e-3


@pytest.mark.parametrize("guess_from", [None, 24.0, 40.0])
@pytest.mark.parametrize(
    ("L", "w", "bound"), [(100.0, 2.0, 0.002), (350.0, 0.7, 0.01), (900.0, 0.5, 0.05), (3000.0, 0.3, 0.5)]
)
def test_a_span_whose_sweeps_do_not_settle_is_solved_in_pieces(L, w, bound, guess_from):
    # melting peaks of up to several hundred times the casing's capacity, with and without a guess on either side of it
    physics, v, drive, current, inlet = string_of(1, AddedEffect("phase_change", None, {"L": L, "T_m": 27.0, "w": w}))
    start = physics.start(np.array([24.0]), np.array([24.0]), v)
    guess = None if guess_from is None else np.full((SECONDS + 1, 2), guess_from)
    X, settled, _ = run(physics, v, drive, start, guess=guess, tolerance=2e-4)
    truth = melting(
        L, w, current, inlet, np.full(2, 24.0), {k: TABLE_1[k] for k in ("R_e", "R_c", "R_u", "C_c", "C_s")}
    )
    assert settled or L > 100.0  # else nothing here is in pieces
    assert np.abs(X - truth).max() < bound


def melting(L, w, current, inlet, start, numbers):
    """Trajectory of a cell with a melting casing, by RK4 in steps of 0.1 s: (instants, core and surface, cases)."""
    R_e, R_c, R_u, C_c, C_s = (numbers[k] for k in ("R_e", "R_c", "R_u", "C_c", "C_s"))

    def slope(x, amps, T_in):
        peak = L / w / np.sqrt(2 * np.pi) * np.exp(-(((x[1] - 27.0) / w) ** 2) / 2)
        inward = (x[0] - x[1]) / R_c
        return np.stack([(amps**2 * R_e - inward) / C_c, (inward - (x[1] - T_in) / R_u) / (C_s + peak)])

    x, dt = start, 0.1
    found = [x]
    for amps, T_in in zip(current, (inlet[1:] + inlet[:-1]) / 2, strict=True):
        for _ in range(10):
            a = slope(x, amps, T_in)
            b = slope(x + dt / 2 * a, amps, T_in)
            c = slope(x + dt / 2 * b, amps, T_in)
            x = x + dt / 6 * (a + 2 * b + 2 * c + slope(x + dt * c, amps, T_in))
        found.append(x)
    return np.array(found)


@pytest.mark.parametrize("symbol", ["R_e", "R_c", "R_u", "C_c", "C_s"])
def test_sensitivities_are_differences_of_trajectories(symbol):
    physics, v, drive, *_ = string_of(3, AddedEffect("resistance_temperature", None, {"B": 3000.0}))
    start = physics.start(np.full(3, 24.0), np.full(3, 24.0), v)
    X, _, recursion = run(physics, v, drive, start)
    h = 0.01
    moved = replace(v, string=replace(v.string, **{symbol: getattr(v.string, symbol) * np.exp(h)}))
    variation = Variation(moved, {}, h, (0 * start,))
    S = sensitivities(System(physics, drive, v, {}), X, recursion, [variation], refinements=4)[..., 0]
    expected = (run(physics, moved, drive, start, guess=X)[0] - X) / h
    assert np.abs(S - expected).max() < 0.02 * np.abs(expected).max()


def test_sensitivities_through_a_melting_peak_are_differences_of_an_independent_trajectory():
    # the peak multiplies C_s by twenty; columns that sweeps left a half wrong held a fit at numbers 50 of cost off
    melts = {"L": 350.0, "T_m": 27.0, "w": 0.7}
    physics, v, drive, current, inlet = string_of(1, AddedEffect("phase_change", None, melts))
    start = physics.start(np.array([24.0]), np.array([24.0]), v)
    X, _, recursion = run(physics, v, drive, start, tolerance=2e-4)
    symbols, h = ["R_e", "R_c", "R_u", "C_c", "C_s"], 1e-3
    variations = [
        Variation(replace(v, string=replace(v.string, **{k: getattr(v.string, k) * np.exp(h)})), {}, h, (0 * start,))
        for k in symbols
    ]
    S = sensitivities(System(physics, drive, v, {}), X, recursion, variations)
    signs = np.concatenate([np.zeros((5, 1)), np.eye(5), -np.eye(5)], axis=1)
    numbers = {k: TABLE_1[k] * np.exp(h * sign) for k, sign in zip(symbols, signs, strict=True)}
    found = melting(melts["L"], melts["w"], current, inlet, np.full((2, 11), 24.0), numbers)
    expected = (found[..., 1:6] - found[..., 6:]) / (2 * h)
    assert np.abs(X - found[..., 0]).max() < 0.05
    assert (np.abs(S - expected).max(axis=(0, 1)) < 0.05 * np.abs(expected).max(axis=(0, 1))).all()


def test_each_span_starts_anew_and_none_sees_the_other():
    physics, v, drive, *_ = string_of(2)
    start = physics.start(np.full(2, 24.0), np.full(2, 24.0), v)
    spans = [Span(0, 600), Span(601, SECONDS)]
    both, _, _ = run(physics, v, drive, start, spans=spans)
    alone = [run(physics, v, cut(drive, s.first, s.last), start)[0] for s in spans]
    assert both.shape == (600 + 1 + SECONDS - 601 + 1, 4)
    assert np.allclose(both, np.concatenate(alone), atol=1e-4)


@pytest.mark.parametrize("columns", [1, 2, 90])  # few numbers as one response, many in blocks
@pytest.mark.parametrize("states", [1, 3, 12])
@pytest.mark.parametrize("steps", [1, 2, 7, 100, 101, 900])
def test_the_blockwise_recursion_is_the_plain_one(steps, states, columns):
    rng = np.random.default_rng(steps)
    A = -np.diag(rng.uniform(0.01, 2.0, states)) + 0.01 * rng.normal(size=(states, states)) / states
    recursion = Recursion(A, 1.0, 64)
    x0, w = rng.normal(size=(states, columns)), rng.normal(size=(steps, states, columns))
    plain = [x0]
    for u in w:
        plain.append(recursion.Phi @ plain[-1] + recursion.Gamma @ u)
    assert np.allclose(recursion.run(x0, w), plain, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("driven", [(), (5,), (0, 41), range(70)])
@pytest.mark.parametrize("steps", [1, 8, 65])
def test_the_recursion_of_a_long_string_is_the_plain_one(steps, driven):
    # many columns of many states are stepped, and only what is driven is multiplied
    rng = np.random.default_rng(steps)
    A = -np.diag(rng.uniform(0.01, 0.5, 70)) + 0.002 * rng.normal(size=(70, 70))
    recursion = Recursion(A, 1.0, 64)
    x0, w = rng.normal(size=(70, 20)), np.zeros((steps, 70, 20))
    w[:, list(driven)] = rng.normal(size=(steps, len(driven), 20))
    plain = [x0]
    for u in w:
        plain.append(recursion.Phi @ plain[-1] + recursion.Gamma @ u)
    assert np.allclose(recursion.run(x0, w), plain, rtol=1e-12, atol=1e-12)


def test_a_recursion_that_runs_away_is_infinite_and_says_nothing():
    # a fit may try such numbers on its way; the warning of the powers alone used to come through
    recursion = Recursion(np.array([[2.0, 0.0], [0.0, -1.0]]), 10.0, 3600)
    out = recursion.run(np.ones((2, 1)), np.ones((3600, 2, 1)))
    assert not np.isfinite(out[-1, 0, 0])
