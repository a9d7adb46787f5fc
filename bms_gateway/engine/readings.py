"""Inputs of the estimators at a tick: of all strings together, and of a single string.

There are many strings and a tick every second, so each measured quantity is one array for all strings. An object for
one string is made only for code that works string by string.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.current import Means
from bms_gateway.frames.vocabulary import Quantity
from bms_gateway.identify import PairMeans
from bms_gateway.thermal import Floats

Assigned = tuple[NDArray[np.int8], Floats]
"""For readings of one of several cells, at the cell assigned to each: number of the kind among `STATISTICS`, from 1,
and the reading, °C; 0 and NaN at the others."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One string at one tick.

    Attributes
    ----------
    means : Means
        Of current and voltage over the tick.
    current_quality : int
    slow : mapping of Quantity to float
        The inputs `SLOW` at the tick: coolant inlet, °C; flow, m³/s; state of charge, 0…1. NaN if unknown, and if no
        estimator of the string uses the input.
    y, age : ndarray (n,)
        Surface readings, °C, NaN without a new good one; seconds between reading and tick.
    quality : ndarray of uint8 (n,)
        Of the surface sensors; `Quality.ESTIMATED` for cells without one.
    cells : PairMeans or None
        Voltages of the cells with the current at their instants; None without voltages.
    """

    means: Means
    current_quality: int
    slow: Mapping[Quantity, float]
    y: Floats
    age: Floats
    quality: NDArray[np.uint8]
    cells: PairMeans | None = None

    @property
    def inlet(self) -> float:
        """Coolant inlet, °C."""
        return self.slow["coolant_inlet"]


@dataclass(frozen=True, slots=True)
class Layout:
    """Place of each string's cells in one row with the cells of all strings.

    Attributes
    ----------
    names : tuple of str
    parts : tuple of slice
        In the order of the plan.
    """

    names: tuple[str, ...]
    parts: tuple[slice, ...]

    @classmethod
    def of(cls, names: Sequence[str], cells: Sequence[int]) -> "Layout":
        """Make the layout of strings with these numbers of cells."""
        ends = accumulate(cells, initial=0)
        return cls(tuple(names), tuple(slice(first, end) for first, end in pairwise(ends)))


@dataclass(frozen=True, slots=True)
class Readings:
    """All S strings of N cells at one tick; the quantities are those of `Reading`.

    Attributes
    ----------
    means : ndarray (5, S)
        Of I, I², V, I·V and |I|: the fields of `Means` in their order.
    current_quality : ndarray of uint8 (S,)
    slow : mapping of Quantity to ndarray (S,)
    y, age : ndarray (N,)
    quality : ndarray of uint8 (N,)
    parts : tuple of slice
        The cells of each string among the N cells.
    cells : list of PairMeans or None
        One per string; empty if no string has voltages of its cells.
    several : tuple of ndarray (N,) or None
        Which readings belong to one of several cells; None if no string has such readings.
    """

    means: Floats
    current_quality: NDArray[np.uint8]
    slow: Mapping[Quantity, Floats]
    y: Floats
    age: Floats
    quality: NDArray[np.uint8]
    parts: tuple[slice, ...]
    cells: list[PairMeans | None] = field(default_factory=list)
    several: Assigned | None = None

    @property
    def inlet(self) -> Floats:
        """Coolant inlet (S,), °C."""
        return self.slow["coolant_inlet"]

    def seen(self, quality: np.uint8) -> NDArray[np.bool_]:
        """Return which strings (S,) have a surface of such a quality."""
        found = np.logical_or.reduceat(self.quality == quality, [part.start for part in self.parts])
        return np.asarray(found, dtype=np.bool_)

    def __getitem__(self, i: int) -> Reading:
        mine = self.parts[i]
        return Reading(
            Means(*self.means[:, i].tolist()),
            int(self.current_quality[i]),
            {quantity: float(x[i]) for quantity, x in self.slow.items()},
            self.y[mine],
            self.age[mine],
            self.quality[mine],
            self.cells[i] if self.cells else None,
        )
