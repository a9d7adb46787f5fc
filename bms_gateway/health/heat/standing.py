"""Faults that the states of the heat filter show by themselves: missing heat, lost cooling, a frozen inlet."""

from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from math import sqrt

import numpy as np

from bms_gateway.health.heat.course import (
    COLD,
    COOLING,
    COOLING_GRAVE,
    FLOW_GRAVE,
    FLOW_SURE,
    FROZEN_K,
    FROZEN_S,
    MISSING,
    MUCH,
    SLOW_S,
    Course,
    missing,
)
from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding, held, lasted
from bms_gateway.thermal import Floats

HOLD_S, HOLD_COMMON_S = 20.0, 60.0
"""Time for which a cause must have been the likeliest before it is reported; the second is for films and inlet."""
FLOWED_S = 1800.0  # s in which a sudden change of the films may be reported; ageing judges slow changes
INLET_OFF, INLET_SURE = 3.0, 4.0  # K and sd of an offset above which the inlet's sensor is wrong, frozen or not
MORE = 0.5  # if the heat exceeds that of the current by this share, no missing heat is reported
COOLED_LN = 5.0
"""ln by which a change of the current's heat must be likelier than one of films or flow, for missing heat to be
reported: cells that are cooled more look like cells that make less heat."""
SUSPECT = 5.0
"""Least ln evidence at which the likeliest change of the heat is included in its ratio before it is accepted."""


@dataclass(slots=True)
class Standing:
    """States of string `s` of a filter.

    Attributes
    ----------
    flowed_ns : int or None
        When a sudden change of the films was accepted.
    known : bool
        The inlet is read: what else happens to all cells is no work of the coolant.
    """

    s: int
    of: HeatFilter
    evidence: Evidence
    course: Course
    flowed_ns: int | None = None
    known: bool = True
    _slow_ns: int | None = None
    _less_ns: int | None = None

    def pass_over(self) -> None:
        """Pass a step that is not judged."""
        self._slow_ns = self._less_ns = None

    def look(self, w: Weighed, each: Floats, codes: AbstractSet[str], now_ns: int) -> list[Finding]:
        """Return new findings of the states themselves, whether they changed suddenly or slowly.

        Parameters
        ----------
        w : Weighed
        each : ndarray (H,)
            ln evidence of each fault of the string.
        codes : set of str
            Codes of its findings.
        now_ns : int
        """
        s, f, at = self.s, self.of, self.of.at
        hot = "unexplained_heat" in codes
        share, var = (float(x[s]) for x in f.made())
        best = int(each.argmax())
        if self.evidence.kinds[best] == Kind.LOAD and each[best] > SUSPECT:
            onset = int(w.ln[s, :, best].argmax())
            along = self.evidence.moved(s, onset, best)
            share += float(w.amplitude[s, onset, best]) * float(along[at.load] + along[at.brisk])
            var += float(w.var[s, onset, best])
        new = []
        kinds = self.evidence.kinds
        lead = float(each[best] - each[np.isin(kinds, (Kind.FLOW, Kind.STREAM))].max())
        sound = each[best] < SUSPECT or (kinds[best] == Kind.LOAD and lead > COOLED_LN)
        warms = bool(self.course.warms[s]) and sound and "cooling" not in codes
        # a model with this result would need a current that cools
        warms = warms and float(f.made()[0][s]) > COLD
        warms = warms and float(f.z[s, at.load]) < MORE  # states that show missing heat and more heat show neither
        if "missing_heat" not in codes and warms and missing(share, sqrt(var), bool(self.course.denied[s])):
            new.append(Finding("missing_heat", None, 2, now_ns, kind=Kind.LOAD, size=max(0.0, share)))
        u, u_sd = float(f.z[s, at.flow]), sqrt(float(f.P[s, at.flow, at.flow]))
        grown = float(self.course.grown(f)[s])
        own = float(each[self.evidence.kinds < Kind.FLOW].max()) > SUSPECT or hot
        if "cooling" not in codes and self.known:
            flowed = self.flowed_ns is not None and lasted(self.flowed_ns, now_ns, f.dt) < FLOWED_S
            least, sure, hold = (COOLING, FLOW_SURE, HOLD_S) if flowed else (COOLING_GRAVE, FLOW_GRAVE, HOLD_COMMON_S)
            lost = u - self.course.film[s]
            # a film shows by lasting heat: if the current seems to make none, the film is not the explanation
            own = own or share < MISSING
            own = own or (not flowed and bool(self.course.poor[s]))
            slower = grown > least and lost > sure * u_sd and not own
            self._slow_ns = (now_ns if self._slow_ns is None else self._slow_ns) if slower else None
            less = grown > COOLING and lost > FLOW_SURE * u_sd and not own and bool(self.course.shows_films(f)[s])
            slow_s = HOLD_COMMON_S if grown > MUCH else SLOW_S
            self._less_ns = (now_ns if self._less_ns is None else self._less_ns) if less else None
            if held(self._slow_ns, now_ns, f.dt, hold) or held(self._less_ns, now_ns, f.dt, slow_s):
                level = 2 if grown >= COOLING_GRAVE else 1
                new.append(Finding("cooling", None, level, now_ns, kind=Kind.FLOW))
                self.course.cooling[s] = True
        off, off_sd = float(f.z[s, at.inlet]), sqrt(float(f.P[s, at.inlet, at.inlet]))
        still = self.course.frozen[s] * f.dt >= FROZEN_S and not self.course.constant_inlet[s]
        moved = abs(off - self.course.frozen_at[s]) > max(FROZEN_K, INLET_SURE * off_sd)
        stuck = bool(self.course.stuck[s])
        if "inlet" not in codes and (stuck or (still and moved)) and not hot:
            new.append(Finding("inlet", None, 1, now_ns, kind=Kind.INLET, size=off))
        return new
