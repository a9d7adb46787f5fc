"""Rules for strings with one or two thermocouples, where no other cell shows the effect of current and coolant."""

import numpy as np

from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.thermal import Floats

LIKE_HEAT, MOST_STOPPED, RARER = 1.5, 0.85, 4.0
"""Heat and a loss of cooling look alike. A fan or pump stops more often than a cell has a short. Therefore the ln
evidence of heat is lowered by the third number, unless it is greater than that of a loss by the first factor. The
second number is the greatest share of the films' conductance that is lost with a fan."""


def hold_films(E: Floats, w: Weighed, e: Evidence, s: int) -> None:
    """Compare the evidence (H,) of heat and of lost films in string `s`."""
    f = e.of
    heat, flow = e.kinds == Kind.HEAT, int(np.flatnonzero(e.kinds == Kind.FLOW)[0])
    since = int(w.ln[s, :, flow].argmax())
    lost = float(w.amplitude[s, since, flow])
    rest = lost * float(e.moved(s, since, flow)[f.at.flow])  # not yet in the numbers
    if f.calm[s] and rest + float(f.z[s, f.at.flow]) > MOST_STOPPED:
        E[flow] = -np.inf
    elif 0.0 < lost < MOST_STOPPED and E[heat].max() < LIKE_HEAT * E[flow]:
        E[heat] = np.minimum(E[heat], E[flow] - RARER)
