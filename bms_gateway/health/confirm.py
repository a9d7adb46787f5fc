"""Confirms that a surface below its limit is a cell that has cooled, and not a thermocouple that has come off.

A thermocouple that has come off reads the temperature of the air or of the coolant. While current flows, the surface of
a cell is above its coolant by the heat times R_u. A reading is therefore confirmed in three cases: good thermocouples
of the same string read nearly the same; the reading is above the inlet by a clear share of that difference; or no
current flows, so that the cell itself cools to the coolant's temperature. A reading that still falls while current
flows is never confirmed: the thermocouple may be cooling to the air slowly.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

HEATS_S: Final = 120.0  # time constant of the mean heat that a surface follows
SHARE: Final = 0.5  # share of the least steady rise above the inlet that the model file allows
REST_K: Final = 0.5  # a smaller rise counts as no rise: the cell is at rest
INLET_K: Final = 2.0  # largest difference of inlet and surface without heat
FALLS_K_S: Final = 0.05  # a cell under current that approaches its steady temperature falls more slowly than this
NEAR_K: Final = 5.0  # largest difference between neighbouring cells of a string


class Surfaces(NamedTuple):
    """Surfaces of all N cells at one tick.

    Attributes
    ----------
    good : ndarray (N,)
        °C; NaN where none is good.
    fallen : ndarray of bool (N,)
        The reading has fallen faster than a cell can cool; such a reading confirms no other.
    over : ndarray of bool (N,)
        The cell has an alarm that has not ended.
    rate : ndarray (N,)
        Rate of the reading, K/s; NaN where unknown.
    """

    good: Floats
    fallen: Bools
    over: Bools
    rate: Floats


class Confirm:
    """Confirms the surfaces of all strings.

    Parameters
    ----------
    parts : sequence of slice
        The cells of each string among the N cells.
    rise : ndarray (S,)
        Least steady rise of a surface above its coolant, divided by the square of the current, K/A².
    """

    def __init__(self, parts: Sequence[slice], rise: Floats) -> None:
        self._parts, self._rise = tuple(parts), rise
        self._square = np.full(len(parts), np.nan)
        self._now_s = -np.inf

    def step(self, now_s: float, square: Floats, inlet: Floats, surfaces: Surfaces) -> Bools:
        """Tell which of the readings (N,) are confirmed.

        Parameters
        ----------
        now_s : float
        square, inlet : ndarray (S,)
            Mean of I², A², and coolant inlet, °C; NaN where unknown.
        surfaces : Surfaces
        """
        share = 1.0 - np.exp(-min(max(now_s - self._now_s, 0.0), 10.0 * HEATS_S) / HEATS_S)
        step = np.where(np.isnan(self._square), square, self._square + share * (square - self._square))
        self._square, self._now_s = np.where(np.isnan(square), self._square, step), now_s
        confirmed = np.ones(len(surfaces.good), np.bool_)
        asked = surfaces.fallen | surfaces.over
        if not asked.any():
            return confirmed
        for s, part in enumerate(self._parts):
            for k in (np.flatnonzero(asked[part]) + part.start).tolist():
                confirmed[k] = self._confirmed(s, part, k, float(inlet[s]), surfaces)
        return confirmed

    def _confirmed(self, s: int, part: slice, k: int, inlet: float, surfaces: Surfaces) -> bool:
        good, fallen = surfaces.good, surfaces.fallen
        rise = float(self._rise[s] * self._square[s])
        if rise <= REST_K:
            return True
        if surfaces.rate[k] < -FALLS_K_S:
            return False
        others = [good[j] for j in range(part.start, part.stop) if j != k and not fallen[j] and np.isfinite(good[j])]
        if others and abs(good[k] - float(np.median(others))) <= NEAR_K:
            return True
        if inlet != inlet:
            return not others and not fallen[k]  # nothing to compare with: only a fast fall contradicts the reading
        if rise != rise:
            return bool(good[k] >= inlet + REST_K)
        return bool(good[k] >= inlet + max(SHARE * rise, REST_K) - (INLET_K if rise * SHARE < INLET_K else 0.0))
