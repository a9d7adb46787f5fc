"""Parallel strings with a current signal each: assigns current, voltage and SOC to the thermocouples of each string."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.setup.find_charge import charges
from bms_gateway.setup.find_electrical import Electrical, Scored, together
from bms_gateway.setup.groups import Member, alike
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import has, words

STRING: Final = ("string", "str", "strang", "stg", "rack", "pack", "batt", "battery", "bat", "akku")
LEAST: Final = 1.5
"""Least score of each string's current."""
ADDS_UP: Final = 0.05


@dataclass(frozen=True, slots=True)
class Own:
    """The signals of one string.

    Attributes
    ----------
    electrical : Electrical
    charge : list of Scored
        Candidates for its SOC, the likeliest first; empty if one SOC is for the whole pack.
    cells : list of Member
        Voltages of its cells; if they cannot be assigned to strings, those of the whole pack.
    """

    electrical: Electrical
    charge: list[Scored]
    cells: list[Member]


@dataclass(frozen=True, slots=True)
class Strings:
    """The strings of a pack.

    Attributes
    ----------
    members : list of Member
        The thermocouples; `part` is the string.
    own : dict of int to Own
    remark : str or None
        Reason to doubt the assignment.
    """

    members: list[Member]
    own: dict[int, Own]
    remark: str | None


def own_strings(
    surfaces: list[Member],
    series: list[Series],
    candidates: list[Scored],
    voltages: list[Scored],
    cells: list[Member],
    edges: NDArray[np.float64],
) -> Strings | None:
    """Find currents whose names have the same numbers or letters as those of the thermocouples; None if there are none.

    Parameters
    ----------
    surfaces : list of Member
    series : list of Series
    candidates, voltages : list of Scored
        Candidates for a current and for a voltage of a pack.
    cells : list of Member
        The cells' voltages.
    edges : ndarray, s
    """
    for numbers in _ways(surfaces):
        keys = set(numbers)
        found = []
        for group in _split(candidates, keys):
            if min(c.score for c in group.values()) < LEAST:
                continue
            volts = _split(voltages, keys)
            pairs = {
                key: together([c], [v[key] for v in volts] or [v for v in voltages if v.series is not c.series], edges)
                for key, c in group.items()
            }
            found.append((sum(e.score for e in pairs.values()) / len(pairs), pairs))
        if not found:
            continue
        found.sort(key=lambda f: -f[0])
        best, pairs = found[0]
        lead = best - found[1][0] if len(found) > 1 else 9.0
        own = {}
        for key, e in pairs.items():
            charge = [g[key] for g in _split(charges(series, e, edges), keys)]
            mine = _cells_of(cells, keys, key)
            own[key] = Own(replace(e, lead=lead), sorted(charge, key=lambda c: -c.score), mine)
        members = [replace(m, part=key) for m, key in zip(surfaces, numbers, strict=True)]
        return Strings(members, own, _total(pairs, candidates, edges))
    return None


def _ways(surfaces: list[Member]) -> list[list[int]]:
    """Ways to assign a string to each thermocouple: each uses one of the numbers in the names."""
    ways = [[m.where[k] for m in surfaces] for k in range(len(surfaces[0].where))] if surfaces else []
    if not ways and surfaces and len(surfaces[0].whole) == 1:  # one thermocouple each
        ways = [[m.whole[0] for m in surfaces]]
    info = surfaces[0].series.info if surfaces else None
    called = info is not None and has((*words(info.message), *words(info.name)), STRING)
    return [w for w in ways if len(set(w)) > 1 and (called or len(w) >= 2 * len(set(w)))]


def _split(ranked: list[Scored], keys: set[int]) -> list[dict[int, Scored]]:
    """Find the groups of similar names with one signal for each key."""
    by_path = {c.series.path: c for c in reversed(ranked)}  # of several interpretations of one signal the best
    wanted = {(key,) for key in keys}
    return [
        {m.whole[0]: by_path[m.series.path] for m in group}
        for group in alike([c.series for c in by_path.values()])
        if len(group) == len(keys) and {m.whole for m in group} == wanted
    ]


def _cells_of(cells: list[Member], keys: set[int], key: int) -> list[Member]:
    for k in range(len(cells[0].where) if cells else 0):
        if {m.where[k] for m in cells} == keys:
            return [m for m in cells if m.where[k] == key]
    return []


def _total(pairs: dict[int, Electrical], candidates: list[Scored], edges: NDArray[np.float64]) -> str | None:
    """Report another current that contradicts the strings' currents: their sum should be the pack's current."""
    own = [e.current for e in pairs.values() if e.current is not None]
    alone = {m[0].series.path for m in alike([c.series for c in candidates]) if len(m) == 1}
    others = [c for c in candidates if c.series.path in alone and c.score > LEAST and not c.series.constant]
    together_A = np.sum([c.factor * c.series.on_grid(edges) for c in own], axis=0)
    for other in others:
        I = other.factor * other.series.on_grid(edges)  # noqa: E741 — the field's
        both = np.isfinite(I) & np.isfinite(together_A)
        power = float(together_A[both] @ together_A[both])
        if both.sum() < 10 or power == 0.0:
            continue
        share = float(I[both] @ together_A[both]) / power
        if abs(abs(share) - 1.0) > ADDS_UP:
            return (
                f"{other.series.path} is a current beside those of {len(own)} strings and {share:.2g} times their "
                "sum: it is not told which are meant"
            )
    return None
