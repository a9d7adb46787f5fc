"""When heat of a cell's own has ended.

A thermocouple hardly tells its own cell from the neighbours. The sum of the heat of all cells in which it may be is
therefore uncertain by many times what the thermocouple shows. What is compared with the heat that was found is the heat
that would be in its cell if all of it were there.
"""

from collections.abc import Sequence

import numpy as np

from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

LEAST_RATE = 1e-3
"""K/s of a cell's heat capacity: less heat than this is no fault."""
ENDED_SD, ENDED_S, ENDED_SHARE = 2.0, 300.0, 0.5
"""Heat has ended if its estimate is below so many sd for the time of the second number, s, and if estimate and one sd
together are below the last number as a share of the heat that was found. In strings with few thermocouples, as many sd
as the first number take the place of the one."""
COOLED = 0.8
"""Share of the greatest gap between surface and coolant since heat was found, below which a cell has cooled."""


def heat_there(f: HeatFilter, s: int, place: int, places: Sequence[int]) -> tuple[float, float]:
    """Heat that is left and its sd, W, if all of it is in one observed cell.

    The mean of the heat in `place` given that the other `places` have none: with the information matrix Λ of the heat
    p in all places, (Λ p)_j / Λ_jj, of variance 1 / Λ_jj.

    Parameters
    ----------
    f : HeatFilter
    s : int
        String.
    place : int
        Number of the observed cell; it is one of `places`.
    places : sequence of int
        Observed cells in which the heat may be.
    """
    h = f.at.heat.start + np.array(places)
    information = np.linalg.inv(f.P[s][np.ix_(h, h)])
    j = list(places).index(place)
    return float(information[j] @ f.z[s, h] / information[j, j]), float(information[j, j] ** -0.5)


def has_ended(f: HeatFilter, s: int, g: Finding, gaps: Floats, heats: Sequence[Finding], used: Bools) -> bool:
    """Whether the newest step of string `s` shows no heat `g` any more.

    Parameters
    ----------
    f : HeatFilter
    s : int
        String.
    g : Finding
        Heat that was found; the greatest gap between surface and coolant is kept in it.
    gaps : ndarray (m,), K
        Surfaces over the coolant, at the thermocouples.
    heats : sequence of Finding
        All heat that was found in the string.
    used : ndarray of bool (m,)
        Thermocouples whose readings are used.
    """
    now, sd = heat_there(f, s, g.place, g.places)
    alone = bool(f.usual.alone[s])
    low = now < ENDED_SD * sd and now + (ENDED_SD if alone else 1.0) * sd < ENDED_SHARE * g.size
    cold = now < LEAST_RATE * float(f.usual.C[s, g.place])
    hot = [int(f.at.apart(s, h.place).argmin()) for h in heats]
    others = np.asarray(f.at.fitted[s] & used & ~np.isin(np.arange(f.at.sensed), hot), np.bool_)
    cools = cooled(f, s, g, gaps, others)
    if not alone:
        return low and cools
    if f.calm[s]:
        return cools and (low or (cold and now + sd < g.size))
    return low


def cooled(f: HeatFilter, s: int, g: Finding, gaps: Floats, others: Bools) -> bool:
    """Return whether the cell of heat `g` has cooled since it was found; the greatest gap is kept in `g`.

    A cell that still heats does not cool beside the others; the estimate of its heat alone may be wrong by a multiple.
    Where no other thermocouple shows a cell without heat, current and coolant move the gap as the end of heat does:
    a string with few thermocouples is judged by it at rest, and any other string counts as cooled.

    Parameters are those of `has_ended`; `others` (m,): thermocouples that show cells without heat.
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
