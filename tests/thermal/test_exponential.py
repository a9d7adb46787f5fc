"""The matrix exponential against many digits and scipy's, and what it makes of numbers that a fit tries on its way."""

import warnings
from decimal import Decimal, localcontext

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bms_gateway.thermal import StringParameters, continuous, discretize
from bms_gateway.thermal.exponential import exponential
from tests.truth.string import C_F, TABLE_1


def in_decimals(Z):
    """e^Z by its plain series in sixty digits."""
    with localcontext() as context:
        context.prec = 60
        exact = np.array([[Decimal(x) for x in row] for row in Z.tolist()], dtype=object)
        term = np.array([[Decimal(i == j) for j in range(len(Z))] for i in range(len(Z))], dtype=object)
        total = term
        for k in range(1, 90):
            term = term @ exact / Decimal(k)
            total = total + term
        return total.astype(np.float64)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 4).flatmap(lambda n: arrays(np.float64, (n, n), elements=st.floats(-3.0, 3.0))))
@example(np.full((2, 2), 2.0))  # of which scipy 1.17 has three digits less
def test_any_small_matrix_is_as_its_series_in_many_digits(Z) -> None:
    # what squaring may lose is in units of the largest number that it goes through
    scale = np.exp(np.abs(Z).sum(axis=0).max())
    np.testing.assert_allclose(exponential(Z), in_decimals(Z), rtol=0.0, atol=2e-15 * scale)


@pytest.mark.parametrize("cells", [1, 3, 18])
@pytest.mark.parametrize("dt", [0.1, 1.0, 60.0, 3600.0, 86400.0])
def test_a_string_is_carried_as_scipy_has_it_from_a_tick_to_a_day(cells, dt) -> None:
    s = continuous(StringParameters.of(cells, **TABLE_1, R_cc=4.0, C_f=C_F))
    np.testing.assert_allclose(exponential(s.A * dt), scipy.linalg.expm(s.A * dt), rtol=0.0, atol=2e-13)
    d = discretize(s, dt)
    F = np.zeros((3 * cells, 3 * cells))
    F[: 2 * cells, : 2 * cells], F[: 2 * cells, 2 * cells :] = s.A * dt, s.B_q * dt
    truth = scipy.linalg.expm(F)[: 2 * cells, 2 * cells :]
    np.testing.assert_allclose(d.B_q, truth, rtol=0.0, atol=1e-12 * np.abs(truth).max())


def test_what_runs_away_is_told_by_its_numbers_and_not_by_warnings() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.isfinite(exponential(np.array([[900.0, 1.0], [1.0, 900.0]]))).any()
        assert np.isnan(exponential(np.array([[np.inf, 0.0], [0.0, 0.0]]))).all()
        assert np.isnan(exponential(np.array([[0.0, np.nan], [0.0, 0.0]]))).all()
