"""Which heat no error of a thermocouple explains, which may be such an error, and which thermocouples can show heat."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.health.heat.fault_evidence import OLDEST_READ, SLOPE_S, Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import OWN_FIRST, HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

LITTLE_JUMP, LITTLE_S = 1.0, 180.0
"""K, s: a thermocouple that comes off while its cell warms seems to jump downwards repeatedly, and then to show heat. A
smaller downward jump than the first number is accepted only after the second."""
LEAST_DRIFT = 0.5
"""K: a smaller drift cannot be distinguished from thermocouples of class 1 that never drifted."""
UNTOLD = 3.0
"""ln: after a sleep, a cell that has warmed looks like a thermocouple that has jumped. Heat is the more dangerous of
the two; it is reported unless it is less likely by more than this. The same holds for a drift with few readings."""
DRIFT_LN, DRIFT_S = 3.5, 1800.0
"""ln by which heat and a drift of its thermocouple must differ for a report; s, after which the likelier is
reported."""
LAG_LN, LAG_TOLD_S = 6.0, 240.0
"""The same for a thermocouple that came off and heat: heat looks like a lag in its first minutes."""
PROVEN_K = 4.0
"""K: a cell with heat whose surface is so far above the median of its string does heat, for any fault of the
sensors."""


def proven(f: HeatFilter, s: int, heats: Sequence[Finding]) -> bool:
    """Return whether heat that was found in string `s` is proven by a surface far above the others."""
    at, T_s = f.at, f.z[s, 1 : f.at.nodes : 2]
    sensed = at.sensors[s, at.fitted[s]]
    hot = np.intersect1d([at.told[s, j] for g in heats for j in g.places], sensed)
    return bool((T_s[hot] > np.median(T_s[sensed]) + PROVEN_K).any())


def may_be_else(e: Evidence, s: int, w: Weighed, onset: int, fault: int, *, poor: bool) -> bool:
    """Return whether a fault of a thermocouple in string `s` may be something else.

    A jump may be the lag of a thermocouple that has just come off. A drift or a lag may be a defect of a `poor` model,
    a small drift the difference of thermocouples, and a small share of the coolant the difference of a `poor` model's
    cells.
    """
    kind, amplitude, age = e.kinds[fault], float(w.amplitude[s, onset, fault]), float(e.ages(s)[onset])
    if kind == Kind.SLOPE:
        return poor or age < SLOPE_S or abs(amplitude) * age / 3600.0 < LEAST_DRIFT
    if kind == Kind.LOOSE:
        return poor and amplitude < OWN_FIRST
    if kind == Kind.JUMP:
        return -LITTLE_JUMP < amplitude < 0.0 and age < LITTLE_S
    return poor and kind == Kind.LAG


def may_be_heat(
    e: Evidence, s: int, w: Weighed, onset: int, fault: int, heat: tuple[bool, float], *, slept: bool
) -> bool:
    """Return whether a thermocouple that reads too much since an onset may read the heat of its cell.

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
    """Return whether one of the used thermocouples (m,) observes the observed cell number `place`."""
    return bool((f.at.apart(s, place, used) <= 1).any())


def known(e: Evidence, s: int, w: Weighed, place: int, told: Sequence[Finding]) -> int | None:
    """Fault (of H) of a thermocouple that observes cell number `place` and is certainly wrong; None if there is none.

    Parameters
    ----------
    e : Evidence
    s : int
        String.
    w : Weighed
    place : int
        Among the observed cells.
    told : sequence of Finding
        Thermocouples that were reported as wrong and are still used.
    """
    ln = w.ln[s].max(axis=0)
    for g in told:
        if abs(int(e.at.sensors[s, g.place]) - int(e.at.told[s, place])) <= 1:
            same = np.isin(e.kinds, (Kind.LOOSE, Kind.LAG)) & (e.place == g.place) & np.isfinite(ln)
            if same.any():
                return int(np.where(same, ln, -np.inf).argmax())
    return None


def early(e: Evidence, s: int, E: Floats, fault: int, onset: int) -> bool:
    """Return whether a thermocouple of string `s` seems to have come off so recently that its cell may heat instead.

    `E` (H,) is the ln probability of each fault.
    """
    if e.kinds[fault] != Kind.LAG or e.ages(s)[onset] >= LAG_TOLD_S:
        return False
    heat = (e.kinds == Kind.HEAT) & (e.group[s] == e.group[s, fault])
    return bool(E[heat].max() > E[fault] - LAG_LN)


def undecided(e: Evidence, s: int, E: Floats, fault: int, onset: int) -> bool:
    """Return whether more readings can separate heat from a thermocouple's drift: for some minutes they look alike.

    Few readings cannot: heat is the more dangerous of the two (`may_be_heat`). `E` (H,) is the ln probability of each
    fault.
    """
    rival = {Kind.HEAT: Kind.SLOPE, Kind.SLOPE: Kind.HEAT}.get(Kind(int(e.kinds[fault])))
    if rival is None or e.ages(s)[onset] > DRIFT_S or e.reads(s, onset) < OLDEST_READ:
        return False
    same = (e.kinds == rival) & (e.group[s] == e.group[s, fault])
    return bool(E[same].max() > E[fault] - DRIFT_LN)
