"""Checks of a table by `encode`, before and after it is converted to frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.cli.pack_voltage import of_a_pack, of_cells
from bms_gateway.engine.plan import Channel, StringPlan
from bms_gateway.engine.reasons import REASONS
from bms_gateway.errors import DataError, UsageError
from bms_gateway.frames.database import Database
from bms_gateway.frames.encode import not_available
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.records.kind import log_kind
from bms_gateway.report.table import Table

UNITS: dict[str, tuple[tuple[str, str, float, float], ...]] = {
    "current": (("mA", "A", 1e-3, 0.0),),
    "voltage": (("mV", "V", 1e-3, 0.0),),
    "temperature": (("K", "°C", 1.0, -273.15), ("m°C", "°C", 1e-3, 0.0)),
    "soc": (("%", "shares of 1", 1e-2, 0.0),),
    "flow": (("l/min", "m³/s", 1e-3 / 60.0, 0.0),),
}
"""Units in which each kind of quantity may be written: unit, that of a table, factor and offset to the latter."""
SHORT = REASONS[Quality.SHORT]
MOST_NAMED = 4
MOSTLY = 0.9
FAR_S = 10.0
"""s. If the rows of a current are not further apart, its heat is right on average: cells follow more slowly."""
STEPS = 0.25
"""Mean step of the squared current from row to row, over its mean; above it, the current between rows is unknown."""


def refuse_log(path: Path) -> None:
    """Refuse a log that is given as a table.

    Raises
    ------
    UsageError
        By its name or its first bytes the file is a log.
    """
    kind = log_kind(path)
    if kind is not None:
        raise UsageError(f"encode: {path}: takes a table; this is a {kind} log, frames already: use analyze or replay")


def not_carried(string: StringPlan, database: Database, table: Table) -> list[dict[str, Any]]:
    """Find the columns with values outside the range of their signal.

    Returns
    -------
    list of dict
        One per column: number of rows, place of the first, range that would fit in the table's unit, and what is sent.
    """
    found: list[dict[str, Any]] = []
    for c in string.carried:
        values = _column(table, c)
        if values is None:
            continue
        info = database.resolve(c.signal or "")
        low, high = _raw_range(info)
        with np.errstate(over="ignore"):  # neither 1e308 nor infinity fits any signal
            raw = ((values - c.offset) / c.scale - info.offset) / info.scale
        raw = raw if info.is_float else np.rint(raw)
        rows = np.flatnonzero((raw < low) | (raw > high))
        if not len(rows):
            continue
        lowest, highest = _carried(c, info)
        found.append(
            {
                "column": INPUTS[c.quantity].column.format(c.cell),
                "rows": len(rows),
                "first": f"{table.place(int(rows[0]))} ({values[rows[0]]:g})",
                "signal": c.signal,
                # a float signal may have one limit only
                "lowest": max(lowest, -np.finfo(np.float64).max),
                "highest": min(highest, np.finfo(np.float64).max),
                "sent_as": "not available" if info.j1939 else "the nearest limit",
            }
        )
    return found


def refuse_made_up(string: StringPlan, table: Table, made_up: Sequence[Channel]) -> None:
    """Refuse a table that lacks a quantity whose signal would have to be sent without a value.

    Raises
    ------
    DataError
        Some channels have no values, share their frames with known ones, and cannot be sent as not available.
    """
    if made_up:
        c = made_up[0]
        what = f"{INPUTS[c.quantity].column.format(c.cell)} has no values"
        if c not in string.carried:
            what = f"the table says nothing of {c.signal}, which another string of the config takes"
        raise DataError(
            f"{table.source}: {what}, {c.signal} cannot say so, and other values of its frames are known: nothing was "
            "written; use a config without this signal"
        )


def empty(
    string: StringPlan, database: Database, table: Table, in_place: Mapping[str, float]
) -> list[tuple[bool, str]]:
    """List the signals of the string without a measurement, because the column is missing or entirely blank.

    Parameters
    ----------
    in_place : mapping of signal to what is sent of it, SI

    Returns
    -------
    list of (missing, sentence)
        `missing`: the column does not exist.
    """
    alike: dict[tuple[bool, str], list[str]] = {}
    for c in string.channels:
        values = _column(table, c)
        if c.signal is None or c.statistic is not None or (values is not None and np.isfinite(values).any()):
            continue
        says = not_available(database.resolve(c.signal)) is not None
        sent = "{its} sent as not available" if says else "no measurement of {it} is sent"
        if (value := in_place.get(c.signal)) is not None:
            reason = SHORT if INPUTS[c.quantity].kind == "temperature" else "out of its range"
            given = f"{value:.6g} {INPUTS[c.quantity].unit}".rstrip()
            sent = f"{{its}} sent as {given}, which the gateway refuses: {reason}"
        alike.setdefault((values is None, sent), []).append(INPUTS[c.quantity].column.format(c.cell))
    found = []
    for (missing, sent), columns in alike.items():
        many, more = len(columns) > 1, len(columns) - MOST_NAMED
        shown = ", ".join(columns[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
        it, its = ("them", "their signals are") if many else ("it", "its signal is")
        what = f"no column {shown}" if missing else f"{shown} {'have' if many else 'has'} no values"
        found.append((missing, f"{what}: {sent.format(it=it, its=its)}"))
    return found


def refuse_nothing(string: StringPlan, table: Table) -> None:
    """Refuse a table without a single value for a signal of the string.

    Raises
    ------
    DataError
    """
    columns = [(c, _column(table, c)) for c in string.channels if c.signal is not None and c.statistic is None]
    several = [x for c in string.channels for k in c.among if (x := table.surface_C.get(k)) is not None]
    if not any(x is not None and np.isfinite(x).any() for x in (*(x for _, x in columns), *several)):
        wanted = ", ".join(INPUTS[c.quantity].column.format(c.cell) for c, _ in columns[:MOST_NAMED])
        raise DataError(
            f"{table.source}: no row has a value of {wanted} …: nothing was written; fill the cells, or map other "
            "columns (--columns NAME=COLUMN)"
        )


def far_apart(table: Table) -> float | None:
    """Give the distance of a current's rows, s, if the current moves so much that its values in between are unknown."""
    known = np.isfinite(table.current_A)
    spacing, current = np.diff(table.time_s[known]), table.current_A[known]
    if not len(spacing) or (typical := float(np.median(spacing))) <= FAR_S:
        return None
    square = np.square(current / (np.abs(current).max() or 1.0))
    return typical if float(np.abs(np.diff(square)).mean()) > STEPS * float(square.mean()) else None


