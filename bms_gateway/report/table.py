"""Tables of measurements (CSV or Parquet) as arrays: the columns by name, blanks as NaN, errors with their line.

Files are read in pieces, and only the numbers of the needed columns are kept.
"""

import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.record_inputs import Columns, all_along
from bms_gateway.errors import DataError, UsageError, counted, did_you_mean, nearest_file
from bms_gateway.frames.vocabulary import CELL_COLUMNS, INPUTS, WHOLE
from bms_gateway.report.columns import INLET, Column, find_columns, is_refused, refused_in
from bms_gateway.report.dates import DateForm, date_form
from bms_gateway.report.file_mdf import open_mdf
from bms_gateway.report.file_rows import Piece, Rows, open_csv, open_parquet
from bms_gateway.report.guess import lookalike
from bms_gateway.report.progress import progress
from bms_gateway.thermal import Floats

REQUIRED = ("time_s", *(INPUTS[q].column for q in WHOLE if INPUTS[q].needed))
OPTIONAL = tuple(INPUTS[q].column for q in WHOLE if not INPUTS[q].needed)
_WHOLE = (*REQUIRED, *OPTIONAL)
MOST_NUMBERS = 16 << 20
"""Numbers that any table may have: 128 MiB. A larger table has at most `PER_BYTE` of them for each byte of its file."""
PER_BYTE = 2
FEW = 12
"""Names of a table that are shown in one line."""
_CELL_COLUMN = re.compile("|".join(column.format("([1-9][0-9]{0,8})") for column in CELL_COLUMNS.values()))
_OURS = (*_WHOLE, *(column.split("{")[0] for column in CELL_COLUMNS.values()))
_NEXT = re.compile(rf",(?=\s*(?:{'|'.join(_OURS)})[A-Za-z0-9_]*\s*=)")
"""A comma that another pair follows; other commas belong to the name of a column."""
_MOSTLY = 10
"""Median of the state of charge above which it is in per cent."""
PER_CENT: Final = 0.01
_SUMMER: Final = ": one hour back is the end of summer time; write the times in UTC, or cut the table there"
_EXAMPLES = (*_WHOLE, *(column.format(1) for column in CELL_COLUMNS.values()))


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Columns):
    """The columns of a file and their sources; `time_s` has no blanks.

    Attributes
    ----------
    ignored : tuple of str
        Columns with unknown names, reported to the user because one may be misspelt.
    word, lines : str, ndarray of int (K,)
        Word for the file's rows, and the number of each.
    notes : tuple of str
        What was recognised and is unusual for a table, a sentence each.
    dated : bool
        Whether the times are dates or times of day, counted from the first row.
    """

    ignored: tuple[str, ...]
    word: str
    lines: NDArray[np.int64]
    notes: tuple[str, ...] = ()
    dated: bool = False

    def place(self, row: int) -> str:
        """Return the place of a row (from 0) in the file."""
        return f"{self.word} {self.lines[row]}"

    def __len__(self) -> int:
        return len(self.time_s)


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """Read `--columns name=column` options.

    Parameters
    ----------
    pairs : iterable of str
        `name=column`; several may be in one option, separated by commas. `name=-column` changes the sign, `name=column
        [mA]` states the unit. `coolant_inlet_C=22 °C` is a constant if no column has this name.

    Returns
    -------
    dict
        Column of the file by our name.

    Raises
    ------
    UsageError
        Not of that form, a name that no table has, or one given twice.

    Examples
    --------
    >>> parse_columns(["time_s=t_s,current_A=-I_A", "surface_1_C=T surf"])
    {'time_s': 't_s', 'current_A': '-I_A', 'surface_1_C': 'T surf'}
    >>> parse_columns(["voltage_V=U, pack (mV),current_A=I, pack"])
    {'voltage_V': 'U, pack (mV)', 'current_A': 'I, pack'}
    """
    found: dict[str, str] = {}
    for pair in pairs:
        parts = pair.split(",")
        for part in parts if all("=" in p for p in parts) else _NEXT.split(pair):
            name, equals, column = part.partition("=")
            name, column = name.strip(), column.strip()
            if not (equals and name and column):
                raise UsageError(f"--columns {part!r}: expected name=column, such as current_A=I_A")
            if not known(name):
                raise UsageError(f"--columns {part!r}: no table has a column {name!r}{did_you_mean(name, _EXAMPLES)}")
            if name in found:
                raise UsageError(f"--columns {part!r}: {name} is {found[name]!r} already; name it once")
            found[name] = column
    return found


