r"""A time without frames in steps, the heat of a drive that nobody saw in it, and an input that is measured again.

The heat of a drive comes in phases of a minute or two, and what the last of them left in the cores has not reached the
surfaces yet: after ten minutes unseen a surface tells the mean of the heat and not where the core is. An offset that
goes on for ten minutes cannot say this, as it binds the core to the surface. With σ the standard deviation of a
minute's heat and τ the length of a phase, the heat that has gathered :math:`s` seconds after it was last seen varies by

.. math::

    \frac{d}{ds} \operatorname{var} \int_0^s (q - \bar q) \, dt = 2 \tau \sigma^2 (1 - e^{-s/\tau})^2

as of a first-order process that starts where it was seen; it acts on the cores as white noise of that intensity. How
likely the drive still goes on dies away with the correlation time of heat errors, as in `unseen`.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import exp

import numpy as np

from bms_gateway.observe.consider import Belief, conditioned
from bms_gateway.observe.model import OFFSETS
from bms_gateway.observe.tangent import Jacobian, disturbed
from bms_gateway.thermal import Disturbance, Floats
from bms_gateway.thermal.disturbance import gathered_noise
from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.physics import Memory, Numbers, Physics

FIRST_STEP_S, GROWTH, LAST_STEP_S = 5.0, 1.5, 20.0
"""First step over a gap and how each next one grows, for a string at rest moves ever more slowly; the last one is short
again, that surfaces and their sensitivities are those of the end."""
PHASE_S = 60.0
PHASE = 1.0
"""Standard deviation of a minute's heat, as a share of its mean over ten: 0.7 to 1.0 in drive cycles of roads. After
a calm stretch the heat of a cell at work is to be reckoned with nevertheless."""


def steps(gap_s: float) -> Iterator[tuple[float, float]]:
    """Cut a gap into steps.

    Yields
    ------
    begin, length : float, s

    Examples
    --------
    >>> list(steps(100.0))
    [(0.0, 5.0), (5.0, 7.5), (12.5, 11.25), (23.75, 16.875), (40.625, 25.3125), (65.9375, 34.0625)]
    """
    done, grown = 0.0, FIRST_STEP_S
    while done < gap_s:
        left = gap_s - done
        h = left if left < 2.0 * LAST_STEP_S else min(grown, left - LAST_STEP_S)
        yield done, h
        done, grown = done + h, grown * GROWTH


def phases(since_s: float, usual: float, disturbance: Disturbance) -> float:
    """Intensity of the heat of phases that nobody saw, W²s.

    Parameters
    ----------
    since_s : float, s
        How long nobody has looked.
    usual : float, W
        Mean heat of a cell in the minutes before.
    disturbance : Disturbance

    Examples
    --------
    >>> [round(phases(s, 10.0, Disturbance())) for s in (0.0, 60.0, 300.0, 36_000.0)]
    [0, 8677, 14361, 0]
    """
    begun, goes_on = 1.0 - exp(-since_s / PHASE_S), exp(-since_s / disturbance.correlation)
    return 2.0 * PHASE_S * (disturbance.heat_unknown**2 + (PHASE * usual) ** 2) * begun**2 * goes_on


def heated(j: Jacobian, physics: Physics, z: Floats, u: Drive, v: Numbers, memory: Memory) -> Jacobian:
    """Let the offset of heat act as a current's heat does: more where resistance is, by whatever the model knows of it.

    Where a current makes no heat of its own, because the model takes it from the voltage, it acts on all cores alike.
    """
    X, one = z[None, :-OFFSETS], np.full(1, 1.0 / float(np.mean(v.string.R_e)))
    w = disturbed(v, z[-OFFSETS:])
    slope = (physics.rates(X, replace(u, I2=u.I2 + one), w, memory) - physics.rates(X, u, w, memory))[0]
    if not np.isfinite(slope).all() or not slope.any():
        return j
    A = j.A.copy()
    A[: len(slope), -1] = slope
    return replace(j, A=A)


def unseen_heat(j: Jacobian, intensity: float, dt: float) -> Floats:
    """Covariance (D + 2, D + 2) that the offset's heat leaves after `dt` seconds if it is white, `intensity` in W²s."""
    acts = j.A[:, -1].copy()
    acts[-1] = 0.0
    return gathered_noise(j.A, intensity * acts[:, None] * acts, dt)[1]


def found_again(b: Belief, at: int, moved: float, cov: Floats, sd: float) -> Belief:
    """Take in where an input has gone while it was not measured and its last value was held.

    The surfaces have followed it, so it is a reading like theirs. Were its offset only forgotten, surfaces would be
    held for as uncertain as it was, and would tell little of the cores until they had settled about the new value.

    Parameters
    ----------
    b : Belief
    at : int
        Index of the input's offset.
    moved : float, K
        Measured value less the one held.
    cov : ndarray (p, p)
        Of the numbers considered.
    sd : float, K
        Of the offset while the input is measured.

    Returns
    -------
    Belief
        With the offset about the new value.

    Examples
    --------
    >>> before = Belief(np.array([20.0, 0.0]), np.array([[16.0, 20.0], [20.0, 25.0]]), np.zeros((2, 1)))
    >>> after = found_again(before, -1, 5.0, np.zeros((1, 1)), 0.5)
    >>> after.z.round(2).tolist(), after.P.diagonal().round(2).tolist()
    ([23.96, -0.05], [0.16, 0.25])
    """
    H, none = np.eye(len(b.z))[[at]], np.zeros((1, b.J.shape[1]))
    b, _ = conditioned(b, b, np.eye(len(b.z)), H, none, np.array([moved - b.z[at]]), np.zeros(1), cov, sd)
    z = b.z.copy()
    z[at] -= moved
    return Belief(z, b.P, b.J)
