"""Rules for strings with one or two thermocouples, where no other cell shows the effect of current and coolant."""

import numpy as np

from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

LIKE_HEAT, MOST_STOPPED, RARER = 1.5, 0.85, 4.0
"""Heat and a loss of cooling look alike. A fan or pump stops more often than a cell has a short. Therefore the ln
evidence of heat is lowered by the third number, unless it is greater than that of a loss by the first factor. The
second number is the greatest share of the films' conductance that is lost with a fan."""
COOLED = 0.8
"""Share of the greatest gap between surface and coolant since heat was found, below which a cell at rest has cooled."""


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


def cooled(f: HeatFilter, s: int, g: Finding, gaps: Floats, others: Bools) -> bool:
    """Return whether the cell of heat `g` has cooled since it was found; the greatest gap is kept in `g`.

    A cell that still heats does not cool beside the others; the estimate of its heat alone may be wrong by a multiple.
    Where no other thermocouple shows a cell without heat, current and coolant move the gap as the end of heat does:
    a string with few thermocouples is judged by it at rest, and any other string counts as cooled.

    Parameters
    ----------
    f : HeatFilter
    s : int
        String.
    g : Finding
    gaps : ndarray (m,), K
        Surfaces over the coolant, at the thermocouples.
    others : ndarray of bool (m,)
        Thermocouples that show cells without heat.
    """
    gap, beside = float(gaps[int(f.at.apart(s, g.place).argmin())]), bool(others.any())
    if not beside and not f.usual.alone[s]:
        return True
    if beside:
        gap -= float(np.median(gaps[others]))
    if beside != g.beside:  # another quantity: its greatest value is not known yet
        g.beside, g.warmest = beside, gap
    g.warmest = max(g.warmest, gap)
    return gap < COOLED * g.warmest
