"""Columns of a table besides those of the model: a list of them, and one of them as a further track."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from bms_gateway.diagnosis.record import Record
from bms_gateway.errors import DataError, did_you_mean
from bms_gateway.identify.coordinates import Measured
from bms_gateway.records.kind import log_kind
from bms_gateway.report.columns import OWN, Column, bare_unit, find_columns, quantity_of, split_unit
from bms_gateway.report.file_rows import Rows
from bms_gateway.report.guess import is_percent
from bms_gateway.report.html_figures import BLACK, STEPS, axis, layout, line, shaded
from bms_gateway.report.html_series import breaks_of, broken, clock, extent, missing_in
from bms_gateway.report.look import look
from bms_gateway.report.page import Figure
from bms_gateway.report.table import converted, dates_of, known, open_table, parse_columns
from bms_gateway.thermal import Floats
from bms_gateway.workbench.series import Shelf

HEIGHT: Final = 170
HELD: Final = ("current_A", "soc", "coolant_flow_m3_s")
"""Quantities that are held from row to row, whatever their values."""
STAYS: Final = 0.5
"""Share of the rows that equal the previous row, above which a column is drawn in steps."""
EPOCH_S: Final = 1e8
"""Times from here on are wall clock, in s since 1970; smaller ones are the record's own, or times of day."""

UTC, LOCAL, DAY = "utc", "local", "day"


def about(path: Path, columns: Sequence[str], record: Record) -> dict[str, Any]:
    """Return which columns can be drawn, and when a record began.

    Returns
    -------
    dict
        `others`: name and unit of each column of numbers except the time; none for a log. `began`: s since 1970, or
        since midnight if the table has only times of the day; None if unknown. `clock`: "utc", "local" for dates
        without a time zone, "day" for times of the day, or "" if unknown. Only times of one clock can be compared.
    """
    others, began, clock = _about(path, columns, float(record.instants[0]))
    return {"others": others, "began": began, "clock": clock}


def _about(path: Path, columns: Sequence[str], first: float) -> tuple[list[dict[str, str]], float | None, str]:
    since_1970 = (first, UTC) if first > EPOCH_S else (None, "")
    if log_kind(path) is not None:
        return [], *since_1970
    told = parse_columns(columns)
    others = [
        {"name": c["name"], "unit": _unit(c["ours"]) if c["by"] in ("name", "told") else c["stated"]}
        for c in look(path, told)["columns"]
        if "low" in c and not (c["ours"] == "time_s" and c["by"] in ("name", "told"))
    ]
    if first > EPOCH_S:
        return others, *since_1970
    with open_table(path) as rows:
        time = _columns(path, rows, columns)["time_s"]
        dates = dates_of(path, rows, time)
        next(rows.pieces([time.column], dates))
        starts = [(s, UTC if form.zoned else LOCAL) for form in dates.values() if (s := form.began_s) is not None]
        starts += [(rows.began_s, LOCAL)] if rows.began_s is not None else []
    if not starts:
        return others, None, ""
    began, clock = starts[0][0] + first, starts[0][1]
    return others, began, clock if began > EPOCH_S else DAY


def track(path: Path, columns: Sequence[str], name: str, record: Record, m: Measured, shelf: Shelf) -> Figure:
    """Draw one column of a record's table over time, in our unit if it is one of our quantities.

    Raises
    ------
    DataError
        There is no such column, or it contains no numbers.
    """
    if log_kind(path) is not None:
        raise DataError(f"{path.name}: a log has no columns: tracks are drawn of tables")
    ends = extent(m)
    with open_table(path) as rows:
        if name not in rows.names:
            raise DataError(f"{path.name}: no column {name!r}{did_you_mean(name, rows.names)}")
        ours = _columns(path, rows, columns)
        time = ours["time_s"]
        what, column = next(((o, c) for o, c in ours.items() if c.bare == name), ("", Column(name)))
        unit = _unit(what) if what else _stated(rows, name)
        dates = dates_of(path, rows, time)
        t, y = _read(rows, time, column, dates)
    if what == "soc" and not is_percent(y):
        y = 100.0 * y
    t = t - float(record.instants[0])
    inside = (t >= ends[0]) & (t <= ends[1])
    if not np.isfinite(y[inside]).any():
        raise DataError(f"{path.name}: column {name!r} holds no number within the record")
    axis_of = clock(float(ends[1]))
    base = name if what else split_unit(name)[0]
    spec = layout(HEIGHT, m, axis_of, yaxis=axis(unit), shapes=shaded(m, axis_of))
    spec["title"] = {"text": f"{base}, {unit}" if unit else base, "font": {"size": 13}, "x": 0.01, "xanchor": "left"}
    drawn = {k: v for k, v in line([], [], base, BLACK, width=1.2, showlegend=False).items() if k not in ("x", "y")}
    held = what in HELD or _switches(y[inside])
    if held:
        drawn["line"]["shape"] = STEPS
    t, y = t[inside], y[inside]
    t, y = broken(t, y, sorted({*breaks_of(m), *missing_in(t[np.isfinite(y)], held=held)}))
    return {
        "data": [{**drawn, "kept": shelf.keep(t / axis_of.seconds, y)}],
        "layout": spec,
        "seconds": axis_of.seconds,
    }


def _switches(y: Floats) -> bool:
    """Whether a column is more often constant from row to row than not, as states and coarse readings are.

    Examples
    --------
    >>> _switches(np.array([0.0, 0.0, 0.0, np.nan, 1.0, 1.0])), _switches(np.array([0.0, 0.1, 0.2, 0.2]))
    (True, False)
    """
    known = y[np.isfinite(y)]
    return len(known) > 1 and float(np.mean(np.diff(known) == 0.0)) > STAYS


def _columns(path: Path, rows: Rows, columns: Sequence[str]) -> dict[str, Column]:
    return find_columns(path, rows.names, rows.units, parse_columns(columns), [n for n in rows.names if known(n)])


def _unit(ours: str) -> str:
    return "%" if ours == "soc" else OWN[quantity_of(ours)]


def _stated(rows: Rows, name: str) -> str:
    below = dict(zip(rows.names, map(bare_unit, rows.units), strict=True)) if rows.units is not None else {}
    return split_unit(name)[1] or below.get(name) or ""


def _read(rows: Rows, time: Column, column: Column, dates: Any) -> tuple[Floats, Floats]:
    """Return time and values of the whole file."""
    parts = [
        (
            converted(p.values[time.column], time, time.column in dates),
            converted(p.values[column.column], column, column.column in dates),
        )
        for p in rows.pieces({time.column, column.column}, dates)
    ]
    return np.concatenate([t for t, _ in parts]), np.concatenate([y for _, y in parts])
