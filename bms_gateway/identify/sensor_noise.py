r"""White noise and resolution of a sensor, from its own readings.

The signal is smooth from reading to reading, so the distance of a reading from the line between its neighbours is
noise. Rounding changes this: with steps q and noise σ below q/2 most readings repeat, and the remaining error is not
white. Averaged over the position of the true value between two steps, the white part of the variance is

.. math:: \frac{W}{q^2} = s^2 + \frac{1}{12} - \sum_{k \ge 1} \frac{e^{-4 \pi^2 k^2 s^2}}{2 \pi^2 k^2},
   \qquad s = \sigma / q

(the mean of the rounding error is a Fourier series of that position; its variance is the part that is not white). For
coarse noise this is Sheppard's σ² + q²/12, for fine noise σq/√π. Solved for s it gives noise far below the step.

Readings that a logger or a gateway puts between two others share their noise: half-way between, three times as little
of it is seen between neighbours. Readings two apart share none. Their deviation also has more of the signal, so that of
readings three apart shows how it grows with the distance.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

LEAST_K = 0.01
"""No thermometer in a pack is better; a smaller value would make a likelihood diverge."""
LEAST_STEPS = 0.1
"""Least noise as a share of a step: what the readings of a coarse sensor can still show."""
HALVINGS = 50
"""Tolerance of the root, relative to its interval; a library's solver takes longer to load."""
FINE_K = 1e-3
"""Smaller steps are the decimals of a file."""
OUTLIER = 4.0
"""Greater deviations are events of the signal, not noise."""
MOST, CROWDED = 0.9, 3.0
"""Share of the readings that lie on the levels of a coarse sensor, and the readings per level."""
SHARED, BY_CHANCE = 1.3, 12.0
"""Variance of readings two apart over that of neighbours, above which neighbours share noise, of many readings, and
what is added to it over the root of their number: three times the scatter by chance. Half-way between two readings the
ratio is 3."""
CALM = 0.5
"""Growth of the squared difference of readings from two to four apart, as a share, above which a signal is too fast."""
WHITENED = 0.2
"""Variance over the squared step above which the noise whitens the rounding: the part that persists is then a
hundredth of it, and does not look like shared noise."""
TERMS = np.arange(1, 9)


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of m sensors.

    Attributes
    ----------
    sigma : ndarray (m,)
        White noise before rounding, K.
    step : ndarray (m,)
        Resolution q, K; 0 if it is too fine to matter.
    """

    sigma: Floats
    step: Floats

    @property
    def total(self) -> Floats:
        """Noise and rounding together, K (m,): the residual of a perfect model."""
        return np.sqrt(self.sigma**2 + self.step**2 / 12.0)


def resolution(y: Floats) -> float:
    """Find the resolution of a sensor.

    Parameters
    ----------
    y : ndarray (K,)
        Readings; no NaN.

    Returns
    -------
    float
        K; 0 if it is finer than `FINE_K` or cannot be found.

    Examples
    --------
    >>> resolution(np.array([20.0, 20.5, 20.5, 21.0, 20.5, 20.0, 20.0]))
    0.5
    """
    levels, count = np.unique(np.round(y, 6), return_counts=True)
    # A file may contain interpolated values between levels: the levels are the values of most readings.
    order = np.argsort(-count, kind="stable")
    most = int(np.searchsorted(np.cumsum(count[order]), MOST * len(y))) + 1
    crowded = len(y) > CROWDED * most
    if crowded:
        levels = np.sort(levels[order[:most]])
    if len(levels) < 2:
        return 0.0
    gaps = np.diff(levels)
    # with few levels, the usual gap is the step, even if the file rounds 0.0625 to 0.06 and 0.07
    step = float(np.median(gaps) if crowded else gaps.min())
    return round(step, 6) if step >= FINE_K else 0.0


def white_noise(t: Floats, y: Floats, step: float) -> float:
    """Estimate the noise before rounding.

    Parameters
    ----------
    t, y : ndarray (K,)
        Stamps, s, increasing, and readings; no NaN.
    step : float
        From `resolution`.

    Returns
    -------
    float
        K, at least `LEAST_K` and `LEAST_STEPS` of a step.

    Notes
    -----
    On smooth signals with 3,600 readings within 10 % where σ > q/2; within σ/3 + q/20 below.
    """
    floor = max(LEAST_K, LEAST_STEPS * step)
    e = _out_of_line(t, y)
    if len(e) < 8:
        return floor
    W = _usual_square(e, step)
    if step == 0.0:
        return max(float(np.sqrt(W)), floor)
    # A clean staircase also moves, by its slope: two deviations of q per crossing, each squared over 6.
    crossings = float(np.abs(np.diff(_calm(y))).sum()) / step / len(y)
    W = max(W - min(crossings, 0.25) * step**2 / 3.0, 0.0)
    return max(_before_rounding(W / step**2) * step, floor)


def shared_noise(t: Floats, y: Floats, step: float) -> float:
    """Estimate the noise before rounding of readings that share it with their neighbours.

    Parameters
    ----------
    t, y, step
        As for `white_noise`.

    Returns
    -------
    float
        K; 0 if neighbours do not share noise, or if the signal is too fast or the step too coarse to tell.
    """
    apart = [_out_of_line(t, y, distance) for distance in (1, 2, 3)]
    if len(apart[-1]) < 8:
        return 0.0
    near, two, three = (_usual_square(e, step) for e in apart)
    whole = two - 2.0 * max(three - two, 0.0)  # a signal grows with the distance, or faster
    least = max((SHARED + BY_CHANCE / np.sqrt(len(y))) * near, WHITENED * step**2)
    short, long = (_usual_square(y[k:] - y[:-k], step) for k in (2, 4))
    if whole <= least or long > (1.0 + CALM) * short:
        return 0.0
    return float(np.sqrt(whole - step**2 / 12.0))


def slow_rounding(t: Floats, y: Floats) -> float:
    r"""Estimate the part of a sensor's rounding error that persists from reading to reading.

    Noise whitens the rest. With the equation of the module, and σ before rounding:

    .. math:: q^2 \sum_{k \ge 1} \frac{e^{-4 \pi^2 k^2 s^2}}{2 \pi^2 k^2}, \qquad s = \sigma / q

    Parameters
    ----------
    t, y : ndarray (K,)
        Stamps, s, increasing, and readings; no NaN.

    Returns
    -------
    float
        K; 0 if the sensor has no steps, or none can be found.

    Examples
    --------
    >>> t = np.arange(3600.0)
    >>> rise = 30.0 + 5.0 * np.sin(t / 600.0)
    >>> round(slow_rounding(t, np.round(rise)), 2)  # of 1 / sqrt(12)
    0.29
    >>> slow_rounding(t, rise)
    0.0
    """
    step = resolution(y) if len(y) else 0.0
    if step == 0.0:
        return 0.0
    sigma = white_noise(t, y, step)
    s = sigma / step if sigma > LEAST_STEPS * step else 0.0
    return step * float(np.sqrt(np.sum(_kept(s)) if s > 0.0 else 1.0 / 12.0))


def estimate_noise(t: Floats, y: Floats, sensor: NDArray[np.intp], sensors: int) -> Noise:
    """Noise and resolution of each sensor.

    Parameters
    ----------
    t, y : ndarray (M,)
        Stamps, s, and readings of all sensors, each sensor's in order of time.
    sensor : ndarray of intp (M,)
        Sensor of each reading.
    sensors : int
        Number of sensors, m.
    """
    step = np.array([resolution(y[sensor == j]) for j in range(sensors)])
    sigma = np.zeros(sensors)
    for j, q in enumerate(step.tolist()):
        mine = sensor == j
        sigma[j] = max(white_noise(t[mine], y[mine], q), shared_noise(t[mine], y[mine], q))
    return Noise(sigma, step)


def _out_of_line(t: Floats, y: Floats, k: int = 1) -> Floats:
    """Deviation of readings from the line between those `k` before and after, scaled to the variance of one reading."""
    if len(t) < 2 * k + 1:
        return np.empty(0)
    span = t[2 * k :] - t[: -2 * k]
    near = span <= 3.0 * float(np.median(span))
    share = (t[k:-k] - t[: -2 * k])[near] / span[near]
    e = y[k:-k][near] - (1.0 - share) * y[: -2 * k][near] - share * y[2 * k :][near]
    return np.asarray(e / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))


def _usual_square(e: Floats, step: float) -> float:
    """Mean square of deviations without events of the signal."""
    limit = max(OUTLIER * 1.4826 * float(np.median(np.abs(e))), 1.5 * step)
    for _ in range(3):
        limit = max(OUTLIER * float(np.sqrt(np.mean(e[np.abs(e) <= limit] ** 2))), 1.5 * step)
    return float(np.mean(e[np.abs(e) <= limit] ** 2))


def _calm(y: Floats) -> Floats:
    """Average over a fiftieth of the readings: the signal without its noise."""
    width = max(len(y) // 50, 3)
    total = np.cumsum(np.concatenate([[0.0], y]))
    return np.asarray((total[width:] - total[:-width]) / width)


def _kept(s: float) -> Floats:
    """Terms of the sum in the module's equation."""
    return np.asarray(np.exp(-4.0 * np.pi**2 * TERMS**2 * s**2) / (2.0 * np.pi**2 * TERMS**2))


def _before_rounding(W: float) -> float:
    """Solve the module's equation for s."""

    def white(s: float) -> float:
        # the sum at s = 0 instead of 1/12, so that eight terms are enough
        return float(s**2 + np.sum(_kept(0.0)) - np.sum(_kept(s)))

    if W >= 1.0:
        return float(np.sqrt(W - 1.0 / 12.0))
    low, high = 0.0, 1.1
    for _ in range(HALVINGS if W > 0.0 else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if white(middle) < W else (low, middle)
    return low
