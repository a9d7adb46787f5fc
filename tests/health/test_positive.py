"""States that are conditioned on heats which are not negative, beside draws of the same Gaussian."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_gateway.health.heat.positive import above_zero, not_cooled


@given(st.floats(-60.0, 60.0), st.floats(0.01, 20.0))
def test_a_quantity_above_zero_is_above_zero_and_better_known(mean: float, sd: float) -> None:
    m, v = above_zero(mean, sd)
    assert m > 0.0
    assert m >= mean
    assert 0.0 <= v <= sd**2 * (1.0 + 1e-9)


@pytest.mark.parametrize(("mean", "sd"), [(0.0, 1.0), (2.0, 1.0), (-1.0, 2.0), (-6.0, 3.0)])
def test_moments_are_those_of_the_draws_that_are_not_negative(mean: float, sd: float) -> None:
    x = np.random.default_rng(3).normal(mean, sd, 4_000_000)
    x = x[x >= 0.0]
    m, v = above_zero(mean, sd)
    assert m == pytest.approx(x.mean(), rel=0.01)
    assert v == pytest.approx(x.var(), rel=0.02)


def test_a_heat_beside_one_that_is_impossible_is_as_small_as_their_sum() -> None:
    """70 W and −68 W, each ± 30 W, whose sum is known to 1 W; a core follows the first one."""
    P = np.array([[900.0, -899.5, 1800.0], [-899.5, 900.0, -1799.0], [1800.0, -1799.0, 3700.0]])
    mean = np.array([70.0, -68.0, 190.0])
    z, Q = not_cooled(mean, P, np.array([0, 1]))
    draws = np.random.default_rng(4).multivariate_normal(mean, P, 4_000_000)
    sound = draws[draws[:, 1] >= 0.0]
    assert len(sound) > 10_000
    assert z == pytest.approx(sound.mean(axis=0), abs=1.0)
    assert np.sqrt(np.diag(Q)) == pytest.approx(sound.std(axis=0), rel=0.05)
    assert np.linalg.eigvalsh(Q).min() > -1e-9


def test_heats_that_may_be_positive_are_left_as_they_are() -> None:
    z, P = np.array([20.0, -3.0]), np.array([[9.0, -5.0], [-5.0, 4.0]])
    same, Q = not_cooled(z, P, np.array([0, 1]))
    np.testing.assert_array_equal(same, z)
    np.testing.assert_array_equal(Q, P)
