"""Which heat no error of a thermocouple explains, which may be one, and whether a thermocouple still tells of heat."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.health.heat.fault_evidence import OLDEST_READ, Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools

LITTLE_JUMP, LITTLE_S = 1.0, 180.0
"""K, s: a thermocouple that comes off while its cell warms seems to jump downwards, again and again, and then to show
heat. A downward jump of less than the first number is believed after the second."""
UNTOLD = 3.0
"""ln: after a sleep, a cell that has warmed looks like a thermocouple that has jumped. Heat is the more dangerous of
the two; it is reported unless it is less likely by more than this. The same holds for a drift with few readings."""
PROVEN_K = 4.0
"""A cell with heat whose surface is so far above the median of its string's surfaces heats, whatever sensors do."""


def proven(f: HeatFilter, s: int, heats: Sequence[Finding]) -> bool:
    """Tell whether heat that was found in string `s` is proven by a surface far above the others."""
    at, T_s = f.at, f.z[s, 1 : f.at.nodes : 2]
    sensed = at.sensors[s, at.fitted[s]]
    hot = np.intersect1d([at.told[s, j] for g in heats for j in g.places], sensed)
    return bool((T_s[hot] > np.median(T_s[sensed]) + PROVEN_K).any())


def may_be_else(e: Evidence, s: int, w: Weighed, onset: int, fault: int, *, poor: bool) -> bool:
    """Tell whether a fault of a thermocouple in string `s` may be something else.

    A jump may be the lag of one that came off a moment ago. A drift or a lag may be what a `poor` model lacks.
    """
    if e.kinds[fault] != Kind.JUMP:
        return poor and e.kinds[fault] in (Kind.SLOPE, Kind.LAG)
    little = -LITTLE_JUMP < float(w.amplitude[s, onset, fault]) < 0.0
    return bool(little and e.ages(s)[onset] < LITTLE_S)


def may_be_heat(
    e: Evidence, s: int, w: Weighed, onset: int, fault: int, heat: tuple[bool, float], *, slept: bool
) -> bool:
    """Tell whether a thermocouple that reads too much since an onset may read the heat of its cell.

    Parameters
    ----------
    e : Evidence
    s : int
        String.
    w : Weighed
    onset, fault : int
    heat : tuple of bool, float
        Whether heat alone would be accepted, and the ln of its probability over that of the fault.
    slept : bool
        The onset may lie in a sleep.
    """
    kind = e.kinds[fault]
    if kind not in (Kind.JUMP, Kind.SLOPE) or w.amplitude[s, onset, fault] <= 0.0:
        return False
    if kind == Kind.JUMP:
        return slept and heat[1] > -UNTOLD
    return e.reads(s, onset) < OLDEST_READ and heat[0]


def watched(f: HeatFilter, s: int, place: int, used: Bools) -> bool:
    """Tell whether one of the thermocouples (m,) that are used tells of cell number `place` of those told of."""
    at = f.at
    near = np.abs(at.sensors[s] - at.told[s, place]) <= 1
    return bool((near & at.fitted[s] & used).any())


def known(e: Evidence, s: int, w: Weighed, place: int, told: Sequence[Finding]) -> int | None:
    """Give the fault (of H) of a thermocouple that is wrong for all one knows and tells of heat in cell number `place`.

    Parameters
    ----------
    e : Evidence
    s : int
        String.
    w : Weighed
    place : int
        Of the cells that thermocouples tell of.
    told : sequence of Finding
        Thermocouples that were told to be wrong and are still used.
    """
    ln = w.ln[s].max(axis=0)
    for g in told:
        if abs(int(e.at.sensors[s, g.place]) - int(e.at.told[s, place])) <= 1:
            same = np.isin(e.kinds, (Kind.LOOSE, Kind.LAG)) & (e.place == g.place) & np.isfinite(ln)
            if same.any():
                return int(np.where(same, ln, -np.inf).argmax())
    return None
