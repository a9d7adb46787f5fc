"""The past of a pack: the hottest point of a string over time, and a stretch of all estimates as a table."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine import Judged
from bms_gateway.thermal.centre import hottest_of
from bms_gateway.workbench.kept_ticks import Tick

PAST: Final = ("hottest", "half", "cell", "current", "inlet", "flow", "soc", "voltage", "unknown", "hidden")
"""Stored numbers of each string at each tick: °C, K, from 1, A, °C, over nominal, 0…1, V, cells, cells.

The hottest point is that of the cells that are known. `unknown` counts the others, and `hidden` those of them that have
an alarm of heat: they may be hotter than all that is known. Where nothing is known, there is no hottest point, and the
others are not counted.
"""
DRIVEN: Final = slice(3, 8)
"""Of these: what drove the string."""
OF_HEAT: Final = ("core", "surface", "runaway", "lost_in_heat")
"""Alarms of a hot cell."""
POINTS: Final = 600
"""Number of points of a history: the width of its figure."""
SET_NS: Final = 10**18
"""Stamps from here on (2001) are wall clock; smaller ones count from another start."""


def past_of(
    cells: NDArray[Any], parts: Sequence[slice], names: Sequence[str], raised: Sequence[Mapping[str, Any]]
) -> NDArray[np.float32]:
    """Start the `PAST` (S, 10) of a tick with the hottest point of each string; the inputs are not known yet.

    Parameters
    ----------
    cells : ndarray (7, N)
        As in `Tick`.
    parts, names : sequence of slice, of str
        Of the strings.
    raised : sequence of mapping
        The alerts at that tick.
    """
    found = np.full((len(parts), len(PAST)), np.nan, np.float32)
    core, centre, centre_sd = cells[0], cells[3], cells[4]
    for s, part in enumerate(parts):
        k = hottest_of(centre[part])
        if k is not None:
            found[s, :3] = centre[part][k], 1.96 * centre_sd[part][k], k + 1
        hidden = len(hidden_of(core[part], names[s], raised))
        found[s, 8:] = np.isnan(core[part]).sum() if k is not None or hidden else 0.0, hidden
    return found


def hidden_of(core: NDArray[Any], string: str, raised: Sequence[Mapping[str, Any]]) -> set[int]:
    """Return the cells (from 1) of a string that have an alarm of heat and whose core is not known."""
    hot = {a["cell"] for a in raised if a["level"] == "alarm" and a["string"] == string and a["code"] in OF_HEAT}
    return {k for k in hot if k and np.isnan(core[k - 1])}


def driven_by(past: NDArray[np.float32], judged: Judged) -> None:
    """Add the inputs of the strings at that tick."""
    past[:, DRIVEN] = [[j.current, j.inlet, j.flow, j.soc, j.voltage] for j in judged.strings]


def history(ticks: Sequence[Tick], s: int, part: slice, name: str, first_ns: int) -> dict[str, Any]:
    """Return the past of one string in about `POINTS` points at most.

    No excursion of the hottest point is hidden, and no moment in which cells were not known: `dark` are the cells
    (from 1) that were not known at some time, and `burning` those of them that had an alarm of heat then.

    Parameters
    ----------
    ticks : sequence of Tick
    s : int
        String, from 0.
    part : slice
        Its cells.
    name : str
    first_ns : int
        Zero of the times.
    """
    t = np.array([x.time_ns for x in ticks], np.int64)
    past = np.stack([x.past[s] for x in ticks]).astype(np.float64)
    unknown = past[:, 8].copy()
    size = -(-len(t) // (POINTS // 2))
    hot = np.pad(past[:, 0], (0, -len(t) % size), constant_values=np.nan).reshape(-1, size)
    peaks = np.where(np.isnan(hot), -np.inf, hot).argmax(axis=1) + size * np.arange(len(hot))
    rows = np.unique(np.minimum(np.concatenate([peaks, np.arange(0, len(t), size), [len(t) - 1]]), len(t) - 1))
    # a point stands for its stretch: a cell that was not known in any part of it was not known
    lost = np.pad(past[:, 8:], ((0, -len(t) % size), (0, 0))).reshape(-1, size, 2).max(axis=1)
    past[rows, 8:] = lost[rows // size]
    dark, burning = set[int](), set[int]()
    for x in (x for x in ticks if x.past[s, 8] > 0.0):
        core = x.cells[0, part]
        dark |= set((np.flatnonzero(np.isnan(core)) + 1).tolist())
        burning |= hidden_of(core, name, x.alerts) if x.past[s, 9] > 0.0 else set()
    found: dict[str, Any] = {"t": np.round((t[rows] - first_ns) * 1e-9, 1).tolist()}
    found |= {"dark": sorted(dark), "burning": sorted(burning), "share": float((unknown > 0.0).mean())}
    for name, column in zip(PAST, past[rows].T, strict=True):
        found[name] = [round(x, 3) if isfinite(x) else None for x in column.tolist()]
    return found


COLUMNS: Final = (
    "time_s",
    "wall_clock",
    "string",
    "cell",
    "core_C",
    "core_95_K",
    "hottest_point_C",
    "hottest_point_95_K",
    "surface_C",
    "unexplained_heat_W",
    "quality",
    "current_A",
    "coolant_inlet_C",
)


def table(
    ticks: Sequence[Tick], names: Sequence[str], parts: Sequence[slice], words: dict[int, str]
) -> Iterator[bytes]:
    """Write a stretch of estimates as CSV, tick by tick, one row for each cell, on the clock of the frames."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n")
    write.writerow(COLUMNS)
    for x in ticks:
        when = [f"{x.time_ns * 1e-9:.3f}", wall_clock(x.time_ns)]
        for s, (name, part) in enumerate(zip(names, parts, strict=True)):
            drive = [_text(v) for v in x.past[s, 3:5].tolist()]
            core, sd, surface, centre, centre_sd, heat, _ = x.cells[:, part].tolist()
            for k, q in enumerate(x.quality[part].tolist()):
                numbers = (core[k], 1.96 * sd[k], centre[k], 1.96 * centre_sd[k], surface[k], heat[k])
                write.writerow([*when, name, k + 1, *map(_text, numbers), words[q], *drive])
        yield out.getvalue().encode()
        out.seek(0)
        out.truncate()


def wall_clock(time_ns: int) -> str:
    """Give the time of day in UTC; empty if the stamps are not times of a clock.

    Examples
    --------
    >>> wall_clock(1_700_000_000_250_000_000), wall_clock(3_000_000_000)
    ('2023-11-14T22:13:20.250Z', '')
    """
    if time_ns < SET_NS:
        return ""
    return datetime.fromtimestamp(time_ns * 1e-9, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _text(x: float) -> str:
    return f"{x:.3f}" if isfinite(x) else ""
