"""No cell cools by itself: a Gaussian state, conditioned on heat that is not negative."""

from math import erfc, exp, pi, sqrt

import numpy as np

from bms_gateway.health.heat.layout import Ints
from bms_gateway.thermal import Floats

IMPOSSIBLE_SD = 2.0
FAR = 25.0
"""sd beyond which the tail of a Gaussian is an exponential, to a part in 600."""


def above_zero(mean: float, sd: float) -> tuple[float, float]:
    """Mean and variance of a Gaussian quantity, given that it is not negative.

    >>> above_zero(0.0, 1.0)[0] == sqrt(2.0 / pi)
    True
    """
    a = -mean / sd
    if a > FAR:
        return sd / a, (sd / a) ** 2
    tail = erfc(a / sqrt(2.0)) / 2.0
    ratio = exp(-a * a / 2.0) / sqrt(2.0 * pi) / tail
    return mean + sd * ratio, sd * sd * max(0.0, 1.0 - ratio * (ratio - a))


def not_cooled(z: Floats, P: Floats, heats: Ints) -> tuple[Floats, Floats]:
    """Condition states on heats that are not negative.

    The heats of cells beside each other can hardly be told apart: the readings allow 40 W in one and −30 W in the next.
    A heat that is negative by more than `IMPOSSIBLE_SD` is conditioned on its sign, the least likely first (moments of
    a truncated Gaussian; the other states follow by regression). The others are left as they are: a short sits in one
    cell, and conditioning them would share its heat among the cells, with a band that is too narrow. The result is
    read, and never fed back into the filter: the same knowledge would count again in each step.

    Parameters
    ----------
    z : ndarray (N,)
    P : ndarray (N, N)
    heats : ndarray of int
        Indices of the heats, W.
    """
    z, P = z.copy(), P.copy()
    left = set(heats[np.diag(P)[heats] > 0.0].tolist())
    while left:
        i = min(left, key=lambda k: z[k] / sqrt(P[k, k]))
        if z[i] > -IMPOSSIBLE_SD * sqrt(P[i, i]):
            break
        left.remove(i)
        v = float(P[i, i])
        mean, var = above_zero(float(z[i]), sqrt(v))
        gain = P[:, i] / v
        z = z + gain * (mean - z[i])
        P = P + np.outer(gain, gain) * (var - v)
    return z, P
