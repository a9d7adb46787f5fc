"""What `encode` finds wrong with a table before and after it became frames."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.plan import Channel, StringPlan
from bms_gateway.errors import UsageError
from bms_gateway.frames.database import Database
from bms_gateway.records.kind import log_kind
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
