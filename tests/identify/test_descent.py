"""The way down a cost against scipy's, and what a posterior to second order says against exact integrals."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from bms_gateway.identify.descent import Pace, Patience, descend
from bms_gateway.identify.quadratic import Quadratic, solved

BY_MARQUARDT = Pace(1e-8, 1e-8, 30.0, 0.1, 8)
BY_LEVENBERG = Pace(0.0, 1e-3, 4.0, 0.125, 24, halves=True)


@dataclass
class Stand:
    z: np.ndarray
    deviance: float


class Squares:
    """Sum of squares of residuals over numbers within bounds; None beyond a wall."""

    def __init__(self, residual, jacobian, lower, upper, wall=np.inf):
        self.residual, self.jacobian, self.lower, self.upper, self.wall = residual, jacobian, lower, upper, wall
        self.looks = 0

    def at(self, z, near):
        return Stand(z, float(np.sum(self.residual(z) ** 2))) if z[0] < self.wall else None

    def slopes(self, here, fresh):
        self.looks += fresh
        if fresh:
            self.J = self.jacobian(here.z)
        return Quadratic(self.J.T @ self.J, -self.J.T @ self.residual(here.z))

    def stiffness(self, H):
        return np.diag(H)

    def share(self, z, step):
        return min(1.0, 1.0 / max(float(np.max(np.abs(step))), 1e-300))


def well(rng, n):
    """A precision and pull of n numbers that are known unlike well."""
    A = rng.normal(size=(n + 3, n)) * 10.0 ** rng.uniform(-3.0, 3.0, n)
    return A.T @ A, A.T @ rng.normal(size=n + 3), A


@pytest.mark.parametrize("pace", [BY_MARQUARDT, BY_LEVENBERG])
@given(seed=st.integers(0, 10_000), n=st.integers(1, 7))
@settings(max_examples=60, deadline=None)
def test_a_bounded_quadratic_ends_where_scipy_ends(pace, seed, n):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(n + 3, n)), 3.0 * rng.normal(size=n + 3)
    lower, upper = -rng.uniform(0.1, 2.0, n), rng.uniform(0.1, 2.0, n)
    valley = Squares(lambda z: A @ z - b, lambda z: A, lower, upper)
    here, _ = descend(valley, valley.at(np.zeros(n), None), pace, Patience(200, 1e-13))
    best = optimize.lsq_linear(A, b, (lower, upper), tol=1e-14)
    assert (here.z >= lower).all()
    assert (here.z <= upper).all()
    assert here.deviance == pytest.approx(2.0 * best.cost, rel=1e-3, abs=1e-8)


@pytest.mark.parametrize("pace", [BY_MARQUARDT, BY_LEVENBERG])
@pytest.mark.parametrize("reuse", [True, False])
def test_a_bent_valley_is_followed_to_its_end(pace, reuse):
    """Rosenbrock's, from far off, around a wall beyond which there is no model."""
    valley = Squares(
        lambda z: np.array([10.0 * (z[1] - z[0] ** 2), 1.0 - z[0]]),
        lambda z: np.array([[-20.0 * z[0], 10.0], [-1.0, 0.0]]),
        np.full(2, -5.0), np.full(2, 5.0), wall=1.2,
    )  # fmt: skip
    here, slopes = descend(valley, valley.at(np.array([-1.9, 2.0]), None), pace, Patience(500, 1e-16, reuse=reuse))
    assert here.z == pytest.approx([1.0, 1.0], abs=1e-5)
    assert slopes.promise < 1e-8


def test_slopes_that_foretell_are_used_again_and_never_ended_on():
    A = np.diag([1.0, 30.0])
    valley = Squares(lambda z: A @ z - 1.0, lambda z: A, np.full(2, -9.0), np.full(2, 9.0))
    descend(valley, valley.at(np.full(2, 8.0), None), BY_MARQUARDT, Patience(50, 1e-9))
    dear = valley.looks
    valley.looks = 0
    here, _ = descend(valley, valley.at(np.full(2, 8.0), None), BY_MARQUARDT, Patience(50, 1e-9, reuse=False))
    assert here.z == pytest.approx([1.0, 1.0 / 30.0], abs=1e-4)
    assert dear < valley.looks


def test_the_outclassed_and_the_hopeless_end_early():
    far = np.array([6.0, 6.0])

    def looks(**patience):
        valley = Squares(
            lambda z: np.append(np.sin(z) + 0.1 * z, 3.0),
            lambda z: np.vstack([np.diag(np.cos(z) + 0.1), [0.0, 0.0]]),
            far - 9.0, far + 9.0,
        )  # fmt: skip
        descend(valley, valley.at(far, None), BY_MARQUARDT, Patience(60, 1e-12, reuse=False, **patience))
        return valley.looks

    assert looks(outclassed=1.0) < looks()
    assert looks(give_up=0.1) < looks()


@given(seed=st.integers(0, 10_000), n=st.integers(2, 6), kept=st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_a_marginal_is_the_block_of_the_covariance(seed, n, kept):
    rng = np.random.default_rng(seed)
    H, pull, A = well(rng, n)
    some = np.sort(rng.permutation(n)[: min(kept, n - 1)])
    q = Quadratic(H, pull).marginal(some)
    scale = np.linalg.norm(A, axis=0)
    half = np.linalg.inv(np.linalg.qr(A / scale)[1]) / scale[:, None]
    cov, mean = half @ half.T, half @ (half.T @ pull)
    sd = np.sqrt(np.diag(cov))[some]
    assert np.allclose(np.linalg.inv(q.H) / np.outer(sd, sd), cov[np.ix_(some, some)] / np.outer(sd, sd), atol=1e-5)
    assert np.allclose(q.step / sd, mean[some] / sd, atol=1e-4 * (1.0 + np.abs(mean[some] / sd)))


@given(seed=st.integers(0, 10_000), n=st.integers(1, 6))
@settings(max_examples=60, deadline=None)
def test_the_mass_of_a_normal_density_is_its_height_by_its_width(seed, n):
    """By scipy's normal density: deviance at any place and the quadratic there give the same mass."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n + 3, n))
    H = A.T @ A
    mean, z = rng.normal(size=n), rng.normal(size=n)
    density = stats.multivariate_normal(mean, np.linalg.inv(H))
    q = Quadratic(H, H @ (mean - z))
    mass = q.integrated(-2.0 * float(density.logpdf(z)))
    assert mass == pytest.approx(n * np.log(2.0 * np.pi), abs=1e-6)
    assert q.gained(q.step) == pytest.approx(q.promise, rel=1e-9)
    assert np.allclose(solved(H, np.eye(n)) @ H, np.eye(n), atol=1e-6)
