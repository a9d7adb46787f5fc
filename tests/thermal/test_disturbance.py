"""Noise gathered over a step: against quadrature, composed of parts, and bounded over a parked night."""

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import quad_vec

from bms_gateway.thermal import StringParameters, continuous, gathered_noise
from tests.truth.string import C_F, TABLE_1


@pytest.fixture
def system():
    A = continuous(StringParameters.of(3, **TABLE_1, R_cc=4.0, C_f=C_F)).A
    G = np.random.default_rng(1).normal(size=(6, 3))
    return A, G @ G.T


@pytest.mark.parametrize("dt", [0.1, 1.0, 60.0])
def test_gathered_noise_is_the_integral(system, dt):
    A, W = system

    def integrand(t):
        E = scipy.linalg.expm(A * t)
        return E @ W @ E.T

    Phi, Q = gathered_noise(A, W, dt)
    np.testing.assert_allclose(Q, quad_vec(integrand, 0, dt, epsrel=1e-10)[0], rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(Phi, scipy.linalg.expm(A * dt), atol=1e-12)


def test_noise_of_a_step_is_that_of_its_parts(system):
    A, W = system
    Q = gathered_noise(A, W, 400.0)[1]
    half = gathered_noise(A, W, 200.0)[1]
    E = scipy.linalg.expm(A * 200.0)
    np.testing.assert_allclose(Q, E @ half @ E.T + half, rtol=1e-9)
    np.testing.assert_array_equal(Q, Q.T)


def test_a_parked_month_ends_in_the_stationary_covariance(system):
    A, W = system
    Phi, Q = gathered_noise(A, W, 30 * 86400.0)
    np.testing.assert_allclose(Q, scipy.linalg.solve_continuous_lyapunov(A, -W), rtol=1e-8)
    assert np.abs(Phi).max() < 1e-12
