"""The likelihood of rounded readings against its definition, by numerical integration of a density."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from bms_gateway.identify.likelihood import curvature, expected_squares, generalised


@pytest.mark.parametrize(("sigma0", "step"), [(0.1, 0.5), (0.1, 0.1), (0.05, 0.2)])
@pytest.mark.parametrize("u", [-0.4, -0.05, 0.0, 0.11, 0.3])
def test_the_deviance_is_that_of_the_interval(sigma0, step, u):
    def density(e):
        return np.exp(-0.5 * (e / sigma0) ** 2) / (sigma0 * np.sqrt(2 * np.pi))

    share = quad(density, u - step / 2, u + step / 2, epsabs=1e-14)[0]
    expected = -2 * np.log(share / (step * density(0.0)))
    assert generalised(np.array([u]), np.array([sigma0]), np.array([step]))[1][0] == pytest.approx(expected, rel=1e-6)


@settings(deadline=None)
@given(st.floats(-3, 3), st.floats(0.02, 0.3), st.floats(0, 0.6))
def test_the_residual_is_the_slope_of_the_deviance(u, sigma0, step):
    s, q, h = np.array([sigma0]), np.array([step]), 1e-6
    up, down = (generalised(np.array([u + d]), s, q)[1][0] for d in (h, -h))
    slope = (up - down) / (2 * h)  # dD/du = 2 r / σ
    r = generalised(np.array([u]), s, q)[0][0]
    sigma = np.sqrt(sigma0**2 + step**2 / 12)
    assert np.isfinite(r)
    assert slope / 2 * sigma == pytest.approx(r, rel=1e-3, abs=1e-3)


def test_fine_steps_are_plain_least_squares():
    u, s = np.linspace(-1, 1, 9), np.full(9, 0.1)
    r, deviance = generalised(u, s, np.zeros(9))
    assert np.allclose(r, u / 0.1)
    assert np.allclose(deviance, (u / 0.1) ** 2)
    assert curvature(u, s, np.zeros(9)) == 1.0


@pytest.mark.parametrize(("sigma0", "step"), [(0.1, 0.5), (0.05, 0.5), (0.2, 0.25)])
def test_a_right_model_leaves_scores_whose_variance_is_the_curvature(sigma0, step):
    rng = np.random.default_rng(1)
    true = rng.uniform(20, 40, 40_000)
    y = step * np.round((true + sigma0 * rng.normal(size=true.size)) / step)
    s, q = np.full(true.size, sigma0), np.full(true.size, step)
    r = generalised(y - true, s, q)[0]
    assert abs(r.mean()) < 0.03
    assert np.mean(r**2) == pytest.approx(curvature(y - true, s, q), rel=0.05)


@pytest.mark.parametrize(("sigma0", "step"), [(0.05, 0.5), (0.1, 0.25), (0.1, 0.12), (0.2, 0.1), (0.1, 0.0)])
@pytest.mark.parametrize("place", [0.0, 0.3, 0.5])
def test_the_expected_square_is_what_many_readings_of_one_temperature_leave(sigma0, step, place):
    """Near the edge of a level (half a step beside it) readings tell much, in its middle nothing."""
    true, n = 25.0 + place * step, 400_000
    y = true + sigma0 * np.random.default_rng(3).normal(size=n)
    y = step * np.round(y / step) if step else y
    s, q = np.full(n, sigma0), np.full(n, step)
    squares = generalised(y - true, s, q)[0] ** 2
    # whichever of the levels a reading fell on tells the same of them all
    mean, variance = expected_squares((y - true)[:50], s[:50], q[:50])
    fine = step <= sigma0  # taken for Gaussian, which they are to a tenth
    assert mean == pytest.approx(np.mean(squares), rel=0.1 if fine else 0.02, abs=0.02 * (not fine))
    assert variance == pytest.approx(np.var(squares), rel=0.25 if fine else 0.05, abs=0.1 * (not fine))
