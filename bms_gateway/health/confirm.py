"""What else speaks for a surface that is below its limit again, and against a sensor that came off.

A thermocouple that comes off reads the air or the coolant. While current flows the surface of a cell stands above its
coolant by the heat times the resistance between them. So a reading is confirmed by good neighbours that read the same,
by a clear share of that difference above the inlet, or by rest that has lasted: then a cell does cool to its coolant.
Rest confirms a surface that fell faster than a cell cools only after the time in which the cell cools: before, the cell
may be hot. A surface that falls under current may be on its way to the air, however slowly: nothing is confirmed then.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

HEATS_S: Final = 120.0  # mean of the heat that a surface follows
SHARE: Final = 0.5  # of the least steady rise above the inlet that the model file allows
REST_K: Final = 0.5  # such a rise is none
INLET_K: Final = 2.0  # what inlet and surface may differ by without heat
FALLS_K_S: Final = 0.05  # a cell under current settles more slowly near its end
NEAR_K: Final = 5.0  # cells of a string beside each other
COOLED: Final = 3.0  # time constants of a cell: 5 % of its rise are left


class Surfaces(NamedTuple):
    """Surfaces of all N cells at one tick.

    Attributes
    ----------
    good : ndarray (N,)
        °C; NaN where none is good.
    fallen : ndarray of bool (N,)
        Those that have fallen faster than a cell cools: they confirm no others.
    over : ndarray of bool (N,)
        Those whose alarms wait for an end.
    rate : ndarray (N,)
        How fast they rise, K/s; NaN where unknown.
    """

    good: Floats
    fallen: Bools
    over: Bools
    rate: Floats


class Confirm:
    """Judge of the surfaces of all strings.

    Parameters
    ----------
    parts : sequence of slice
        Which of the N cells are each string's.
    rise : ndarray (S,)
        Least steady rise of a surface above its coolant per square of the current, K/A².
    cools_s : ndarray (S,)
        Time constant with which a cell at rest cools, at most, s.
    """

    def __init__(self, parts: Sequence[slice], rise: Floats, cools_s: Floats) -> None:
        self._parts, self._rise, self._cools_s = tuple(parts), rise, cools_s
        self._square = np.full(len(parts), np.nan)
        self._rest_s = np.zeros(parts[-1].stop if parts else 0)  # for how long at rest since it fell
        self._now_s = -np.inf

    def step(self, now_s: float, square: Floats, inlet: Floats, surfaces: Surfaces) -> Bools:
        """Tell which readings (N,) something else confirms.

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
            return not others and not fallen[k]  # nobody to ask: only the fall speaks against it
        if rise != rise:
            return bool(good[k] >= inlet + REST_K)
        return bool(good[k] >= inlet + max(SHARE * rise, REST_K) - (INLET_K if rise * SHARE < INLET_K else 0.0))
