r"""Likelihood of a reading: white noise, then rounding to the resolution of the bus.

A reading y with step q means that the noisy value was in [y − q/2, y + q/2]. With noise sd σ₀ and u = y − f,

.. math::
    -2 \ln L = -2 \ln \frac{\Phi((u + q/2)/σ_0) - \Phi((u - q/2)/σ_0)}{2\,(q/2σ_0)\,\varphi(0)}

which is (u/σ₀)² for a fine step. Its derivative, the generalised residual, is white even for coarse steps, where the
plain residual is strongly coloured (Gourieroux et al., Generalised residuals, J. Econometrics 1987).
"""

import numpy as np
from scipy.special import ndtr

from bms_gateway.thermal import Floats

SQRT_2PI = float(np.sqrt(2.0 * np.pi))
_LOG_SQRT_2PI = float(np.log(SQRT_2PI))
FINE = 0.2
"""Steps below this share of the noise count as no rounding."""
LEVELS = 5
"""Range of levels on either side, in steps above the noise: no reading is outside."""
FAR = 25.0
"""sd: beyond, floating point cannot distinguish the two tails of the interval; only the nearer edge counts."""


def generalised(u: Floats, sigma0: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Residual and deviance of readings that lie `u` above the model.

    Parameters
    ----------
    u : ndarray (M,), K
        Reading minus model; NaN stays NaN.
    sigma0, step : ndarray (M,), K
        White noise before rounding, > 0, and resolution, ≥ 0.

    Returns
    -------
    r : ndarray (M,)
        Derivative of the log-likelihood with respect to the model, in units of 1/σ with σ² = σ₀² + q²/12. The plain
        u/σ for a fine step.
    deviance : ndarray (M,)
        −2 ln L up to a constant.
    """
    sigma = np.sqrt(sigma0**2 + step**2 / 12.0)
    fine = step < FINE * sigma0
    if fine.all():
        r = u / sigma
        return r, r * r
    x, h = u / sigma0, 0.5 * step / sigma0
    mirrored = np.abs(x)  # into the lower tail, where ndtr is accurate
    low, high = -mirrored - h, -mirrored + h
    p = ndtr(high) - ndtr(low)
    # beyond FAR only the edge counts: there p may be zero
    with np.errstate(divide="ignore", invalid="ignore"):
        log_p = np.log(p)
        mean = (np.exp(-0.5 * low**2) - np.exp(-0.5 * high**2)) / (SQRT_2PI * p)
    deviance = -2.0 * (log_p - np.log(np.maximum(2.0 * h, 1e-12)) + _LOG_SQRT_2PI)
    edge = mirrored - h
    far = edge > FAR
    if far.any():
        mean = np.where(far, -edge, mean)
        deviance = np.where(far, edge**2, deviance)
    r = np.copysign(mean, x) * (sigma / sigma0)
    if fine.any():
        r = np.where(fine, u / sigma, r)
        deviance = np.where(fine, (u / sigma) ** 2, deviance)
    return r, deviance


def curvature(u: Floats, sigma0: Floats, step: Floats) -> float:
    """Mean second derivative of half the deviance, in units of 1/σ².

    1 for fine steps. The deviance of coarse steps is flat inside their interval and steep outside: far from the
    optimum, a Hessian without this factor would be σ²/σ₀² too small, and steps too long by as much.
    """
    if np.all(step < FINE * sigma0):
        return 1.0
    sigma = np.sqrt(sigma0**2 + step**2 / 12.0)
    h = 0.1 * sigma0
    slope = (generalised(u + h, sigma0, step)[0] - generalised(u - h, sigma0, step)[0]) / (2.0 * h) * sigma
    return float(np.mean(slope))


def expected_squares(u: Floats, sigma0: Floats, step: Floats) -> tuple[Floats, Floats]:
    r"""Mean and variance (M,) of the squared generalised residual of each reading if the model is right.

    .. math:: E[r^2] = \sum_k p_k \, r(u_k)^2, \qquad p_k = \Phi((u_k + q/2)/σ_0) - \Phi((u_k - q/2)/σ_0)

    summed over the levels :math:`u_k` on which the reading may fall. It is the information of the reading: large where
    the model lies near the edge of a level, and nearly none where it lies in the middle of one.

    Parameters
    ----------
    u, sigma0, step : ndarray (M,), K
        As for `generalised`.
    """
    mean, square = np.ones(len(u)), np.full(len(u), 3.0)
    coarse = step > sigma0
    if coarse.any():
        q, s = step[coarse], sigma0[coarse]
        nearest = u[coarse] - q * np.round(u[coarse] / q)
        mean[coarse] = square[coarse] = 0.0
        for k in range(-LEVELS, LEVELS + 1):
            at = nearest + k * q
            p = ndtr((0.5 * q - np.abs(at)) / s) - ndtr((-0.5 * q - np.abs(at)) / s)
            squared = generalised(at, s, q)[0] ** 2
            mean[coarse] += p * squared
            square[coarse] += p * squared**2
    return mean, square - mean**2
