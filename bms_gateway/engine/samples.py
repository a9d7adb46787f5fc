"""Decoded samples in the order of the bus, and the values of all cells received in a tick."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Samples:
    """Decoded samples in the order of the bus."""

    time_ns: NDArray[np.int64]
    input: NDArray[np.intp]
    value: Floats
    flag: NDArray[np.uint8]

    def between(self, start: int, stop: int) -> "Samples":
        """Take samples start…stop − 1."""
        return Samples(self.time_ns[start:stop], self.input[start:stop], self.value[start:stop], self.flag[start:stop])

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Samples":
        """Take the chosen samples."""
        return Samples(self.time_ns[chosen], self.input[chosen], self.value[chosen], self.flag[chosen])

    def sorted_by_input(self, chosen: NDArray[np.bool_]) -> "Samples":
        """Take the chosen samples input by input, each in the order of the bus."""
        at = chosen.nonzero()[0]
        at = at.take(self.input.take(at).argsort(kind="stable"))
        return Samples(self.time_ns.take(at), self.input.take(at), self.value.take(at), self.flag.take(at))


@dataclass(frozen=True, slots=True)
class Raw:
    """Everything received of all N cells in a tick, before any guard.

    Attributes
    ----------
    value, time_s : ndarray (N,)
        Newest surface as decoded, °C, and its stamp, s; NaN if none came.
    invalid : ndarray of bool (N,)
        Cells for which the sender has sent "not available" or "error".
    volt : ndarray (N,)
        Newest voltage of the cell, V; NaN if none came.
    """

    value: Floats
    time_s: Floats
    invalid: NDArray[np.bool_]
    volt: Floats
