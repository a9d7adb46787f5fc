r"""A time without frames, in steps: the heat of an unseen drive in it, and inputs that are measured again after it.

The heat of a drive comes in phases of a minute or two. The heat of the last phase has warmed the cores but has not
reached the surfaces yet. After ten minutes unseen, a surface therefore shows the mean of the heat and not the
temperature of the core. A constant offset of ten minutes cannot describe this, because it binds the core to the
surface. σ is the standard deviation of a minute's heat and τ the length of a phase. The variance of the heat gathered
:math:`s` seconds after the last frame grows by

.. math::

    \frac{d}{ds} \operatorname{var} \int_0^s (q - \bar q) \, dt = 2 \tau \sigma^2 (1 - e^{-s/\tau})^2

like that of a first-order process that starts at a known value. It acts on the cores as white noise of that intensity.
The probability that the drive still goes on decays with the correlation time of heat errors, as in `unseen`.

An inlet whose last value was held is measured again at the end of the gap. The surfaces have followed the true inlet:
its offset is corrected, not discarded (`found_again`).
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
"""First step over a gap, and growth of each next step: a string at rest moves ever more slowly. The last step is short
again, so that surfaces and their sensitivities are those of the end."""
STEEP_SHARE = 120.0
"""Where the balances bend within a kelvin, a step is at most the first one or this share of the time before it: a
longer step would pass over a melting point."""
PHASE_S = 60.0
PHASE = 1.0
"""Standard deviation of a minute's heat, as a share of its mean over ten minutes: 0.7 to 1.0 in drive cycles of roads.
After a calm stretch, the heat of a cell at work is assumed nevertheless."""


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
    """Intensity of the heat of unseen phases, W²s.

    Parameters
    ----------
    since_s : float, s
        Time since the last frame.
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
    """Transition by `A` (M, M), and covariance after `dt` s of white heat on the cores, `intensity` in W²s."""
    acts = A[:, -1].copy()
    acts[-1] = 0.0
    return gathered_noise(A, intensity * acts[:, None] * acts, dt)


def unseen_phases(A: Floats, gap_s: float, usual: float, disturbance: Disturbance) -> Floats:
    """Covariance (M, M) from the phases of a drive after a gap, in a string with the rates `A` (M, M), 1/s."""
    P = np.zeros_like(A)
    for done, h in steps(gap_s):
        Phi, more = unseen_heat(A, phases(done + h / 2.0, usual, disturbance), h)
        P = Phi @ P @ Phi.T + more
    return P


def strayed(disturbance: Disturbance, moved: float, gap_s: float) -> Disturbance:
    """Widen the uncertainty of an inlet that moved by `moved` K in a gap, slowly or at any moment.

    Halfway along a straight line, a step at an unknown time leaves D²/4, as white noise of D²/T between its ends does.
    """
    jump = moved * sqrt(disturbance.correlation / (2.0 * gap_s))
    return replace(disturbance, inlet_unknown=hypot(disturbance.inlet_unknown, jump))


def found_again(b: Belief, at: int, moved: float, cov: Floats, sd: float) -> Belief:
    """Correct for an input that changed while it was not measured and its last value was held.

    The surfaces have followed it, so the new value is a reading like theirs. If its offset were only discarded, the
    surfaces would count as uncertain as the input was, and would say little about the cores until they had settled.

    Parameters
    ----------
    b : Belief
    at : int
        Index of the input's offset.
    moved : float, K
        Measured value minus the held one.
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
    """Use the news that inputs are measured again.

    Parameters
    ----------
    b : Belief
        Offsets last.
    back : ndarray of bool (2,)
        Whether inlet and current are measured again.
    moved : float, K
        Measured inlet minus the held one; ignored unless the inlet is measured again.
    cov : ndarray (p, p)
        Of the numbers considered.
    disturbance : Disturbance

    Returns
    -------
    Belief
        The offset of the inlet is about its new value; the offset of heat starts anew, as it belongs to its
        measurement.
    """
    if back[0]:
        b = found_again(b, -OFFSETS, moved, cov, disturbance.inlet)
    return _of_heat(b, disturbance.heat_common) if back[1] else b


def unknown_heat(b: Belief, usual: float, disturbance: Disturbance) -> Belief:
    """Begin a time without measured current: its heat differs from the usual one as in an unseen time.

    An offset that only grew from that of measured heat would take a minute to cover what happens in seconds.
    """
    return _of_heat(b, float(spread(usual, 0.0, disturbance)))


def _of_heat(b: Belief, sd: float) -> Belief:
    """Begin the offset of heat anew, `sd` W wide."""
    z, P, J = b.z.copy(), b.P.copy(), b.J.copy()
    z[-1], P[-1, :], P[:, -1], J[-1] = 0.0, 0.0, 0.0, 0.0
    P[-1, -1] = sd**2
    return Belief(z, P, J)
