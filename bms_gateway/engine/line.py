"""A slow input at the instant of a tick: the value of the straight line through its last readings.

A reading is up to a second old at the tick. Used directly, a moving coolant inlet would be late by half a second on
average, and identification would mistake this delay for heat capacity. The line also halves the noise of readings.
"""

from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

READINGS = 8  # the error at the line's end is then 0.65 of a reading's noise, still without lag
SPAN_NS = 20_000_000_000  # older readings may belong to another slope


class Line:
    """Readings of one input, the newest last."""

    def __init__(self) -> None:
        self._points: list[tuple[int, float]] = []

    def update(self, time_ns: NDArray[np.int64], value: Floats) -> None:
        """Add the readings of a tick."""
        if len(value):
            self._points += zip(time_ns.tolist(), value.tolist(), strict=True)
            newest = self._points[-1][0]
            self._points = [p for p in self._points[-READINGS:] if newest - p[0] <= SPAN_NS]

    def at(self, t: int) -> float:
        """Value at the instant `t`, ns; NaN before the first reading."""
        if not self._points:
            return nan
        n = len(self._points)
        mean_x = sum(p[0] - t for p in self._points) / n
        mean_y = sum(p[1] for p in self._points) / n
        spread = sum((p[0] - t - mean_x) ** 2 for p in self._points)
        if n < READINGS // 2 or spread == 0.0:
            return self._points[-1][1]
        slope = sum((p[0] - t - mean_x) * (p[1] - mean_y) for p in self._points) / spread
        return mean_y - slope * mean_x

    def forget(self) -> None:
        """Drop all readings."""
        self._points = []
