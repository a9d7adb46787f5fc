"""A first look at a table: its columns with their first values, the interpretation of each, and proposals.

The reader is that of all commands. What names and `--columns` state is interpreted as in `read_table`; for the rest
there are proposals that a person must confirm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from bms_gateway.errors import DataError
from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.report.columns import OWN, UNITS, Column, find_columns, is_refused, quantity_of, split_unit
from bms_gateway.report.dates import DateForm, date_form
from bms_gateway.report.file_rows import Rows
from bms_gateway.report.guess import Guess, guesses, is_percent, untimely
from bms_gateway.report.table import REQUIRED, converted, known, open_table
from bms_gateway.report.table_cells import is_number
from bms_gateway.thermal import Floats

SHOWN: Final = 4
"""Number of shown cells of a column."""
DRAWN: Final = 80
"""Number of points of its curve."""
MOST_UNREAD: Final = 5
"""Number of columns without numbers that are named one by one."""
MOST: Final = 300
"""Number of shown columns."""


def look(path: Path, columns: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Look at the first rows of a table.

    Parameters
    ----------
    path : Path
    columns : mapping, optional
        From `parse_columns`.

    Returns
    -------
    dict
        `columns`: name, unit as written, first cells, `ours` (our name or ""), `by` ("name", "told", "guess" or ""),
        `unit` and `flip` that are proposed, `why`, least and greatest value and a few points in our unit. `missing`:
        our names that a table must have and that neither its names nor `columns` tell. `inlet`: a constant inlet as
        `columns` tells it, or "".

    Raises
    ------
    DataError
        As for `read_table`.
    """
    told = columns or {}
    with open_table(path) as rows:
        names = rows.names[:MOST]
        found = find_columns(path, rows.names, rows.units, told, [n for n in rows.names if known(n)])
        values = _numbers(rows, names)
        dated = _dated(rows, [n for n in names if n not in values])
        free = {n: x for n, x in values.items() if not is_refused(n)}
        proposed = guesses(names, rows.units, {ours: c.bare for ours, c in found.items()}, free, dated, told)
        looked = _Looked(rows, found, told, proposed, values)
        shown = [looked.column(k) for k in range(len(names))]
        return {
            "source": path.name,
            "columns": [c for c in shown if c["name"]],
            "missing": [name for name in REQUIRED if name not in found],
            "inlet": next((c.column for c in found.values() if c.constant is not None), ""),
            "surfaces": any(n.startswith("surface_") for n in found),
            "notes": [*rows.notes, *_unread(rows, shown, dated), *_wild(shown), *_first_rows(rows, values)],
            "units": {quantity: _units(quantity, [c["stated"] for c in shown]) for quantity in UNITS},
        }


def _dated(rows: Rows, names: Sequence[str]) -> str:
    """Return the column of dates or times of day; of several the one that is the time of the whole table, or ""."""
    forms = {n: form for n in names if (form := date_form(rows.sample(n), None)) is not None}
    return min(forms, key=lambda n: _untimely(n, forms[n], rows), default="")


def _untimely(name: str, form: DateForm | str, rows: Rows) -> int:
    try:
        return untimely(name, None if isinstance(form, str) else form.seconds(rows.sample(name)))
    except ValueError:  # the reader names the cell
        return untimely(name, None)


def _first_rows(rows: Rows, values: Mapping[str, Floats]) -> list[str]:
    """Say of how many rows the values are, if the table has more."""
    name = next(iter(values), None)
    if name is None:
        return []
    pieces = rows.pieces([name], {})
    try:
        next(pieces)
        more = next(pieces, None) is not None
    except DataError:  # of a later row; the reader tells it
        more = True
    return [f"least and greatest values are those of the first {len(values[name]):,} rows"] if more else []


def _unread(rows: Rows, shown: Sequence[Mapping[str, Any]], dated: str) -> list[str]:
    """Say which columns contain no numbers, with the first cell of each that is not a number."""
    told = []
    for c in shown:
        if not c["name"] or c["name"] == dated or "low" in c:
            continue
        cells = rows.sample(c["name"])
        word = next((cell.strip() for cell in cells if cell.strip() and not is_number(cell.strip())), None)
        told.append(f"{c['name']!r} " + ("is empty" if word is None else f"holds {word[:20]!r}, which is no number"))
    if len(told) > MOST_UNREAD:
        told = [*told[:MOST_UNREAD], f"{len(told) - MOST_UNREAD} more columns hold no numbers"]
    return told


