"""Readings that are the greatest, least or mean surface of several cells: the cell to which a reading belongs.

A bus with only such readings tells how warm *some* cell is. The greatest is a measurement of the cell that the model
considers the hottest, the least of the coldest, and a mean of the cell that is nearest to the mean of the model. Where
the cells differ, this is the derivative of max, min and mean. Where they do not differ, any cell may stand for the
reading, but it must stay the same one: what is learnt of a cell, and the filter's steady gain, belong to that cell. A
reading therefore goes to another cell only where the model holds that one further out by `CLEARLY_K`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Statistic
from bms_gateway.thermal import Floats

NOWHERE: Final = -1
CLEARLY_K: Final = 0.5
"""By which another cell must be further out before a reading is taken for that cell's."""
SAME_K: Final = 1e-6


def statistic_of(kind: Statistic, surfaces: Sequence[Floats] | Floats) -> Floats:
    """Greatest, least or mean (T,) of the surfaces (k, T) of several cells."""
    x = np.asarray(surfaces, np.float64)
    return np.asarray(x.max(axis=0) if kind == "max" else x.min(axis=0) if kind == "min" else x.mean(axis=0))


def stand_in(kind: Statistic, cells: Sequence[int]) -> int:
    """Tell which of several equal cells stands for a reading.

    The greatest is the last one's, where coolant is warmest, the least the first one's, and the mean that of the one
    midway: conduction between neighbours then does not hold them together.

    Examples
    --------
    >>> [stand_in(kind, range(1, 97)) for kind in ("max", "min", "mean")]
    [96, 1, 49]
    """
    return int(cells[{"max": -1, "min": 0, "mean": len(cells) // 2}[kind]])


@dataclass(slots=True)
class OneOfSeveral:
    """One such input.

    Attributes
    ----------
    input : int
    kind : {"max", "min", "mean"}
    cells : ndarray of intp (k,)
        Among all cells of all strings.
    """

    input: int
    kind: Statistic
    cells: NDArray[np.intp]
    _place: int = NOWHERE
    _beside: float = 0.0

    def place(self, value: float, y: Floats, expected: Floats | None) -> tuple[int, float]:
        """Find the cell, and what its surface must be.

        Parameters
        ----------
        value : float
            The reading, °C.
        y : ndarray (N,)
            Readings of single cells, NaN without one: they are better than an expectation.
        expected : ndarray (N,) or None
            Surfaces that the model has, °C.

        Returns
        -------
        cell, reading
            −1 where a cell with a sensor of its own is the one.
        """
        T = np.full(len(self.cells), value) if expected is None else expected[self.cells]
        own = y[self.cells]
        measured = np.isfinite(own)
        T = np.where(measured, own, T)
        known = np.isfinite(T)
        if not known.any():
            T, known = np.full(len(T), value), np.ones(len(T), np.bool_)
        mean = float(T[known].mean())
        out = {"max": T, "min": -T, "mean": -np.abs(T - mean)}[self.kind]
        out = np.where(known if self.kind != "mean" else known & ~measured, out, -np.inf)
        best = float(out.max())
        if not np.isfinite(best):
            return -1, value
        k = self._place
        if k == NOWHERE or not out[k] >= best - CLEARLY_K:
            k = self._place = stand_in(self.kind, np.flatnonzero(out >= best - SAME_K).tolist())
            self._beside = float(T[k]) - mean if self.kind == "mean" else 0.0
        return (-1, value) if measured[k] else (int(self.cells[k]), value + self._beside)

    def forget(self) -> None:
        """Choose anew, as after a gap."""
        self._place = NOWHERE
