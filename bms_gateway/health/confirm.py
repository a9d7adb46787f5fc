"""Confirms that a surface below its limit is a cell that has cooled, and not a thermocouple that has come off.

A thermocouple that has come off reads the temperature of the air or of the coolant. While current flows, the surface of
a cell is above its coolant by the heat times R_u. A reading is therefore confirmed in three cases: good thermocouples
of the same string read nearly the same; the reading is above the inlet by a clear share of that difference; or no
current flows, so that the cell itself cools to the coolant's temperature. If the surface fell faster than a cell cools,
rest confirms it only after the time in which the cell cools: before, the cell may be hot. A reading that still falls
while current flows is never confirmed: the thermocouple may be cooling to the air slowly.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

Bools = NDArray[np.bool_]

HEATS_S: Final = 120.0  # time constant of the mean heat that a surface follows
SHARE: Final = 0.5  # share of the least steady rise above the inlet that the model file allows
REST_K: Final = 0.5  # a smaller rise counts as no rise: the cell is at rest
INLET_K: Final = 2.0  # largest difference of inlet and surface without heat
FALLS_K_S: Final = 0.05  # a cell under current that approaches its steady temperature falls more slowly than this
NEAR_K: Final = 5.0  # largest difference between neighbouring cells of a string
COOLED: Final = 3.0  # time constants of a cell, after which 5 % of its rise are left


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
    cools_s : ndarray (S,)
        Greatest time constant with which a cell at rest cools, s.
    """

    def __init__(self, parts: Sequence[slice], rise: Floats, cools_s: Floats) -> None:
        self._parts, self._rise, self._cools_s = tuple(parts), rise, cools_s
        self._square = np.full(len(parts), np.nan)
        self._rest_s = np.zeros(parts[-1].stop if parts else 0)  # for how long at rest since it fell
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
        passed_s = max(now_s - self._now_s, 0.0)
        share = 1.0 - np.exp(-min(passed_s, 10.0 * HEATS_S) / HEATS_S)
        step = np.where(np.isnan(self._square), square, self._square + share * (square - self._square))
        self._square, self._now_s = np.where(np.isnan(square), self._square, step), now_s
        confirmed = np.ones(len(surfaces.good), np.bool_)
        asked = surfaces.fallen | surfaces.over
        self._rest_s = np.where(surfaces.fallen, self._rest_s + (passed_s if np.isfinite(passed_s) else 0.0), 0.0)
        if not asked.any():
            return confirmed
        for s, part in enumerate(self._parts):
            for k in (np.flatnonzero(asked[part]) + part.start).tolist():
                confirmed[k] = self._confirmed(s, part, k, float(inlet[s]), surfaces)
        return confirmed

    def _confirmed(self, s: int, part: slice, k: int, inlet: float, surfaces: Surfaces) -> bool:
        good, fallen = surfaces.good, surfaces.fallen
        rise = float(self._rise[s] * self._square[s])
        rests = rise <= REST_K
        if not rests:
            self._rest_s[k] = 0.0
        if rests and not (fallen[k] and self._rest_s[k] < COOLED * self._cools_s[s]):
            return True
        if not rests and surfaces.rate[k] < -FALLS_K_S:
            return False
        others = [good[j] for j in range(part.start, part.stop) if j != k and not fallen[j] and np.isfinite(good[j])]
        if others and abs(good[k] - float(np.median(others))) <= NEAR_K:
            return True
        if rests:
            return False
        if inlet != inlet:
            return not others and not fallen[k]  # nothing to compare with: only a fast fall contradicts the reading
        if rise != rise:
            return bool(good[k] >= inlet + REST_K)
        return bool(good[k] >= inlet + max(SHARE * rise, REST_K) - (INLET_K if rise * SHARE < INLET_K else 0.0))
