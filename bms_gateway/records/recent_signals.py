"""The recent signals of the gateway, from its ring on disk into a table: for `export` and for the workbench."""

import csv
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.errors import DataError, UsageError, did_you_mean
from bms_gateway.frames.vocabulary import CELL_COLUMNS
from bms_gateway.report.columns import refused_name

if TYPE_CHECKING:
    from bms_gateway.store.rows import Excerpt

STATE_DIRECTORY = Path("/var/lib/bms-gateway")
"""State directory of the service that `install.sh` sets up."""
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
_SPAN = re.compile(r"(\d+(?:\.\d+)?) ?([A-Za-z]*)")


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of recorded time: its length [s] and its end [µs]; without an end, it ends with the newest signal.

    `refused` are the cells whose thermocouple is not to be used in it, and why: their columns are named so.
    """

    last_s: float
    until_us: int | None = None
    refused: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Written:
    """A table that was written: of which string, its columns, rows, first and last time in s."""

    string: str
    columns: tuple[str, ...]
    rows: int
    first_s: float
    last_s: float


def given_span(words: str, option: str = "export: --last") -> float:
    """Read a span of time as people write it, s.

    Parameters
    ----------
    words : str
    option : str
        What errors call it.

    Raises
    ------
    UsageError

    Examples
    --------
    >>> given_span("90s"), given_span("30min"), given_span("1.5h"), given_span("1d")
    (90.0, 1800.0, 5400.0, 86400.0)
    """
    match = _SPAN.fullmatch(words.strip())
    if match is None:
        raise UsageError(f"{option} '{words}': expected a number with its unit: 90s, 30min, 2h or 1d")
    number, unit = match.groups()
    if unit not in UNITS:
        what = f"unknown unit '{unit}'" if unit else "the unit is missing"
        near = {"m": "min", "sec": "s", "mins": "min", "hours": "h", "hour": "h", "days": "d", "day": "d"}.get(unit)
        hint = f"; did you mean {number}{near}?" if near else ""
        raise UsageError(f"{option} '{words}': {what}; valid: {', '.join(UNITS)}, as in 90s, 30min, 2h, 1d{hint}")
    seconds = float(number) * UNITS[unit]
    if not 0.0 < seconds <= 3660 * UNITS["d"]:
        raise UsageError(f"{option} '{words}': must be above 0 and at most ten years")
    return seconds


def state_directory(config: Path | None, store: Path | None, command: str) -> Path:
    """Find the state directory: the one that was named, else that of the config, else that of the installed service.

    Raises
    ------
    GatewayError
        There is none, or the config is wrong.
    """
    if store is not None:
        if not store.is_dir():
            raise UsageError(f"{command}: --store {store}: no such directory")
        return store
    if config is None:
        return STATE_DIRECTORY
    from bms_gateway.config import load_config

    return load_config(config).store or STATE_DIRECTORY


def write_recent(
    out: Path,
    directory: Path,
    stretch: Stretch,
    string: str | None,
    command: str,
    tell: Callable[[str], None],
) -> Written:
    """Write a stretch of a string's signals to a table; the file is complete, or it is not written.

    Parameters
    ----------
    out : Path
    directory : Path
        The gateway's state; it may be running.
    stretch : Stretch
    string : str or None
        Needed where several are recorded.
    command : str
        What errors begin with.
    tell : callable
        Called with a sentence for each part of the ring that could not be used.

    Raises
    ------
    GatewayError
        Nothing was recorded, or nothing of this string.
    """
    from bms_gateway.store.rows import excerpt

    found = excerpt(directory / "recent", stretch.last_s, stretch.until_us)
    for problem in found.problems:
        tell(str(problem))
    name = _string(found, string, command)
    if found.turned_back:
        tell("the clock went back in this time: what was recorded before that is left out, it cannot be the same table")
    return _write(out, found, name, stretch.refused)


def _string(found: "Excerpt", name: str | None, command: str) -> str:
    names = list(found.columns)
    if not names:
        raise DataError(f"{command}: no signal of any string was recorded in this time")
    if name is None:
        if len(names) > 1:
            raise UsageError(f"{command}: --string is needed, several are recorded; valid: {', '.join(names)}")
        return names[0]
    if name not in names:
        raise UsageError(f"{command}: --string '{name}' is not recorded in this time{did_you_mean(name, names)}")
    return name


def _write(out: Path, found: "Excerpt", name: str, refused: Mapping[int, str]) -> Written:
    from bms_gateway.report.progress import progress
    from bms_gateway.whole import whole_text

    first_us, last_us = found.first_us, found.last_us
    count, first, last = 0, 0.0, 0.0
    with whole_text(out) as f:
        own = {CELL_COLUMNS["surface"].format(k): refused_name(k, why) for k, why in refused.items()}
        csv.writer(f, lineterminator="\n").writerow(["time_s", *(own.get(c, c) for c in found.columns[name])])
        with progress("exporting", (last_us - first_us) * 1e-6) as advance:
            for row in found.rows(name):
                f.write(",".join(row) + "\n")
                last_before, last = last, float(row[0])
                first = last if not count else first
                advance(last - last_before if count else 0.0)
                count += 1
    return Written(name, tuple(found.columns[name]), count, first, last)
