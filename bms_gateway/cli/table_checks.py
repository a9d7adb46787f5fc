"""What `encode` finds wrong with a table before and after it became frames."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.candump import LATEST_S
from bms_gateway.bus.logfile import FORMATS
from bms_gateway.bus.sniff import HEAD, kind_of
from bms_gateway.engine.plan import Channel, StringPlan
from bms_gateway.errors import DataError, UsageError
from bms_gateway.frames.database import Database
from bms_gateway.report.table import Table

COLUMNS = {
    "current": "current_A",
    "voltage": "voltage_V",
    "coolant_inlet": "coolant_inlet_C",
    "soc": "soc",
    "coolant_flow": "coolant_flow_m3_s",
    "surface": "surface_{}_C",
    "cell_voltage": "cell_voltage_{}_V",
}
"""Column of a table by quantity."""
LONGEST_S = 10 * 86_400  # a bench run; more is time in another unit
WIDEST_STEP_S = 100.0  # ten rows a second in ms; of a current known this seldom nobody can tell the heat


def refuse_log(path: Path) -> None:
    """Tell a log that is given as a table.

    Raises
    ------
    UsageError
        By its name or its first bytes it is a log.
    """
    kind = log_kind(path)
    if kind is not None:
        raise UsageError(f"encode: {path}: takes a table; this is a {kind} log, frames already: use analyze or replay")


def log_kind(path: Path) -> str | None:
    """Tell by its name, or where that leaves it open by its first bytes, which kind of log a file is; None: none."""
    suffixes = [s for s in Path(path.name.lower()).suffixes if s != ".gz"]
    kind: str | None = suffixes[-1] if suffixes else ""
    if kind == ".csv" or kind not in FORMATS:
        kind = None if path.suffix.lower() == ".gz" else _content(path)
    return kind


def _content(path: Path) -> str | None:
    """Format of a log whose text is sure to be none of a table."""
    try:
        with path.open("rb") as file:
            kind = kind_of(file.read(HEAD))
    except OSError:  # reading the table will say it
        return None
    return kind if kind in (".log", ".csv") else None


def check_time(table: Table) -> None:
    """Refuse a time that no log can hold, or that is plainly not in seconds.

    Raises
    ------
    DataError
    """
    t = table.time_s
    if t[0] < 0:
        raise DataError(f"{table.source}: time_s begins at {t[0]:g}: a log cannot hold times below zero")
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if t[-1] >= LATEST_S:
        seen = f"ends at {t[-1]:g}, after the year 2255"
    elif step >= WIDEST_STEP_S:
        seen = f"goes on by {step:g} from row to row, where less than {WIDEST_STEP_S:g} s are needed"
    elif t[-1] - t[0] > LONGEST_S:
        seen = f"spans {(t[-1] - t[0]) / 86_400:.1f} days, more than the {LONGEST_S // 86_400} that one table may"
    else:
        return
    raise DataError(f"{table.source}: time_s looks like milliseconds, it must be in seconds: it {seen}")


def not_carried(string: StringPlan, database: Database, table: Table) -> list[dict[str, Any]]:
    """Find the columns with values that their signal cannot carry.

    Parameters
    ----------
    string : StringPlan
    database : Database
    table : Table

    Returns
    -------
    list of dict
        One per column: how many rows, where the first is, what would fit in the table's unit, what is sent instead.
    """
    found: list[dict[str, Any]] = []
    for c in string.channels:
        values = _column(table, c)
        if c.signal is None or values is None:
            continue
        info = database.resolve(c.signal)
        # the range as the encoder takes it
        low, high = max(info.raw_valid[0], info.raw_limits[0]), min(info.raw_valid[1], info.raw_limits[1])
        low, high = (low, high) if low <= high else info.raw_limits
        raw = ((values - c.offset) / c.scale - info.offset) / info.scale
        raw = raw if info.is_float else np.rint(raw)
        rows = np.flatnonzero((raw < low) | (raw > high))
        if not len(rows):
            continue
        lowest, highest = sorted(c.scale * (info.scale * end + info.offset) + c.offset for end in (low, high))
        found.append(
            {
                "column": COLUMNS[c.quantity].format(c.cell),
                "rows": len(rows),
                "first": f"{table.place(int(rows[0]))} ({values[rows[0]]:g})",
                "signal": c.signal,
                # a float signal may have but one end
                "lowest": max(lowest, -np.finfo(np.float64).max),
                "highest": min(highest, np.finfo(np.float64).max),
                "sent_as": "not available" if info.j1939 else "the nearest limit",
            }
        )
    return found


def _column(table: Table, c: Channel) -> NDArray[np.float64] | None:
    if c.cell is not None:
        return (table.surface_C if c.quantity == "surface" else table.cell_voltage_V).get(c.cell)
    values: NDArray[np.float64] | None = getattr(table, COLUMNS[c.quantity])
    return values
