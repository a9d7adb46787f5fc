"""Inlet and flow without their noise and without a lag.

With a noisy or rounded input, the best fit is a slower model, as if the coolant came late. Therefore a symmetric
smoother first removes the noise. The signal itself determines its width: white noise gives successive differences a
negative correlation, and real changes do not. Clean steps are not changed.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bms_gateway.identify.sensor_noise import resolution, white_noise
from bms_gateway.thermal import Floats

STEP = 6.0
"""Differences greater than so many times the usual one are steps of the signal, across which nothing is smoothed."""
TREND = 21
"""Number of differences whose mean is subtracted as the slope, so that a slope does not hide the noise."""
WIDTHS = (0.7, 1.0, 1.5, 2.2, 3.3, 5.0, 7.5, 11.0, 16.0, 24.0, 36.0, 54.0)
"""Widths of the kernel, in readings, of which one is chosen."""
COARSEST_K = 1.0
"""Greatest resolution of a thermometer: larger steps are real changes of the coolant."""
COARSE = 0.2
"""If the noise is below this share of the resolution, the signal is a staircase that averaging does not smooth."""


def smooth(t: Floats, x: Floats, *, coarsest: float = 0.0) -> Floats:
    """Remove noise and rounding from a slowly moving input.

    Parameters
    ----------
    t, x : ndarray (K,)
        Stamps, s, increasing, and readings; no NaN.
    coarsest : float
        Largest step that may be the sensor's resolution; larger steps count as real.

    Returns
    -------
    ndarray (K,)
        At the same stamps; exactly `x` if no noise is visible.
    """
    if len(x) < 2 * TREND or x.min() == x.max():
        return x
    step = resolution(x)
    if 0.0 < step <= coarsest and white_noise(t, x, step) < COARSE * step:
        x = _staircase(t, x, step)
    return _without_noise(x)


def _without_noise(x: Floats) -> Floats:
    """Smooth piece by piece between steps, with the kernel that Stein's unbiased estimate of the error prefers."""
    d = np.diff(x)
    moves = np.abs(d[d != 0.0])
    step = np.abs(d) > STEP * 1.4826 * float(np.median(moves)) if len(moves) else np.zeros(len(d), np.bool_)
    level = np.where(step, 0.0, d)
    level = level - np.convolve(level, np.full(TREND, 1.0 / TREND), "same")
    pairs = ~(step[1:] | step[:-1])
    if not pairs.any():
        return x
    total = float(np.mean(level[~step] ** 2))
    noise = -float(np.mean((level[1:] * level[:-1])[pairs]))
    if noise < 0.1 * total:  # pure noise gives a half; chance and curvature alone give up to a tenth
        return x
    bounds = [0, *(np.flatnonzero(step) + 1).tolist(), len(x)]
    best, least = x, noise
    for width in WIDTHS:
        out, centre = _convolved(x, bounds, width)
        error = float(np.mean((out - x) ** 2 + 2.0 * noise * centre)) - noise
        if error < least:
            best, least = out, error
    return best


def _convolved(x: Floats, bounds: Sequence[int], width: float) -> tuple[Floats, Floats]:
    """Return each piece under a kernel that keeps parabolas, and the weight of each reading in its own result."""
    reach = int(np.ceil(4.0 * width))
    u = np.arange(-reach, reach + 1) / width
    kernel = 0.5 * (3.0 - u**2) * np.exp(-0.5 * u**2)
    out, centre = np.empty_like(x), np.empty_like(x)
    for first, end in pairwise(bounds):
        piece = x[first:end] - x[first]
        side = min(reach, len(piece) - 1)
        weights = kernel[reach - side : reach + side + 1]
        here = slice(side, side + len(piece))
        share = np.convolve(np.ones(len(piece)), weights)[here]
        out[first:end] = x[first] + np.convolve(piece, weights)[here] / share
        centre[first:end] = kernel[reach] / share
    return out, centre


def _staircase(t: Floats, x: Floats, step: float) -> Floats:
    """Draw the line behind a staircase: half-way where it moves by one step, constant where it stays long.

    A change without another one in the same direction before or after it is a true step and is kept.
    """
    moves = np.flatnonzero(np.diff(x) != 0.0)
    change, rise = 0.5 * (t[moves] + t[moves + 1]), x[moves + 1] - x[moves]
    starts, ends = np.concatenate([t[:1], change]), np.concatenate([change, t[-1:]])
    level, length = x[np.concatenate([[0], moves + 1])], ends - starts
    # half the duration of a change: as long as the shorter stay between it and its like on either side
    like = np.concatenate([[False], (rise[1:] * rise[:-1] > 0.0), [False]])
    stay = np.where(like, length, np.inf)
    half = 0.5 * np.minimum(stay[1:], stay[:-1])
    half = np.where(np.isfinite(half) & (np.abs(rise) < 1.5 * step), half, 0.0)
    half = np.minimum(half, 0.5 * np.minimum(length[1:], length[:-1]))
    nodes = np.concatenate([starts + np.concatenate([[0.0], half]), ends - np.concatenate([half, [0.0]])])
    late = np.arange(len(nodes)) < len(level)  # if two runs meet in one instant, the earlier comes first
    order = np.lexsort((late, nodes))
    return np.asarray(np.interp(t, nodes[order], np.concatenate([level, level])[order]))
