"""Times of the readings within a step, and the ticks of the watch's balances from the ticks of a gateway."""

import numpy as np

from bms_gateway.thermal import Floats

MOST_TICKS = 12
"""Most ticks in the balances of a step: about a second each. Shorter ticks are merged."""


def merged(ticks: int) -> Floats:
    """Weights (L, ticks) of the ticks of a step in the means over its L even parts, the ticks of the balances.

    >>> merged(2).tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    >>> merged(24).shape, float(merged(24)[0, 1]), float(merged(18)[0, 1].round(4))
    ((12, 24), 0.5, 0.3333)
    """
    L = min(ticks, MOST_TICKS)
    bounds = np.arange(L + 1) / L * ticks
    k = np.arange(ticks)
    shared = np.minimum(bounds[1:, None], k + 1.0) - np.maximum(bounds[:-1, None], k)
    return np.asarray(np.maximum(shared, 0.0) * (L / ticks), dtype=np.float64)


def weights(y: Floats, age: Floats, tick_s: float, L: int) -> Floats:
    """Weights of tick ends in the mean of a thermocouple's readings: first of the previous step, then of this step.

    A reading between two ends has a share of both. A reading from before the previous step counts as read at its start.

    Parameters
    ----------
    y, age : ndarray (ticks, S, m), °C, s
        As read in the gateway's ticks of `tick_s` seconds; NaN without a reading.

    Returns
    -------
    ndarray (S, m, 2 L + 1)
        Their sum is 1. The middle one belongs to the end of the previous step, which is the start of this one. Without
        a reading, the last one is 1.

    >>> weights(np.array([[[20.0]], [[21.0]]]), np.array([[[0.0]], [[0.5]]]), 1.0, 2).tolist()
    [[[0.0, 0.0, 0.0, 0.75, 0.25]]]
    >>> weights(np.array([[[20.0]], [[np.nan]]]), np.array([[[2.0]], [[0.0]]]), 1.0, 2).tolist()
    [[[0.0, 1.0, 0.0, 0.0, 0.0]]]
    """
    there = np.isfinite(y)
    ticks = len(y)
    ends = np.arange(1, ticks + 1)[:, None, None]
    when = (ends - np.where(there, age, 0.0) / tick_s) * (L / ticks)
    instants = np.arange(-L, L + 1)
    w = np.maximum(0.0, 1.0 - np.abs(np.clip(when, -L, L)[..., None] - instants))
    w = np.where(there[..., None], w, 0.0).sum(axis=0)
    number = there.sum(axis=0)[..., None]
    return np.asarray(np.where(number > 0, w / np.maximum(number, 1), instants == L), dtype=np.float64)
