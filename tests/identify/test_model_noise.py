"""Noise with a slow part: whitened as the whole covariance has it."""

import numpy as np
import pytest

from bms_gateway.identify.model_noise import Whitener


@pytest.mark.parametrize("constant", [0.0, 0.4, 5.0])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_what_is_whitened_has_the_size_and_products_that_the_covariance_gives(missing, constant) -> None:
    K, m, c, white, slow, tau, dt = 200, 3, 4, 0.1, 0.3, 30.0, 2.0
    rng = np.random.default_rng(7)
    valid, x = rng.random((K, m)) >= missing, rng.normal(size=(K, m, c))
    valid[:, 2] &= constant != 0.4  # a thermocouple without a reading
    W = Whitener.of(valid, white, slow, tau, dt, constant)
    got = W(np.where(valid[:, :, None], x, np.nan))
    k = np.arange(K)
    whole = slow**2 * np.exp(-np.abs(k[:, None] - k) * dt / tau) + white**2 * np.eye(K) + constant**2
    log_det = 0.0
    for j in range(m):
        seen = valid[:, j]
        R, columns = whole[np.ix_(seen, seen)], x[seen, j]
        np.testing.assert_allclose(got[:, j].T @ got[:, j], columns.T @ np.linalg.solve(R, columns), rtol=1e-9)
        np.testing.assert_array_equal(got[~seen, j], 0.0)
        log_det += float(np.linalg.slogdet(R)[1])
        of_constant = constant**2 * np.sum(np.linalg.solve(R, columns[:, 0]))  # Gaussian conditioning, written out
        assert W.constants(np.where(valid, x[:, :, 0], np.nan))[j] == pytest.approx(of_constant, rel=1e-6, abs=1e-12)
    assert W.log_det == pytest.approx(log_det, rel=1e-12)
