"""Inlets whose sensor is not read for a while: coolant that moves meanwhile is no fault of sensor, cooling or cells.

The last reading is held, and the offset of the inlet is left free to follow the coolant. Nothing tells films from the
coolant meanwhile. When the sensor is read again, all that is common to the cells is what it was before: a film that was
lost in the meantime then shows as one that is lost now.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.course import Course
from bms_gateway.health.heat.fault_evidence import Evidence
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

LOST_S, LOST_SILENT_S = 20.0, 60.0
"""An inlet is lost if it was not read for longer: by the first number where thermocouples are read, by the second where
nothing is, because a parked string may speak once a minute."""
WALK = 2.0
"""K per minute^½: coolant that nobody reads; a vehicle leaves a garage, or a chiller starts."""


@dataclass(slots=True)
class LostInlet:
    """Which of S strings have lost their inlet.

    Attributes
    ----------
    lost : ndarray of bool (S,)
    found : ndarray of bool (S,)
        The inlet is read for the first time since it was lost.
    newest : ndarray (S,), °C
        The last reading; NaN before the first.
    """

    lost: Bools
    found: Bools
    newest: Floats
    _unread_s: Floats
    _z: Floats
    _P: Floats

    @classmethod
    def of(cls, f: HeatFilter) -> "LostInlet":
        """Start with no lost inlet."""
        c, no = f.at.common, np.zeros(f.at.strings, np.bool_)
        S = f.at.strings
        return cls(no, no, np.full(S, np.nan), np.zeros(S), f.z[:, c].copy(), f.P[:, c, c].copy())

    def hear(self, f: HeatFilter, read: Bools, usable: Bools) -> None:
        """Note for which strings (S,) a step has a reading of the inlet, and for which one of a thermocouple."""
        c, until = f.at.common, self._unread_s == 0.0
        self._z[until], self._P[until] = f.z[until, c], f.P[until, c, c]
        self._unread_s = np.where(read, 0.0, self._unread_s + f.dt)
        self.found = self.lost & read
        gone = (self._unread_s > LOST_SILENT_S) | (usable & (self._unread_s > LOST_S))
        self.lost = ~read & (self.lost | gone)

    def free(self, f: HeatFilter, e: Evidence, course: Course) -> None:
        """Let the offsets of lost inlets move; where an inlet is read again, set back what is common to all cells."""
        b = f.at.inlet
        f.P[self.lost, b, b] += WALK**2 * f.dt / 60.0
        course.lose(self.lost, self.found)
        for s in np.flatnonzero(self.found).tolist():
            f.set_common(s, self._z[s], self._P[s])
            e.renew(s)
