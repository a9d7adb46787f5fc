"""Where a window's fit ends: at a mode, in few simulations, with a band that reaches as far as the posterior."""

import numpy as np
import pytest

from bms_gateway.identify.carried import NAMES
from bms_gateway.identify.posterior_fit import split_normal
from bms_gateway.identify.window import WindowIdentifier
from bms_gateway.identify.window_evidence import Evidence, departures
from bms_gateway.identify.window_problem import ANNEAL, Point, Problem, Sizes
from bms_gateway.thermal import Floats
from tests.identify.drive import drive, measured, model, ticks

SIZES = Sizes(white=0.07, slow=0.02, tau=150.0, walk=0.01)


def problem_of(seed: int, cells: int, sensors: tuple[int, ...]) -> Problem:
    square, inlet, y, _ = measured(seed, cells=cells, sensors=sensors)
    known = model(cells, sensors)
    learner = WindowIdentifier(known)
    job = next(j for tick in ticks(square, inlet, y) if (j := learner.add(tick)) is not None)
    nothing = Evidence.none(len(known.priors), len(NAMES) + departures(known))
    return Problem(known, job.window, nothing, None, 1.0)


def led_in(problem: Problem) -> Point:
    """Lead a start far off to the neighbourhood of a mode, as a first window does."""
    phi, xi = problem.sought.mean.copy(), problem.xi0
    for scale in ANNEAL:
        point = problem.minimise(phi, xi, SIZES, scale, 6)
        phi, xi = point.phi, point.xi
    return point


def test_a_fit_takes_few_simulations(monkeypatch) -> None:
    """Bug: steps that take the response to the roll's share for straight turned about the mode and never arrived."""
    simulated = 0
    simulate = Problem.simulate

    def counted(problem: Problem, phi: Floats, xi: Floats) -> tuple[Floats, Floats, Floats]:
        nonlocal simulated
        simulated += 1
        return simulate(problem, phi, xi)

    monkeypatch.setattr(Problem, "simulate", counted)
    square, inlet, y, _ = measured(11, minutes=41)
    fits = drive(WindowIdentifier(model(R_e=3.5e-3, R_c=1.266, R_u=0.79)), ticks(square, inlet, y))
    assert len(fits) == 3
    assert simulated <= 3 * 25  # 91 where they turned about


@pytest.mark.parametrize(("seed", "cells", "sensors"), [(11, 1, (1,)), (13, 5, (1, 5))])
def test_a_fit_ends_at_a_mode(seed, cells, sensors) -> None:
    problem = problem_of(seed, cells, sensors)
    near = led_in(problem)
    point = problem.minimise(near.phi, near.xi, SIZES, 1.0, 20)
    q = problem.posterior(point)
    assert 0.5 * q.pull @ np.linalg.solve(q.H, q.pull) < 0.01  # of the log posterior, that one more step could gain


def test_a_root_is_not_weighed_by_what_a_step_to_the_other_one_promises() -> None:
    """Bug: a place between the roots, which the search had not left yet, counted as much as the mode itself."""
    problem = problem_of(14, 1, (1,))
    near = led_in(problem)
    mode = problem.minimise(near.phi, near.xi, SIZES, 1.0, 20)
    away = problem.at(mode.phi + np.array([0.0, 0.0, 0.3, -0.2, 0.0]), mode.xi, problem.whitener(SIZES), SIZES.walk)
    gained = problem.posterior(away).promise
    assert gained > 1.0
    for point in (mode, away):
        assert problem.score(point) == pytest.approx(
            point.cost + 0.5 * np.linalg.slogdet(problem.posterior(point).H)[1], abs=1e-6
        )
    assert problem.score(away) - problem.score(mode) > away.cost - mode.cost - 0.25 * gained


def test_a_profile_at_the_mode_is_the_modes_own() -> None:
    problem = problem_of(14, 1, (1,))
    near = led_in(problem)
    for _ in range(3):  # what carried effects do is taken along the trajectory of where each begins
        near = point = problem.minimise(near.phi, near.xi, SIZES, 1.0, 20)
    assert problem.profile(point.phi, point.xi, SIZES) == pytest.approx(point.cost, abs=0.02)
    away = point.phi + np.array([0.0, 0.0, 0.4, 0.0, 0.0])
    assert problem.profile(away, point.xi, SIZES) > point.cost + 1.0


@pytest.mark.parametrize("far", [0.3, 1.0, 4.0])
def test_a_split_normal_distribution_has_the_mean_and_variance_of_draws(far) -> None:
    rng = np.random.default_rng(3)
    sides = np.where(rng.uniform(size=400_000) < 1.0 / (1.0 + far), -1.0, far)
    x = sides * np.abs(rng.normal(size=sides.shape))
    mean, variance = split_normal(1.0, far)
    assert mean == pytest.approx(x.mean(), abs=0.02 * far)
    assert variance == pytest.approx(x.var(), rel=0.02)