def read_table(
    path: Path,
    columns: Mapping[str, str] | None = None,
    tell: Callable[[float], None] | None = None,
    most: int | None = None,
    needed: Sequence[str] = REQUIRED,
) -> Table:
    """Read a table of measurements.

    Parameters
    ----------
    path : Path
        `.parquet`, CSV (separated by comma, semicolon or tab; also `.gz`), or `.mf4` of decoded signals.
    columns : mapping, optional
        From `parse_columns`: the file's own names.
    tell : callable, optional
        Called repeatedly with the share that was read.
    most : int, optional
        Greatest count of stored numbers. Default: a limit for the size of the file.
    needed : sequence of str
        Columns that it must have; other missing columns are NaN.

    Raises
    ------
    DataError
        Missing file or column, broken number, time that does not increase; with the line.
    MissingExtraError
        Parquet without pyarrow, MF4 without asammdf.
    """
    with open_table(path) as rows:
        return _read(path, columns or {}, rows, tell, most, needed)


@contextmanager
def open_table(path: Path) -> Iterator[Rows]:
    """Open a table: CSV, Parquet or MF4 of decoded signals.

    Raises
    ------
    DataError
        The file does not exist, is no table, or is damaged.
    MissingExtraError
        Parquet without pyarrow, MF4 without asammdf.
    """
    endings = [s.lower() for s in path.suffixes]
    kind = next((s for s in reversed(endings) if s != ".gz"), "")
    open_it = open_parquet if endings[-1:] in ([".parquet"], [".pq"]) else open_mdf if kind == ".mf4" else open_csv
    try:
        if path.is_dir():
            raise DataError(f"{path}: is a directory; expected a table, CSV or Parquet")
        if path.exists() and not path.is_file():  # reading a pipe without a writer would never end
            raise DataError(f"{path}: is no plain file; expected a table, CSV or Parquet")
        with open_it(path) as rows:
            yield rows
    except FileNotFoundError:
        raise DataError(f"{path}: no such file{_nearest(path)}") from None
    except EOFError:
        raise DataError(f"{path}: the gzip data are cut short or damaged") from None
    except OSError as e:
        raise DataError(f"{path}: cannot be read: {e.strerror or e}") from None


def _nearest(path: Path) -> str:
    """Name the nearest file in the same folder; nothing if the folder may not be read."""
    try:
        return nearest_file(path.name, [p.name for p in path.parent.iterdir() if p.is_file()])
    except OSError:
        return ""


def _read(
    path: Path,
    columns: Mapping[str, str],
    rows: Rows,
    tell: Callable[[float], None] | None,
    most: int | None,
    needed: Sequence[str],
) -> Table:
    names = rows.names
    ours = find_columns(path, names, rows.units, columns, [name for name in names if known(name)])
    missing = [name for name in needed if name not in ours]
    if missing:
        raise DataError(f"{path}: {_missing(missing, names)}")
    dates = dates_of(path, rows, ours["time_s"])
    used = {c.bare for c in ours.values()} | {c.column for c in ours.values()}
    lines, values, notes = _kept(path, rows, ours, dates, tell, most)
    nothing = np.full(len(lines), np.nan)
    notes = [*_said(ours, dates), *rows.notes, *notes]
    columns_of: dict[str, Any] = {name: values.get(name, nothing if name in REQUIRED else None) for name in _WHOLE}
    for column in CELL_COLUMNS.values():
        columns_of[column.replace("_{}", "")] = {k: values[column.format(k)] for k in _cells(values, column)}
    return Table(
        source=str(path),
        **columns_of,
        ignored=tuple(n for n in names if n not in used and not is_refused(n)),
        refused=refused_in(names),
        word=rows.word,
        lines=lines,
        notes=tuple(notes),
        dated=bool(dates) or rows.began_s is not None,
        assumed={}
        if (still := ours[INLET].constant if INLET in ours else None) is None
        else {"coolant_inlet": all_along("coolant_inlet", still)},
    )


