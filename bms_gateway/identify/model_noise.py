r"""Noise of a surface reading about the model: white sensor noise plus a slow error of the model itself.

.. math::
    e_k = d_k + w_k, \qquad d_k = a d_{k-1} + v_k, \qquad w \sim N(0, \sigma_w^2), \quad d \sim N(0, \sigma_d^2),
    \quad a = e^{-\Delta t/\tau}

A two-node cell with constant parameters is only an approximation of the cell. Its error is slow and correlated; treated
as white noise it makes every parameter confidently wrong. The size σ_d of the slow error is found from the data by the
marginal likelihood (with its determinants): a profile likelihood sees only what the parameters could not absorb.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

SIZES = (0.02, 0.05, 0.12, 0.3, 0.8)
"""K: candidates for σ_d."""
TAUS = (30.0, 150.0)
"""s: candidates for τ, on either side of the gap between the cell's time constants; the drift covers slower errors."""


def white_sd(residual: Floats, floor: float) -> float:
    """Sensor noise from differences of neighbouring residuals, in which the slow part cancels.

    Parameters
    ----------
    residual : ndarray (K, m)
        K; NaN where there was no reading.
    floor : float
        Smallest accepted value, K: resolution and calibration of the best sensors.

    References
    ----------
    Not in the paper, whose signals have no noise.
    """
    d = np.diff(residual, axis=0)
    d = d[np.isfinite(d)]
    return floor if d.size < 10 else max(floor, float(np.sqrt(np.mean(d**2) / 2.0)))


@dataclass(frozen=True, slots=True)
class Whitener:
    """Kalman filter of the noise alone: turns columns into innovations in units of their sd.

    Attributes
    ----------
    keep, put : ndarray (K, m)
        d⁺ = keep d + put e.
    weight : ndarray (K, m)
        1/√S; zero where there was no reading.
    log_det : float
        ln of the determinant of the noise's covariance.
    same, cut : ndarray (K, m), (m,)
        Whitened unit constant of each column, and the factor on its product with them that is subtracted: what remains
        is white if each column has an unknown constant error.
    constant : float
        Its sd, K.

    References
    ----------
    Not in the paper; the filter of an AR(1) process in white noise.
    """

    keep: Floats
    put: Floats
    weight: Floats
    log_det: float
    same: Floats
    cut: Floats
    constant: float = 0.0

    @classmethod
    def of(
        cls, valid: NDArray[np.bool_], white: float | Floats, slow: float, tau: float, dt: float, constant: float = 0.0
    ) -> "Whitener":
        """Return gains for readings `valid` (K, m): σ_w = `white` > 0, of all or each, σ_d = `slow` ≥ 0 K, `dt` s.

        Each of the m has besides a constant error of sd `constant` K.
        """
        K, m = valid.shape
        a = math.exp(-dt / tau)
        gain, S = np.zeros((K, m)), np.ones((K, m))
        variance = np.broadcast_to(np.square(white), (K, m))
        for j in range(m):  # plain floats make a scalar recursion ten times faster
            p, seen, noise = slow**2, valid[:, j].tolist(), variance[:, j].tolist()
            g_j, S_j = [0.0] * K, [1.0] * K
            for k in range(K):
                if seen[k]:
                    S_j[k] = p + noise[k]
                    g_j[k] = p / S_j[k]
                p = a * a * p * (1.0 - g_j[k]) + (1.0 - a * a) * slow**2
            gain[:, j], S[:, j] = g_j, S_j
        alone = cls(
            a * (1.0 - gain), a * gain, valid / np.sqrt(S), float(np.log(S).sum()), np.ones((K, m)), np.zeros(m)
        )
        if constant == 0.0:
            return alone
        same = alone(np.ones((K, m, 1)))[:, :, 0]
        sum_sq = np.sum(same**2, axis=0)
        more = 1.0 + constant**2 * sum_sq  # of the variance along the constant
        cut = (1.0 - more**-0.5) / np.maximum(sum_sq, 1e-300)
        return replace(alone, same=same, cut=cut, constant=constant, log_det=alone.log_det + float(np.log(more).sum()))

    def __call__(self, columns: Floats) -> Floats:
        """Innovations (K, m, c) of `columns` (K, m, c); zero where there was no reading."""
        out = np.where(self.weight[:, :, None] > 0.0, columns, 0.0)
        fed, d = self.put[:, :, None] * out, np.zeros(out.shape[1:])
        for e, keep, put in zip(out, self.keep[:, :, None], fed, strict=True):  # all columns in each step
            e -= d
            d *= keep
            d += put
        out *= self.weight[:, :, None]
        if self.constant:
            along = self.cut[:, None] * np.einsum("km,kmc->mc", self.same, out)
            out -= self.same[:, :, None] * along
        return out

    def constants(self, residual: Floats) -> Floats:
        """Posterior means (m,) of the constant errors of `residual` (K, m), all else in it being noise."""
        found = np.sum(self.same * self(residual[:, :, None])[:, :, 0], axis=0)
        return np.asarray(self.constant**2 * found * (1.0 - self.cut * np.sum(self.same**2, axis=0)), dtype=np.float64)