def _wild(shown: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say which temperatures no cell or coolant can have: their unit is probably another."""
    least, most = INPUTS["surface"].plausible
    return [
        f"{c['name']!r} would be {c['low']:.0f} to {c['high']:.0f} °C: is {c['unit'] or c['stated'] or '°C'} its unit?"
        for c in shown
        if c["ours"] and "low" in c and quantity_of(c["ours"]) == "temperature"
        if c["high"] < least or c["low"] > most
    ]


def _units(quantity: str, written: Sequence[str]) -> list[str]:
    """Return one name for each unit of a quantity, and those in the file."""
    once: dict[tuple[float, float], str] = {}
    for unit, factors in UNITS[quantity].items():
        once.setdefault(factors, unit)
    return list(dict.fromkeys([*once.values(), *(u for u in written if u in UNITS[quantity])]))


def _numbers(rows: Rows, names: Sequence[str]) -> dict[str, Floats]:
    """Return the first values of every column with numbers."""
    given = [n for n in names if n]
    try:
        return dict(next(rows.pieces(given, {})).values)
    except StopIteration:
        raise DataError("the table has no rows") from None
    except DataError:  # words somewhere: one by one
        found = {}
        for name in given:
            if (x := _one(rows, name)) is not None:
                found[name] = x
        return found


def _one(rows: Rows, name: str) -> Floats | None:
    try:
        return next(rows.pieces([name], {})).values[name]
    except DataError:
        return None


@dataclass(frozen=True, slots=True)
class _Looked:
    """First rows of a table, by column.

    Attributes
    ----------
    rows : Rows
    found : mapping of str to Column
        Columns that can be read without changes, by our name.
    told : mapping of str to str
        From `parse_columns`.
    proposed : mapping of str to Guess
        By the table's name.
    values : mapping of str to ndarray
        First values of the columns with numbers, by the table's name.
    """

    rows: Rows
    found: Mapping[str, Column]
    told: Mapping[str, str]
    proposed: Mapping[str, Guess]
    values: Mapping[str, Floats]

    def column(self, at: int) -> dict[str, Any]:
        """Describe one column."""
        rows, name = self.rows, self.rows.names[at]
        ours = {c.bare: ours for ours, c in self.found.items()}.get(name, "")
        guess, x = self.proposed.get(name), self.values.get(name)
        by = "told" if ours in self.told else "guess" if guess else "name" if ours else ""
        c = self.found.get(ours)
        stated = split_unit(name)[1] or (rows.units[at].strip().strip("[]()") if rows.units is not None else "")
        unit = (c.unit or c.date) if c is not None else guess.unit if guess else None
        what = ours or (guess.ours if guess else "")
        flip = guess.flip if guess else c is not None and c.column != c.bare
        document: dict[str, Any] = {
            "name": name,
            "stated": stated or "",
            "cells": (rows.sample(name) or [f"{v:g}" for v in (x if x is not None else ())[:SHOWN]])[:SHOWN],
            "ours": what,
            "by": by,
            "unit": unit or "",
            "flip": flip,
            "why": guess.why if guess else "",
        }
        if x is None or not np.isfinite(x).any():
            return document
        factors = (c.factor, c.shift) if c is not None else _factors(what, unit or stated)
        values = converted(x, Column(name, *factors), False)
        values = -values if flip else values
        if what == "soc" and factors == (1.0, 0.0) and is_percent(values):
            values = 0.01 * values  # as the reader does without a request
        few = values[:: max(len(values) // DRAWN, 1)]
        return document | {
            "low": float(np.nanmin(values)),
            "high": float(np.nanmax(values)),
            "in": OWN[quantity_of(what)] if what else stated or "",
            "points": [None if v != v else float(f"{v:.5g}") for v in few.tolist()],
        }


def _factors(ours: str, unit: str) -> tuple[float, float]:
    return UNITS[quantity_of(ours)].get(unit, (1.0, 0.0)) if ours and unit else (1.0, 0.0)