def refuse_other_units(string: StringPlan, database: Database, table: Table) -> None:
    """Refuse a table in which a whole quantity would be lost, because its unit or its column is wrong.

    Raises
    ------
    DataError
        The signal cannot carry over half of a column's values, or the gateway would refuse them. The message names the
        unit in which they would be right.
    """
    for c in string.carried:
        values = _column(table, c)
        if values is None:
            continue
        given = values[np.isfinite(values)]
        ends, believed = _carried(c, database.resolve(c.signal or "")), INPUTS[c.quantity].plausible
        low, high = max(ends[0], believed[0]), min(ends[1], believed[1])
        least, most = of_cells(string, low, high) if c.quantity == "voltage" else (low, high)
        lost = int(((given < low) | (given > high)).sum())
        if 2 * lost <= len(given):
            continue
        meant = [
            (other, wanted)
            for other, wanted, factor, offset in UNITS.get(INPUTS[c.quantity].kind, ())
            if ((given * factor + offset >= least) & (given * factor + offset <= most)).mean() > MOSTLY
        ]
        column = INPUTS[c.quantity].column.format(c.cell)
        line = ""
        if c.quantity == "voltage" and (told := of_a_pack(string, given)) and not meant:
            line = f": {told}"
        elif meant:
            unit, wanted = meant[0][:2]
            line = f": are they in {unit}? A table takes {wanted}: --columns '{column}=COLUMN [{unit}]'"
        raise DataError(
            f"{table.source}: {column}: {lost} of {len(given)} values are outside {low:.6g} to "
            f"{high:.6g}, what {c.signal} carries and the gateway believes{line}; nothing was written"
        )


def _raw_range(info: SignalInfo) -> tuple[float, float]:
    """Raw values as the encoder takes them."""
    low, high = max(info.raw_valid[0], info.raw_limits[0]), min(info.raw_valid[1], info.raw_limits[1])
    return (low, high) if low <= high else info.raw_limits


def _carried(c: Channel, info: SignalInfo) -> tuple[float, float]:
    """Least and greatest value of a channel that its signal carries, in the table's unit."""
    low, high = sorted(c.scale * (info.scale * end + info.offset) + c.offset for end in _raw_range(info))
    return low, high


def _column(table: Table, c: Channel) -> NDArray[np.float64] | None:
    values = None if c.statistic is not None else table.of(c.quantity, c.cell)
    return None if values is None else c.share(values)
