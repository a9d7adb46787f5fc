"""Readings of one string over a window or a record, stored with little memory.

A record of single cells takes an hour and a half, and few cells have a thermocouple. Of a block of ticks, only the
cells that were read are stored. Arrays of single ticks would take several times the memory of their numbers, and each
would keep the arrays of all strings in memory of which it is a view.
"""

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

GAP_S = 10.0
"""A longer tick is a gap: the bus was silent, and values interpolated through it would be invented."""
TOGETHER = 60
"""Number of ticks in one block."""


class Gathered:
    """Readings of n cells, tick after tick.

    Examples
    --------
    >>> readings = Gathered()
    >>> readings.add(np.array([25.0, np.nan]), np.array([0.5, 0.0]))
    >>> readings.take(np.array([[np.nan, 26.0]]), np.array([[0.0, 0.25]]))
    >>> readings.whole()[0].tolist()
    [[25.0, nan], [nan, 26.0]]
    """

    def __init__(self) -> None:
        self._cells = 0
        self._single: list[tuple[Floats, Floats]] = []
        self._blocks: list[tuple[NDArray[np.intp], Floats, Floats]] = []

    def add(self, surface: Floats, age: Floats) -> None:
        """Include the readings of one tick (n,), °C with NaN for none, and their age, s."""
        self._single.append((surface, age))
        if len(self._single) >= TOGETHER:
            self._stack()

    def take(self, surface: Floats, age: Floats) -> None:
        """Include the readings of several ticks (K, n)."""
        self._stack()
        self._keep(surface, age)

    def cut(self, ticks: int) -> None:
        """Keep only the first ticks."""
        surface, age = self.whole()
        self._single, self._blocks = [], []
        self._keep(surface[:ticks], age[:ticks])

    def drop(self, cell: int, ticks: int) -> None:
        """Remove the readings of a cell (0-based) in the last ticks."""
        surface, age = self.whole()
        surface[max(0, len(surface) - ticks) :, cell] = np.nan
        self._single, self._blocks = [], []
        self._keep(surface, age)

    def whole(self) -> tuple[Floats, Floats]:
        """Return all readings.

        Returns
        -------
        surface, age : ndarray (K, n)
            As they came; the age without a reading may have become 0.
        """
        self._stack()
        return self._of(np.arange(self._cells))

    def read(self) -> tuple[Floats, Floats, tuple[int, ...]]:
        """Return the readings of the cells that were ever read.

        Returns
        -------
        surface, age : ndarray (K, r)
            As of `whole`.
        cells : tuple of int
            0-based, ascending.
        """
        self._stack()
        cells = sorted({int(k) for read, _, _ in self._blocks for k in read})
        return *self._of(np.array(cells, np.intp)), tuple(cells)

    def _of(self, cells: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return readings (K, r) of `cells`, which include all cells that were read."""
        ticks = sum(len(surface) for _, surface, _ in self._blocks)
        surface, age = np.full((ticks, len(cells)), np.nan), np.zeros((ticks, len(cells)))
        end = 0
        for read, y, a in self._blocks:
            rows, at = slice(end, end := end + len(y)), np.searchsorted(cells, read)
            surface[rows, at], age[rows, at] = y, a
        return surface, age

    def _stack(self) -> None:
        if self._single:
            surface, age = zip(*self._single, strict=True)
            self._single = []
            self._keep(np.stack(surface), np.stack(age))

    def _keep(self, surface: Floats, age: Floats) -> None:
        self._cells = surface.shape[1]
        read = np.flatnonzero(np.isfinite(surface).any(axis=0))
        self._blocks.append((read, surface[:, read], age[:, read]))
