r"""Kalman filter that considers numbers without estimating them: mean, covariance and sensitivities of one string.

The numbers θ, with covariance Σ, keep their values; J = ∂x̂/∂θ is carried (S. F. Schmidt 1966). U and S are the
readings' covariances for known numbers (late readings as in `kalman`), and G is their sensitivity:

.. math::
    K = (U + J^- \Sigma G^T)(S + G \Sigma G^T)^{-1}, \qquad J^+ = J^- - K G, \qquad
    P^+ = P^- - K U^T - U K^T + K S K^T

The last equation holds for any gain; this gain makes P + J Σ Jᵀ smallest.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.innovation_check import possible
from bms_gateway.observe.model import Ints
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Belief:
    """State of a string with its uncertainty.

    Attributes
    ----------
    z : ndarray (M,)
        State, offsets last.
    P : ndarray (M, M)
        Covariance if the numbers were known.
    J : ndarray (M, p)
        Sensitivity of `z` to the numbers.
    """

    z: Floats
    P: Floats
    J: Floats

    @property
    def finite(self) -> bool:
        """Whether all its values are finite."""
        return bool(np.isfinite(self.z).all() and np.isfinite(self.P).all() and np.isfinite(self.J).all())

    def loosened(self, at: Ints, grown: Floats) -> "Belief":
        """Increase the variances of the states `at` by `grown`, K²."""
        P = self.P.copy()
        P[at, at] += possible(grown, P[at, at])
        return Belief(self.z, P, self.J)


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings of m sensors in one step.

    Attributes
    ----------
    H, G : ndarray (m, M), (m, p)
        Slopes of the readings by the state, and by the numbers at a given state.
    r, w : ndarray (m,)
        Readings minus predictions, K; lag of the readings as a share of the step.
    sd : float, K
        Noise of a reading.
    """

    H: Floats
    G: Floats
    r: Floats
    w: Floats
    sd: float


def conditioned(before: Belief, now: Belief, Phi: Floats, read: Readings, cov: Floats) -> tuple[Belief, Floats]:
    """Use readings.

    Parameters
    ----------
    before, now : Belief
        One step ago, and predicted for now.
    Phi : ndarray (M, M)
        Transition between them.
    read : Readings
        Of m sensors.
    cov : ndarray (p, p)
        Of the numbers.

    Returns
    -------
    Belief
    sd : ndarray (m,), K
        Standard deviation of `read.r`, with the uncertainty of the numbers.
    """
    H, w = read.H, read.w
    v = 1.0 - w
    HP, HAP = H @ now.P, H @ before.P @ Phi.T
    U = (v[:, None] * HP + w[:, None] * HAP).T
    cross = v[:, None] * w * (HAP @ H.T).T
    S = np.outer(v, v) * (HP @ H.T) + cross + cross.T + np.outer(w, w) * (H @ before.P @ H.T)
    S[np.diag_indices_from(S)] += read.sd**2
    G = v[:, None] * (H @ now.J) + w[:, None] * (H @ before.J) + read.G
    Sigma_G = cov @ G.T
    total = S + G @ Sigma_G
    K = np.linalg.solve(total, (U + now.J @ Sigma_G).T).T
    KU = K @ U.T
    P = now.P - KU - KU.T + K @ S @ K.T
    return Belief(now.z + K @ read.r, (P + P.T) / 2.0, now.J - K @ G), np.sqrt(np.diag(total))
