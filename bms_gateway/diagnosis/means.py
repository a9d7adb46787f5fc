"""Exact means of a logged signal, its magnitude and its products over the intervals of a grid.

A signal is a chain of straight pieces (`Path`). How two rows are connected is decided when the path is made. All means
are exact integrals of this path, so that ten rows per second give the true mean square of a second.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Path:
    """A sequence of P straight pieces, with possible steps between them; beyond the ends the end values continue.

    Attributes
    ----------
    breaks : ndarray (P + 1,)
        s, not decreasing.
    first, last : ndarray (P,)
        Value at the two ends of each piece.
    """

    breaks: Floats
    first: Floats
    last: Floats

    def over(self, edges: Floats) -> tuple[Floats, Floats]:
        """Values just after the start and just before the end of intervals that no break cuts, (E − 1,) each."""
        piece = np.searchsorted(self.breaks, 0.5 * (edges[1:] + edges[:-1]), "right") - 1
        piece = np.clip(piece, 0, len(self.first) - 1)
        width = self.breaks[piece + 1] - self.breaks[piece]
        width = np.where(width > 0.0, width, 1.0)
        rise = self.last[piece] - self.first[piece]

        def at(t: Floats) -> Floats:
            return np.asarray(self.first[piece] + rise * np.clip((t - self.breaks[piece]) / width, 0.0, 1.0))

        return at(edges[:-1]), at(edges[1:])


def path(t: Floats, x: Floats, straight: NDArray[np.bool_] | bool, *, half_way: bool = False) -> Path:
    """Make the path of a signal through its rows.

    Parameters
    ----------
    t, x : ndarray (K,)
        Stamps, s, increasing, and values; no NaN.
    straight : ndarray of bool (K − 1,), or bool
        Pairs of rows between which the value is linear; between the others it steps.
    half_way : bool
        Whether steps are half-way between their rows; otherwise they are at the later row.
    """
    line = np.broadcast_to(np.asarray(straight, np.bool_), (len(t) - 1,))
    centre = 0.5 * (t[1:] + t[:-1])
    a, b = x[:-1], x[1:]
    middle = 0.5 * (a + b)
    after = b if half_way else a
    # two pieces for each pair of rows, and one that continues the last value
    breaks = np.empty(2 * len(t))
    breaks[0:-1:2], breaks[1:-2:2], breaks[-1] = t, centre, t[-1] + 1.0
    first, last = np.empty(2 * len(t) - 1), np.empty(2 * len(t) - 1)
    first[0:-1:2], last[0:-1:2] = a, np.where(line, middle, a)
    first[1:-1:2], last[1:-1:2] = np.where(line, middle, after), np.where(line, b, after)
    first[-1] = last[-1] = x[-1]
    return Path(breaks, first, last)


def mean(instants: Floats, p: Path) -> Floats:
    """Mean over each interval between instants (N + 1,), (N,).

    Examples
    --------
    >>> t = np.arange(4.0)
    >>> mean(t, path(t, t, straight=True))
    array([0.5, 1.5, 2.5])
    """
    edges = _edges(instants, p)
    a, b = p.over(edges)
    return _gather(instants, edges, 0.5 * (a + b))


def mean_magnitude(instants: Floats, p: Path) -> Floats:
    """Mean of the magnitude over each interval."""
    edges = _edges(instants, p)
    a, b = p.over(edges)
    total = np.abs(a) + np.abs(b)
    crossed = (a**2 + b**2) / (2.0 * np.where(total > 0.0, total, 1.0))
    return _gather(instants, edges, np.where(a * b >= 0.0, 0.5 * total, crossed))


def mean_product(instants: Floats, p: Path, other: Path) -> Floats:
    """Mean of the product of two signals over each interval; of a signal with itself it is the mean square."""
    edges = _edges(instants, p, other)
    (a, b), (c, d) = p.over(edges), other.over(edges)
    return _gather(instants, edges, (2.0 * (a * c + b * d) + a * d + b * c) / 6.0)


def _edges(instants: Floats, *paths: Path) -> Floats:
    inner = np.concatenate([p.breaks for p in paths])
    return np.unique(np.concatenate([instants, inner[(inner > instants[0]) & (inner < instants[-1])]]))


def _gather(instants: Floats, edges: Floats, value: Floats) -> Floats:
    """Average values between edges, weighted by their share of each interval."""
    span = np.diff(edges)
    interval = np.searchsorted(instants, edges[:-1], "right") - 1
    total = np.bincount(interval, value * span, len(instants) - 1)
    return np.asarray(total / np.bincount(interval, span, len(instants) - 1))
