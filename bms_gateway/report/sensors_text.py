"""Precision of the cores with sensors, and best places for sensors, as text for people and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bms_gateway.errors import counted
from bms_gateway.report.show import number, ranges, text_table
from bms_gateway.sensors.observability import Observability
from bms_gateway.sensors.placement import Placement, Placements
from bms_gateway.thermal import Condition, Disturbance, Floats

CONDITION_WORDS: dict[Condition, str] = {
    "full": "coolant and conduction",
    "natural": "conduction from cell to cell, no common coolant",
    "no-conduction": "a common coolant, no conduction from cell to cell",
    "single": "no heat exchange between cells",
}
ABOUT_RANKS = (
    "The exact rank is what noise-free readings would determine. The paper's is that of the same matrix in double\n"
    "precision, where rounding decides: its Tables 2 and 3 are made of it. The ± sd is what a user can go by."
)
SMALL = 3
"""Decimals of K that distinguish sets."""


def observability_document(o: Observability, sensors: Sequence[int], condition: Condition) -> dict[str, Any]:
    """Return the document of `observability --json`."""
    return {
        "cells": len(o.core_sd),
        "sensors": list(sensors),
        "condition": condition,
        "states": o.states,
        "exact_rank": o.exact_rank,
        "paper_rank": o.paper_rank,
        "observable": o.observable,
        "core_sd_K": _rounded(o.core_sd),
    }


def observability_text(
    o: Observability, sensors: Sequence[int], condition: Condition, disturbance: Disturbance, origin: str
) -> str:
    """Write the precision with a set of sensors, for people."""
    n = len(o.core_sd)
    paper = "not computed above 100 cells" if o.paper_rank is None else f"{o.paper_rank} of {o.states}"
    verdict = (
        "every core is observable" if o.observable else f"{o.states - o.exact_rank} of {o.states} states are hidden"
    )
    rows = [[str(k), "yes" if k in sensors else "", number(x, SMALL)] for k, x in enumerate(o.core_sd.tolist(), 1)]
    worst = o.core_sd.max()
    return "\n\n".join(
        [
            f"{counted(n, 'cell')}, {condition} ({CONDITION_WORDS[condition]}); "
            f"sensors on {ranges(list(sensors)) or 'none'}: {verdict}.",
            f"exact rank    {o.exact_rank} of {o.states}\npaper's rank  {paper}",
            text_table(["cell", "sensor", "core ± sd K"], rows, left=2),
            f"Worst is cell {o.worst_cell}, ± {number(worst, SMALL)} K in the long run, with parameters known and\n"
            f"{_unknown(disturbance)}; {origin}.",
            *_independent(disturbance, len(sensors) < n),
            ABOUT_RANKS,
        ]
    )


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """The text of a placement.

    Attributes
    ----------
    placements : Placements
    exact_sets, paper_sets : int or None
        Sets of full rank, exactly and by the paper's rank; None if they were not counted.
    wanted : float or None, K
    enough : Placement or None
        With the fewest sensors that reach it, or with all cells.
    condition : Condition
    disturbance : Disturbance
    origin : str
    """

    placements: Placements
    exact_sets: int | None
    paper_sets: int | None
    wanted: float | None
    enough: Placement | None
    condition: Condition
    disturbance: Disturbance
    origin: str


def place_document(r: PlaceReport) -> dict[str, Any]:
    """Return the document of `place --json`."""
    found = r.placements
    best = [_placement_document(x) for x in found.best]
    lost = zip(found.best[0].sensors, found.losses, strict=True)
    best[0]["if_lost"] = [{"sensor": k, **_placement_document(x)} for k, x in lost]
    document: dict[str, Any] = {
        "best": best,
        "exact_observable_sets": r.exact_sets,
        "paper_observable_sets": r.paper_sets,
        "sets": found.sets,
        "exhaustive": found.exhaustive,
        "even": _placement_document(found.even),
        "none": _placement_document(found.nothing),
    }
    if r.wanted is not None and r.enough is not None:
        reached = r.enough.worst_sd <= r.wanted
        document["wanted"] = {"core_sd_K": r.wanted, "reached": reached, **_placement_document(r.enough)}
    return document


def place_text(r: PlaceReport) -> str:
    """Write a placement for people."""
    found = r.placements
    n, m, best = found.cells, found.sensors, found.best[0]
    how = f"all {found.sets:,} sets tried" if found.exhaustive else "searched: too many sets to try all"
    head = (
        f"{counted(n, 'cell')}, {r.condition} ({CONDITION_WORDS[r.condition]}), {counted(m, 'sensor')}: "
        f"best on {_cells(best)}.\nThe least certain core is then cell {best.worst_cell}, "
        f"± {number(best.worst_sd, SMALL)} K in the long run ({how})."
    )
    named = [*((str(i), x) for i, x in enumerate(found.best, 1)), ("even", found.even), ("no sensor", found.nothing)]
    table = text_table(
        ["rank", "sensors on cells", "worst cell", "its core ± sd K", "mean ± sd K"],
        [[name, _cells(x), *_figures(x)] for name, x in named],
        left=2,
    )
    lost = text_table(
        ["if this one fails", "worst cell", "its core ± sd K", "mean ± sd K"],
        [[f"cell {k}", *_figures(x)] for k, x in zip(best.sensors, found.losses, strict=True)],
    )
    parts = [head, table, lost, *_wanted(r)]
    if r.exact_sets is not None:
        paper = "" if r.paper_sets is None else f"; by the paper's rank, which rounding decides, {r.paper_sets:,}"
        parts.append(f"Noise-free readings determine every state with {r.exact_sets:,} of {found.sets:,} sets{paper}.")
    parts.append(f"Parameters known; {_unknown(r.disturbance)};\n{r.origin}.")
    return "\n\n".join([*parts, *_independent(r.disturbance, m < n)])


def _wanted(r: PlaceReport) -> list[str]:
    if r.wanted is None or r.enough is None:
        return []
    if r.enough.worst_sd > r.wanted:
        return [
            f"± {r.wanted:g} K cannot be reached: a sensor on every cell leaves ± {number(r.enough.worst_sd, SMALL)} K,"
            " because errors of the heat act in the cores."
        ]
    m = len(r.enough.sensors)
    return [
        f"± {r.wanted:g} K takes {counted(m, 'sensor')}: {_cells(r.enough)} "
        f"leave ± {number(r.enough.worst_sd, SMALL)} K."
    ]


def _placement_document(x: Placement) -> dict[str, Any]:
    worst = _rounded(x.core_sd)
    return {
        "sensors": list(x.sensors),
        "core_sd_K": worst,
        "worst_cell": x.worst_cell,
        "worst_core_sd_K": worst[x.worst_cell - 1],
    }


def _figures(x: Placement) -> list[object]:
    return [x.worst_cell, number(x.worst_sd, SMALL), number(float(x.core_sd.mean()), SMALL)]


def _cells(x: Placement) -> str:
    return ranges(list(x.sensors)) or "–"


def _rounded(sd: Floats) -> list[float]:
    return [round(x, 4) for x in sd.tolist()]


def _unknown(d: Disturbance) -> str:
    return (
        f"heat unknown by ± {d.heat_common:g} W in common and ± {d.heat_cell:g} W per cell, the inlet by "
        f"± {d.inlet:g} K,\nlasting {d.correlation:g} s; readings every second with ± {d.sensor:g} K of noise"
    )


def _independent(d: Disturbance, unsensed: bool) -> list[str]:
    if d.heat_common or d.inlet or not unsensed:
        return []
    return [
        "The error of a single cell shows at other cells only through conduction:\n"
        "a cell whose core must be known needs its own sensor."
    ]