def _missing(missing: Sequence[str], names: Sequence[str]) -> str:
    """Name all missing columns, each with the column that may be meant."""
    if not any(name.strip() for name in names):
        return f"the header, line 1, names no column; it needs {', '.join(missing)}"
    if len(names) == 1 and len(names[0].split()) > len(missing):
        return f"only one column, {names[0][:40]!r}: part the columns by commas, semicolons or tabs, not by blanks"
    constant = f"; a constant: --columns '{INLET}=22 °C'" if INLET in missing else ""
    if len(missing) > 1:
        mapped = ",".join(f"{name}={lookalike(name, names) or 'COLUMN'}" for name in missing)
        valid = f"; the table has {', '.join(names[:FEW])}" + (" …" if len(names) > FEW else "")
        return f"no columns {', '.join(map(repr, missing))}{valid} (map them: --columns '{mapped}'{constant})"
    name, hint = missing[0], did_you_mean(missing[0], names)
    like = None if "did you mean" in hint else lookalike(name, names)
    if like is not None:
        return f"no column {name!r}; {like!r} may be it (map it: --columns '{name}={like}'{constant})"
    return f"no column {name!r}{hint} (map it: --columns {name}=COLUMN{constant})"


def dates_of(path: Path, rows: Rows, time: Column) -> dict[str, DateForm]:
    """Return the form of the times if they are not numbers."""
    form = date_form(rows.sample(time.bare), time.date)
    if isinstance(form, str):
        raise DataError(f"{path}: time_s: {form.replace('COLUMN', time.bare)}")
    if form is None and time.date is not None:
        raise DataError(f"{path}: time_s: {time.bare!r} has no dates with slashes")
    return {} if form is None else {time.column: form}


