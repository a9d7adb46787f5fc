"""Recorded voltages of single cells, each with the current at its row."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

HELD_S = 1.5
"""Longest time after a current reading at which a voltage may be paired with it, as on the bus."""


@dataclass(frozen=True, slots=True)
class CellRows:
    """K rows.

    Attributes
    ----------
    time_s, current_A : ndarray (K,)
        NaN where a row has no current.
    voltage_V : mapping of cell (from 1) to ndarray (K,)
        NaN without a voltage.
    """

    time_s: Floats
    current_A: Floats
    voltage_V: Mapping[int, Floats]

    def over(self, instants: Floats, cells: int) -> list[PairMeans | None]:
        """Average over the intervals between instants (N + 1,); None for an interval without a voltage."""
        t, N = self.time_s, len(instants) - 1
        at = np.flatnonzero(np.isfinite(self.current_A))
        newest = np.searchsorted(t[at], t, "right") - 1
        there = newest >= 0
        held = at[np.maximum(newest, 0)]
        current = np.where(there & (t - t[held] <= HELD_S), self.current_A[held], np.nan)
        # a small tolerance for computed stamps
        interval = np.searchsorted(instants, t + 1e-6 * (instants[1] - instants[0]), "right") - 1
        within = (interval >= 0) & (interval < N)
        means = np.full((4, N, cells), np.nan)
        for cell, V in self.voltage_V.items():
            if 1 <= cell <= cells:
                used = within & np.isfinite(V) & np.isfinite(current)
                means[:, :, cell - 1] = _means(interval[used], current[used], V[used], N)
        heard = np.isfinite(means[3]).any(axis=1)
        return [PairMeans(*means[:, k]) if heard[k] else None for k in range(N)]


def _means(interval: NDArray[np.intp], current: Floats, voltage: Floats, N: int) -> Floats:
    """Means (4, N) of I, I², V, I V; NaN without a row."""
    products = (current, current**2, voltage, current * voltage)
    sums = np.array([np.bincount(interval, x, N) for x in products])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(sums / np.bincount(interval, minlength=N), dtype=np.float64)
