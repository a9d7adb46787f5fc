r"""A time without frames in steps, the heat of a drive that nobody saw in it, and an input that is measured again.

The heat of a drive comes in phases of a minute or two, and what the last of them left in the cores has not reached the
surfaces yet: after ten minutes unseen a surface tells the mean of the heat and not where the core is. An offset that
goes on for ten minutes cannot say this, as it binds the core to the surface. With σ the standard deviation of a
minute's heat and τ the length of a phase, the heat that has gathered :math:`s` seconds after it was last seen varies by

.. math::

    \frac{d}{ds} \operatorname{var} \int_0^s (q - \bar q) \, dt = 2 \tau \sigma^2 (1 - e^{-s/\tau})^2

as of a first-order process that starts where it was seen; it acts on the cores as white noise of that intensity. How
likely the drive still goes on dies away with the correlation time of heat errors, as in `unseen`.

An inlet that was held is measured again at the end, and tells where it has gone. Surfaces have followed it: its offset
is corrected, not forgotten (`found_again`).
"""

from collections.abc import Iterator
from dataclasses import replace
from math import exp, hypot, sqrt

import numpy as np

from bms_gateway.observe.consider import Belief, Readings, conditioned
from bms_gateway.observe.model import OFFSETS, Bools
from bms_gateway.observe.unseen import at_work, spread
from bms_gateway.thermal import Disturbance, Floats, gathered_noise

FIRST_STEP_S, GROWTH, LAST_STEP_S = 5.0, 1.5, 20.0
"""First step over a gap and how each next one grows, for a string at rest moves ever more slowly; the last one is short
again, that surfaces and their sensitivities are those of the end."""
STEEP_SHARE = 120.0
"""Where the balances bend within a kelvin, a step is the first one or this share of the time before it: a longer one
would leap over what melts."""
PHASE_S = 60.0
PHASE = 1.0
"""Standard deviation of a minute's heat, as a share of its mean over ten: 0.7 to 1.0 in drive cycles of roads. After
a calm stretch the heat of a cell at work is to be reckoned with nevertheless."""


def steps(gap_s: float, *, steep: bool = False) -> Iterator[tuple[float, float]]:
    """Cut a gap into steps; into many more where the balances are `steep`.

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
        last = grown if steep else LAST_STEP_S
        h = left if left < 2.0 * last else min(grown, left - last)
        yield done, h
        done += h
        grown = max(FIRST_STEP_S, done / STEEP_SHARE) if steep else grown * GROWTH


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
    [0, 4339, 7181, 0]
    """
    begun, goes_on = 1.0 - exp(-since_s / PHASE_S), exp(-since_s / disturbance.correlation)
    return 2.0 * PHASE_S * (PHASE * float(at_work(usual, disturbance))) ** 2 * begun**2 * goes_on


def unseen_heat(A: Floats, intensity: float, dt: float) -> tuple[Floats, Floats]:
    """Transition by `A` (M, M), and what the offset's heat leaves after `dt` s if it is white, `intensity` in W²s."""
    acts = A[:, -1].copy()
    acts[-1] = 0.0
    return gathered_noise(A, intensity * acts[:, None] * acts, dt)


def unseen_phases(A: Floats, gap_s: float, usual: float, disturbance: Disturbance) -> Floats:
    """Covariance (M, M) that the phases of a drive leave after a gap, in a string with the rates `A` (M, M), 1/s."""
    P = np.zeros_like(A)
    for done, h in steps(gap_s):
        Phi, more = unseen_heat(A, phases(done + h / 2.0, usual, disturbance), h)
        P = Phi @ P @ Phi.T + more
    return P


def strayed(disturbance: Disturbance, moved: float, gap_s: float) -> Disturbance:
    """Widen what is not known of an inlet that went by `moved` K in a gap: slowly perhaps, or at any moment.

    Halfway along a straight line a step at an unknown time leaves D²/4, as white noise of D²/T does between its ends.
    """
    jump = moved * sqrt(disturbance.correlation / (2.0 * gap_s))
    return replace(disturbance, inlet_unknown=hypot(disturbance.inlet_unknown, jump))


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
    read = Readings(H, none, np.array([moved - b.z[at]]), np.zeros(1), sd)
    b, _ = conditioned(b, b, np.eye(len(b.z)), read, cov)
    z = b.z.copy()
    z[at] -= moved
    return Belief(z, b.P, b.J)


def resumed(b: Belief, back: Bools, moved: float, cov: Floats, disturbance: Disturbance) -> Belief:
    """Take in inputs that are measured again.

    Parameters
    ----------
    b : Belief
        Offsets last.
    back : ndarray of bool (2,)
        Whether these are the inlet, and the current.
    moved : float, K
        Measured inlet less the one held; of no account unless the inlet is back.
    cov : ndarray (p, p)
        Of the numbers considered.
    disturbance : Disturbance

    Returns
    -------
    Belief
        The offset of the inlet about its new value; that of heat starts anew, as it belongs to its measurement.
    """
    if back[0]:
        b = found_again(b, -OFFSETS, moved, cov, disturbance.inlet)
    return _of_heat(b, disturbance.heat_common) if back[1] else b


def unknown_heat(b: Belief, usual: float, disturbance: Disturbance) -> Belief:
    """Take in that the current is not measured any longer: from now on heat is off the usual one as in a time unseen.

    An offset that only grew from that of a measured heat would take a minute to be as wide as what happens in seconds.
    """
    return _of_heat(b, float(spread(usual, 0.0, disturbance)))


def _of_heat(b: Belief, sd: float) -> Belief:
    """Begin the offset of heat anew, `sd` W wide."""
    z, P, J = b.z.copy(), b.P.copy(), b.J.copy()
    z[-1], P[-1, :], P[:, -1], J[-1] = 0.0, 0.0, 0.0, 0.0
    P[-1, -1] = sd**2
    return Belief(z, P, J)