def _said(ours: Mapping[str, Column], dates: Mapping[str, DateForm]) -> list[str]:
    """Say what was converted, one sentence for all columns of one unit."""
    said = [f"{column!r} has {form.name}: time_s is counted from its first row" for column, form in dates.items()]
    said += [
        f"{name} is taken as {c.constant:.4g} °C all along: no column has it"
        for name, c in ours.items()
        if c.constant is not None
    ]
    by_unit: dict[str, list[str]] = {}
    for c in ours.values():
        if c.unit is not None and (c.factor, c.shift) != (1.0, 0.0) and c.column not in dates:
            by_unit.setdefault(c.unit, []).append(c.bare)
    for unit, names in by_unit.items():
        shown = ", ".join(repr(n) for n in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        said.append(f"converted from {unit}: {shown}")
    return said


def _kept(
    path: Path,
    rows: Rows,
    ours: Mapping[str, Column],
    dates: Mapping[str, DateForm],
    tell: Callable[[float], None] | None,
    most: int | None,
) -> tuple[NDArray[np.int64], dict[str, Floats], list[str]]:
    """Join the pieces of a table, each checked on arrival; return the rows' numbers, the columns, notes."""
    size = path.stat().st_size
    meant = f"a table of {size / 1024**2:.1f} MiB can mean" if most is None else "is taken in here"
    most = max(MOST_NUMBERS, PER_BYTE * size) if most is None else most
    lines, kept = array("q"), {name: array("d") for name in ours}  # they grow in their place
    before, read = np.empty(0), 0.0
    charge = _Charge(path, rows.word, "soc" in ours and ours["soc"].factor == PER_CENT)
    with progress(path.name, size) as advance:
        for piece in rows.pieces({c.column for c in ours.values() if c.constant is None}, dates):
            values = {name: _values(piece, c, c.column in dates) for name, c in ours.items()}
            _check_time(path, values["time_s"], before, rows.word, piece, ours["time_s"].column in dates)
            if "soc" in values:
                values["soc"] = charge.share(values["soc"], piece)
            lines.frombytes(piece.lines.tobytes())
            for name, part in values.items():
                kept[name].frombytes(part.tobytes())
            if len(lines) * (len(ours) + 1) > most:
                raise DataError(
                    f"{path}: {rows.word} {piece.lines[-1]}: over {most:,} numbers, more than {meant}; "
                    "cut it into several"
                )
            before = values["time_s"][-1:]
            read += piece.read
            advance(piece.read)
            if tell is not None:
                tell(read / size)
    if not lines:
        raise DataError(f"{path}: no rows")
    return (
        np.frombuffer(lines, np.int64),
        {name: np.frombuffer(column) for name, column in kept.items()},
        charge.notes(),
    )


def _values(piece: Piece, c: Column, is_date: bool) -> Floats:
    if c.constant is not None:
        return np.full(len(piece.lines), c.constant)
    return converted(piece.values[c.column], c, is_date)


def converted(values: Floats, c: Column, is_date: bool) -> Floats:
    """Convert a column to our unit; its sign was changed during reading."""
    if is_date or (c.factor, c.shift) == (1.0, 0.0):
        return values
    return c.factor * values + (-c.shift if c.column != c.bare else c.shift)


def known(name: str) -> bool:
    """Whether a name is one of ours."""
    return name in _WHOLE or _CELL_COLUMN.fullmatch(name) is not None


def _cells(names: Iterable[str], column: str) -> list[int]:
    matches = (re.fullmatch(column.format("([1-9][0-9]*)"), name) for name in names)
    return sorted(int(m[1]) for m in matches if m)


def _check_time(path: Path, time: Floats, before: Floats, word: str, piece: Piece, dated: bool) -> None:
    """Refuse times that are missing or do not increase, beginning with the last one of the previous piece."""
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError(f"{path}: {word} {piece.lines[bad[0]]}: time_s is missing")
    t = np.concatenate([before, time])
    back = np.flatnonzero(np.diff(t) <= 0)
    if len(back):
        k = int(back[0]) + 1
        what = "stands still" if t[k] == t[k - 1] else "goes back"
        place = f"{word} {piece.lines[k - len(before)]}"
        raise DataError(
            f"{path}: {place}: time_s {what} ({t[k - 1]:.10g} then {t[k]:.10g}); it must increase"
            f"{_SUMMER if dated and _by_an_hour(t, k) else ''}"
        )


def _by_an_hour(t: Floats, k: int) -> bool:
    """Whether the times t (N,), s, go back by an hour at row k, minus the time between the two rows."""
    steps = np.diff(t)
    usual = steps[steps > 0]
    passed_s = 3600.0 + float(steps[k - 1])
    return 0.0 <= passed_s <= 3.0 * (float(np.median(usual)) if len(usual) else 0.0)


class _Charge:
    """The state of charge: the first rows decide on per cent, a little above full is full, other values are refused."""

    def __init__(self, path: Path, word: str, converted: bool) -> None:
        self._path, self._word, self._converted = path, word, converted
        self._percent: bool | None = None
        self._clipped = 0

    def share(self, soc: Floats, piece: Piece) -> Floats:
        """Return shares of 1.

        Raises
        ------
        DataError
            A value that is no state of charge.
        """
        given = soc[np.isfinite(soc)]
        if self._percent is None and len(given):
            with np.errstate(over="ignore"):  # the mean of two values may be too large for a float
                self._percent = len(given) >= _MOSTLY and float(np.median(given)) > 1.5
        share = 0.01 * soc if self._percent else soc
        wild = np.flatnonzero((share < -0.1) | (share > 1.1))
        if len(wild):
            at, what = int(wild[0]), "0 to 100 %" if self._percent or self._converted else "a share, 0 to 1"
            is_now = f"{soc[at] / PER_CENT:.4g} %" if self._converted else f"{soc[at]:g}"
            raise DataError(f"{self._path}: {self._word} {piece.lines[at]}: soc is {is_now}; it must be {what}")
        self._clipped += int(((share < 0.0) | (share > 1.0)).sum())
        return np.clip(share, 0.0, 1.0)

    def notes(self) -> list[str]:
        """Say what was done."""
        said = ["SOC is in per cent"] if self._percent else []
        if self._clipped:
            said.append(
                f"SOC: {counted(self._clipped, 'value')} a little below 0 or above 100 % taken as empty or full"
            )
        return said
