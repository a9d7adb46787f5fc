"""Readings that are the greatest, least or mean surface of several cells: the cell to which a reading belongs.

A bus with only such readings shows how warm *some* cell is. The greatest is assigned to the cell that the model
considers the hottest, the least to the coldest. A mean is compared with the mean of the model, at the cell that is
nearest to it. So each reading is a measurement of one surface, chosen again at every tick. If the cells differ, this is
the derivative of max, min and mean; if they do not differ, the choice does not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Statistic
from bms_gateway.thermal import Floats

STATISTICS: Final[tuple[Statistic, ...]] = ("max", "min", "mean")


def statistic_of(kind: Statistic, surfaces: Sequence[Floats] | Floats) -> Floats:
    """Greatest, least or mean (T,) of the surfaces (k, T) of several cells."""
    x = np.asarray(surfaces, np.float64)
    return np.asarray(x.max(axis=0) if kind == "max" else x.min(axis=0) if kind == "min" else x.mean(axis=0))


def stand_in(kind: Statistic, cells: Sequence[int]) -> int:
    """Choose the cell for a reading of several cells if no model says how the cells differ.

    The greatest reading belongs to the last cell, where the coolant is warmest, the least to the first cell, and the
    mean to the cell midway. So the three cells are not neighbours, whose temperatures conduction would equalise.

    Examples
    --------
    >>> [stand_in(kind, range(1, 97)) for kind in ("max", "min", "mean")]
    [96, 1, 49]
    """
    return int(cells[{"max": -1, "min": 0, "mean": len(cells) // 2}[kind]])


@dataclass(frozen=True, slots=True)
class OneOfSeveral:
    """One input that belongs to one of several cells.

    Attributes
    ----------
    input : int
    kind : {"max", "min", "mean"}
    cells : ndarray of intp (k,)
        Indices among all cells of all strings.
    """

    input: int
    kind: Statistic
    cells: NDArray[np.intp]

    @property
    def number(self) -> int:
        """Number of its kind among `STATISTICS`, from 1."""
        return STATISTICS.index(self.kind) + 1

    def place(self, value: float, y: Floats, expected: Floats | None) -> tuple[int, float]:
        """Find the cell to which the reading belongs, and the reading of its surface.

        Parameters
        ----------
        value : float
            The reading, °C.
        y : ndarray (N,)
            Readings of single cells, NaN without one; they replace the model's surfaces.
        expected : ndarray (N,) or None
            Surfaces of the model, °C.

        Returns
        -------
        cell, reading
            The cell is −1 if it has a sensor of its own.
        """
        T = np.full(len(self.cells), value) if expected is None else expected[self.cells].copy()
        measured = np.isfinite(y[self.cells])
        T[measured] = y[self.cells][measured]
        known = np.isfinite(T)
        if not known.any():
            return int(self.cells[len(self.cells) // 2]), value
        if self.kind == "mean":
            mean = float(T[known].mean())
            free = np.where(known & ~measured, np.abs(T - mean), np.inf)
            k = int(free.argmin())
            return (int(self.cells[k]), value + float(T[k]) - mean) if np.isfinite(free[k]) else (-1, value)
        k = int(np.nanargmax(T) if self.kind == "max" else np.nanargmin(T))
        return (-1, value) if measured[k] else (int(self.cells[k]), value)
