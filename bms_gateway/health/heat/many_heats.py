"""Faults that several cells or thermocouples of a string have at once, and which cells with heat are named."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bms_gateway.health.heat.course import Course
from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_end import LEAST_RATE
from bms_gateway.health.heat.layout import Bools
from bms_gateway.health.heat.prior_odds import USUAL
from bms_gateway.thermal import Floats

SURE = 12.0
"""Least ln evidence at which heat is accepted: about 5 sd, because each step tests a few dozen faults and onsets."""
FURTHER_LN = SURE
"""ln by which one more cell or thermocouple must make a set of faults likelier: as much as it would need alone."""
LIKE_HEATS_LN, LIKE_HEATS_S = 18.0, 240.0
"""ln by which another fault must be likelier than heat in several cells to be accepted within the time, s, of its
onset. For two minutes, two cells of three that heat look like a third thermocouple that came off, or like
coolant that warms more along the string; heat is the more dangerous."""
ALSO_SD, ALSO_SHARE, ALSO_S = 5.0, 0.2, 60.0
"""A cell beside one that heats is named, too, if its own heat exceeds zero by so many sd, and this share of the
greatest heat of the string, for the time of the third number, s."""


class Together(NamedTuple):
    """Heat in several cells, or one fault of several thermocouples, since one onset.

    Attributes
    ----------
    kind : Kind
    faults : tuple of int
        Of H, the likeliest first.
    onset : int
    ln : float
        ln of its probability over no fault, with prior and doubt.
    """

    kind: Kind
    faults: tuple[int, ...]
    onset: int
    ln: float


def heats_together(e: Evidence, course: Course, s: int, told: Sequence[Finding], used: Bools) -> Together | None:
    """Find the likeliest heat in several cells of string `s`, beside that which was found; None if nothing shows it.

    Two cells count where they have thermocouples of their own, or at least different ones that are nearest. What is
    beside a cell with heat belongs to that heat, because the conduction between two cells is not known well enough to
    tell; a neighbour that heats is named afterwards (`also_heats`). One thermocouple must show a cell without heat:
    what all of them show is common.

    Parameters
    ----------
    e : Evidence
    course : Course
    s : int
        String.
    told : sequence of Finding
        Heat that was found.
    used : ndarray of bool (m,)
        Thermocouples whose readings are used.
    """
    if course.few[s] or course.alone[s]:
        return None
    at, heats = e.at, e.products.faults[Kind.HEAT]
    cells, group = at.told[s], e.group[s, heats]
    sensed = np.isin(cells, at.sensors[s, at.fitted[s]])
    apart = np.abs(cells[:, None] - cells) >= np.where(sensed[:, None] | sensed, 2, 1)
    hot = np.array([int(cells[g.place]) for g in told], np.int64)
    new = at.seen[s] & (np.abs(cells[:, None] - hot) > 1).all(axis=1)
    apart &= (group[:, None] != group) & new & new[:, None]
    sound = at.fitted[s] & used & ~np.isin(at.sensors[s], [int(group[g.place]) for g in told])
    likes, doubt = e.likes(s, Kind.HEAT), float(course.doubt[s])
    found = likes.likeliest(np.asarray(apart, np.bool_), FURTHER_LN * doubt, int(sound.sum()) - 1)
    if found is None:
        return None
    ln, onset, chosen = found
    single = likes.weigh(chosen[:, None], onset)[0]
    order = chosen[np.argsort(-single)]
    return Together(Kind.HEAT, tuple(heats[order].tolist()), onset, ln / doubt - FURTHER_LN * (len(chosen) - 1))


def given(e: Evidence, s: int, many: Together, fault: int) -> Weighed:
    """Weigh heat in each cell instead of `fault`, one of `many`, while the others of these heat."""
    heats = e.products.faults[Kind.HEAT]
    others = [j for j in many.faults if j != fault]
    shape = e.at.strings, int(e.ages(s).size), len(e.kinds)
    ln, amplitude, var = np.full(shape, -np.inf), np.zeros(shape), np.zeros(shape)
    tried = np.array([[j, *others] for j in heats.tolist() if j not in others]) - int(heats[0])
    place = s, many.onset, heats[tried[:, 0]]
    found = e.likes(s, Kind.HEAT).weigh(tried, many.onset)
    ln[place], amplitude[place], var[place] = found[0], found[1][:, 0], found[2][:, 0, 0]
    return Weighed(ln, amplitude, var)


def thermocouples_together(e: Evidence, course: Course, s: int, used: Bools) -> Together | None:
    """Find the likeliest fault that several of the `used` thermocouples (m,) of string `s` have; None if there is none.

    Two that come loose make the cell of the third look hot, as two cells that heat make the third thermocouple look
    loose. One of them must be sound.
    """
    if course.few[s] or course.alone[s]:
        return None
    here, doubt = np.asarray(e.at.fitted[s] & used, np.bool_), float(course.doubt[s])
    apart = here & here[:, None] & ~np.eye(len(here), dtype=np.bool_)
    best = None
    for kind in (Kind.JUMP, Kind.LOOSE, Kind.LAG):
        found = e.likes(s, kind).likeliest(np.asarray(apart, np.bool_), FURTHER_LN * doubt, int(here.sum()) - 1)
        if found is not None:
            ln = found[0] / doubt - FURTHER_LN * (len(found[2]) - 1) + USUAL.get(kind, 0.0)
            if best is None or ln > best.ln:
                best = Together(kind, tuple(e.products.faults[kind][found[2]].tolist()), found[1], ln)
    return best


def likelier(a: Together | None, b: Together | None) -> Together | None:
    """Return the likelier of two sets of faults."""
    return b if a is None or (b is not None and b.ln > a.ln) else a


def move_together(f: HeatFilter, e: Evidence, s: int, many: Together) -> Floats:
    """Shift the states of string `s` by faults of thermocouples; return their amplitudes (k,)."""
    faults = np.array(many.faults)
    _, amplitude, var = e.likes(s, many.kind).weigh(faults[None] - int(e.products.faults[many.kind][0]), many.onset)
    along = np.array([e.moved(s, many.onset, j) for j in many.faults])
    f.z[s] += amplitude[0] @ along
    f.P[s] += along.T @ var[0] @ along
    return np.asarray(amplitude[0], dtype=np.float64)


def shares(E: Floats, several: Sequence[Together | None]) -> Floats:
    """Return the probability of each fault (H,), by its ln `E`; that of several faults goes to the first of them."""
    there = [many for many in several if many is not None]
    top = max(0.0, float(E.max()), *(many.ln for many in there))
    share = np.exp(E - top)
    for many in there:
        share[many.faults[0]] += np.exp(many.ln - top)
    return np.asarray(share / (share.sum() + np.exp(-top)), dtype=np.float64)


def may_be_heats(e: Evidence, s: int, fault: Kind, onset: int, ln: float, many: Together | None) -> bool:
    """Return whether what looks like another `fault`, of ln probability `ln`, may still be heat in several cells."""
    if many is None or fault is Kind.HEAT or many.ln < max(SURE, ln - LIKE_HEATS_LN):
        return False
    return bool(e.ages(s)[onset] < LIKE_HEATS_S)


def also_heats(f: HeatFilter, s: int, heats: Sequence[Finding], used: Bools) -> dict[int, float]:
    """Find cells beside those of `heats` that heat, too: W by observed cell.

    The readings of the cell itself must show it. The heat that conduction brings is uncertain by R_cc.

    Parameters
    ----------
    f : HeatFilter
    s : int
        String.
    heats : sequence of Finding
    used : ndarray of bool (m,)
        Thermocouples whose readings are used.
    """
    at, z, P = f.at, f.z[s], f.P[s]
    named = {g.place for g in heats}
    most = max(g.heat for g in heats)
    sensed, T_s = set(at.sensors[s, at.fitted[s] & used].tolist()), z[1 : at.nodes : 2]
    R_cc = f.parameters(s).R_cc
    found = {}
    for j in np.flatnonzero(f.open[s]).tolist():
        cell, i = int(at.told[s, j]), at.heat.start + j
        if j in named or cell not in sensed:
            continue
        beside = [k for k in (cell - 1, cell + 1) if 0 <= k < at.cells]
        flux = sum(abs(float(T_s[k] - T_s[cell])) for k in beside) / R_cc if R_cc else 0.0
        watts, sd = float(z[i]), float(np.hypot(np.sqrt(P[i, i]), f.usual.beside_sd[s] * flux))
        if watts > max(ALSO_SD * sd, ALSO_SHARE * most, LEAST_RATE * float(f.usual.C[s, j])):
            found[j] = watts
    return found
