"""The past of a pack: the hottest point of a string over time, and a stretch of all estimates as a table."""

import csv
import io
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from math import isfinite
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine import Judged
from bms_gateway.thermal.centre import hottest_of
from bms_gateway.workbench.kept_ticks import Tick

PAST: Final = ("hottest", "half", "cell", "current", "inlet", "flow", "soc", "voltage")
"""Stored numbers of each string at each tick: °C, K, from 1, A, °C, over nominal, 0…1, V."""
POINTS: Final = 600
"""Number of points of a history: the width of its figure."""
SET_NS: Final = 10**18
"""Stamps from here on (2001) are wall clock; smaller ones count from another start."""


def past_of(centre: NDArray[Any], centre_sd: NDArray[Any], parts: Sequence[slice]) -> NDArray[np.float32]:
    """Start the `PAST` (S, 8) of a tick with the hottest point of each string; the inputs are not known yet."""
    found = np.full((len(parts), len(PAST)), np.nan, np.float32)
    for s, part in enumerate(parts):
        k = hottest_of(centre[part])
        if k is not None:
            found[s, :3] = centre[part][k], 1.96 * centre_sd[part][k], k + 1
    return found


def driven_by(past: NDArray[np.float32], judged: Judged) -> None:
    """Add the inputs of the strings at that tick."""
    past[:, 3:] = [[j.current, j.inlet, j.flow, j.soc, j.voltage] for j in judged.strings]


def history(ticks: Sequence[Tick], s: int, first_ns: int) -> dict[str, Any]:
    """Return the past of one string in about `POINTS` points at most; no excursion of the hottest point is hidden.

    Parameters
    ----------
    ticks : sequence of Tick
    s : int
        String, from 0.
    first_ns : int
        Zero of the times.
    """
    t = np.array([x.time_ns for x in ticks], np.int64)
    past = np.stack([x.past[s] for x in ticks]).astype(np.float64)
    size = -(-len(t) // (POINTS // 2))
    hot = np.pad(past[:, 0], (0, -len(t) % size), constant_values=np.nan).reshape(-1, size)
    peaks = np.where(np.isnan(hot), -np.inf, hot).argmax(axis=1) + size * np.arange(len(hot))
    rows = np.unique(np.minimum(np.concatenate([peaks, np.arange(0, len(t), size), [len(t) - 1]]), len(t) - 1))
    found: dict[str, Any] = {"t": np.round((t[rows] - first_ns) * 1e-9, 1).tolist()}
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
