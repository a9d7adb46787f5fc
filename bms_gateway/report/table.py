"""Tables of measurements (CSV or Parquet) as arrays: the columns by name, blanks as NaN, faults with their line."""

import csv
import gzip
import re
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import DataError, MissingExtraError, UsageError, did_you_mean

Floats = NDArray[np.float64]

REQUIRED = ("time_s", "current_A", "coolant_inlet_C")
OPTIONAL = ("voltage_V", "soc", "coolant_flow_m3_s")
PER_CELL = {"surface": "C", "cell_voltage": "V", "core": "C"}
_CELL_COLUMN = re.compile(r"(surface|cell_voltage|core)_([1-9][0-9]*)_(C|V)")
_EXAMPLES = (*REQUIRED, *OPTIONAL, "surface_1_C", "cell_voltage_1_V", "core_1_C")


@dataclass(frozen=True, slots=True)
class Table:
    """N rows of one string's measurements.

    Attributes
    ----------
    source : str
        What error lines call it.
    time_s : ndarray (N,)
        Strictly increasing, s; sampling may be irregular.
    current_A : ndarray (N,)
        Discharge positive; NaN where missing, as everywhere but in `time_s`.
    coolant_inlet_C : ndarray (N,)
    voltage_V, soc, coolant_flow_m3_s : ndarray (N,) or None
        None where the table has no such column. `soc` is 0…1.
    surface_C, cell_voltage_V, core_C : mapping of cell (from 1) to ndarray (N,)
    ignored : tuple of str
        Columns that mean nothing here; worth a word to the user, who may have misspelt one.
    word, lines : str, sequence of int (N,)
        What the file's rows are called, and the number of each.
    """

    source: str
    time_s: Floats
    current_A: Floats
    coolant_inlet_C: Floats
    voltage_V: Floats | None
    soc: Floats | None
    coolant_flow_m3_s: Floats | None
    surface_C: Mapping[int, Floats]
    cell_voltage_V: Mapping[int, Floats]
    core_C: Mapping[int, Floats]
    ignored: tuple[str, ...]
    word: str
    lines: Sequence[int]

    def place(self, row: int) -> str:
        """Tell where a row (from 0) stands in the file."""
        return f"{self.word} {self.lines[row]}"

    def __len__(self) -> int:
        return len(self.time_s)


def parse_columns(pairs: Iterable[str]) -> dict[str, str]:
    """Read `--columns name=column` options.

    Parameters
    ----------
    pairs : iterable of str
        `name=column`; several may stand in one, parted by commas. `name=-column` flips the sign.

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
    """
    found: dict[str, str] = {}
    for pair in pairs:
        parts = pair.split(",")
        for part in parts if all("=" in p for p in parts) else [pair]:
            name, equals, column = part.partition("=")
            name, column = name.strip(), column.strip()
            if not (equals and name and column):
                raise UsageError(f"--columns {part!r}: expected name=column, such as current_A=I_A")
            if not _known(name):
                raise UsageError(f"--columns {part!r}: no table has a column {name!r}{did_you_mean(name, _EXAMPLES)}")
            if name in found:
                raise UsageError(f"--columns {part!r}: {name} is {found[name]!r} already; name it once")
            found[name] = column
    return found


def read_table(path: Path, columns: Mapping[str, str] | None = None) -> Table:
    """Read a table of measurements.

    Parameters
    ----------
    path : Path
        `.parquet`, or CSV (parted by comma, semicolon or tab; also `.gz`).
    columns : mapping, optional
        From `parse_columns`: the file's own names.

    Returns
    -------
    Table

    Raises
    ------
    DataError
        Missing file or column, broken number, time that does not increase; with the line.
    MissingExtraError
        Parquet without pyarrow.
    """
    columns = columns or {}
    if path.is_dir():
        raise DataError(f"{path}: is a directory; expected a table, CSV or Parquet")
    parquet = path.suffix.lower() in (".parquet", ".pq")
    try:
        text = _Parquet(path) if parquet else _Csv(path)
    except FileNotFoundError:
        beside = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        raise DataError(f"{path}: no such file{did_you_mean(path.name, beside)}") from None
    except gzip.BadGzipFile:
        raise DataError(f"{path}: not gzip data: leave .gz out of its name") from None
    except (EOFError, zlib.error):
        raise DataError(f"{path}: the gzip data are cut short or damaged") from None
    except OSError as e:
        raise DataError(f"{path}: cannot be read: {e}") from None
    names = text.names
    ours = {name: _find(path, name, column, names) for name, column in columns.items()}
    taken = {column.removeprefix("-") for column in ours.values()} | set(ours.values())
    ours |= {name: name for name in names if _known(name) and name not in ours and name not in taken}
    for name in REQUIRED:
        if name not in ours:
            hint = did_you_mean(name, names)
            raise DataError(f"{path}: no column {name!r}{hint} (map it: --columns {name}=COLUMN)")
    values = {name: text.numbers(column) for name, column in ours.items()}
    time = values["time_s"]
    if not len(time):
        raise DataError(f"{path}: no rows")
    _check_time(path, time, text)
    _check_soc(path, values.get("soc"), text)
    cells = {what: {k: values[f"{what}_{k}_{unit}"] for k in _cells(values, what)} for what, unit in PER_CELL.items()}
    return Table(
        str(path),
        time,
        values["current_A"],
        values["coolant_inlet_C"],
        values.get("voltage_V"),
        values.get("soc"),
        values.get("coolant_flow_m3_s"),
        cells["surface"],
        cells["cell_voltage"],
        cells["core"],
        ignored=tuple(n for n in names if n not in ours.values() and f"-{n}" not in ours.values()),
        word=text.word,
        lines=text.lines,
    )


def _known(name: str) -> bool:
    match = _CELL_COLUMN.fullmatch(name)
    return name in REQUIRED or name in OPTIONAL or (match is not None and PER_CELL[match[1]] == match[3])


def _cells(names: Iterable[str], what: str) -> list[int]:
    matches = (_CELL_COLUMN.fullmatch(name) for name in names)
    return sorted(int(m[2]) for m in matches if m and m[1] == what)


def _find(path: Path, name: str, column: str, names: Sequence[str]) -> str:
    if column in names or (column.startswith("-") and column[1:] in names):
        return column
    raise DataError(f"{path}: no column {column!r} for {name}{did_you_mean(column, names)}")


def _check_time(path: Path, time: Floats, text: "_Csv | _Parquet") -> None:
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise DataError(f"{path}: {text.place(int(bad[0]))}: time_s is missing")
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        k = int(back[0]) + 1
        what = "stands still" if time[k] == time[k - 1] else "goes back"
        raise DataError(
            f"{path}: {text.place(k)}: time_s {what} ({time[k - 1]:.10g} then {time[k]:.10g}); it must increase"
        )


def _check_soc(path: Path, soc: Floats | None, text: "_Csv | _Parquet") -> None:
    """Refuse per cent: they would be taken for a charge a hundred times the cell's."""
    if soc is None:
        return
    wild = np.flatnonzero((soc < -0.1) | (soc > 1.1))
    if len(wild):
        raise DataError(f"{path}: {text.place(int(wild[0]))}: soc is {soc[wild[0]]:g}; it must be a share, 0 to 1")


class _Csv:
    """Cells of a CSV file as text; numbers are made for the columns that are asked for."""

    word = "line"

    def __init__(self, path: Path) -> None:
        self.path = path
        raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        try:
            lines = raw.decode("utf-8-sig").splitlines()
        except UnicodeDecodeError as e:
            raise DataError(f"{path}: not a text table (byte {e.start})") from None
        kept = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
        if not kept:
            raise DataError(f"{path}: empty")
        head = kept[0][1]
        mark = next((m for m in ",;\t" if m in head), ",")
        quoted = '"' in head or any('"' in line for _, line in kept[1:])
        split = (lambda line: next(csv.reader([line], delimiter=mark))) if quoted else (lambda line: line.split(mark))
        self.names = [name.strip() for name in split(head)]
        twice = [name for name in self.names if name and self.names.count(name) > 1]
        if twice:
            raise DataError(f"{path}: line {kept[0][0]}: column {twice[0]!r} stands there twice")
        width = len(self.names)
        self.lines: Sequence[int] = [i for i, _ in kept[1:]]
        self.cells: list[str] = []
        for i, line in kept[1:]:
            row = split(line)
            if len(row) != width:
                raise DataError(f"{path}: line {i}: {len(row)} columns, the header has {width}")
            self.cells += row

    def place(self, row: int) -> str:
        return f"{self.word} {self.lines[row]}"

    def numbers(self, column: str) -> Floats:
        sign = 1.0 if column in self.names else -1.0
        at = self.names.index(column if sign > 0 else column[1:])
        cells = self.cells[at :: len(self.names)]
        if "" in cells:
            cells = [c or "nan" for c in cells]
        try:
            out = np.array(cells, dtype=np.float64)
        except ValueError:
            out = np.array([self._number(c, row, column) for row, c in enumerate(cells)])
        wild = np.flatnonzero(np.isinf(out))
        if len(wild):
            raise self._broken(cells[wild[0]], int(wild[0]), column)
        return sign * out if sign < 0 else out

    def _number(self, cell: str, row: int, column: str) -> float:
        """Slow path: white space only is a blank too; anything else is told with its line."""
        try:
            return float(cell) if cell.strip() else np.nan
        except ValueError:
            raise self._broken(cell, row, column) from None

    def _broken(self, cell: str, row: int, column: str) -> DataError:
        return DataError(f"{self.path}: {self.place(row)}: column {column!r}: {cell.strip()[:40]!r} is not a number")


class _Parquet:
    """Columns of a Parquet file."""

    word = "row"

    def __init__(self, path: Path) -> None:
        try:
            import pyarrow  # type: ignore[import-not-found,import-untyped,unused-ignore]
            import pyarrow.parquet  # type: ignore[import-not-found,import-untyped,unused-ignore]
        except ImportError:
            raise MissingExtraError("reading Parquet", "report") from None
        self.path = path
        try:
            self._table = pyarrow.parquet.read_table(path)
        except pyarrow.ArrowInvalid as e:
            raise DataError(f"{path}: not a Parquet file: {' '.join(str(e).split())}") from None
        self.names: list[str] = list(self._table.column_names)
        self.lines: Sequence[int] = range(1, self._table.num_rows + 1)

    def place(self, row: int) -> str:
        return f"{self.word} {self.lines[row]}"

    def numbers(self, column: str) -> Floats:
        sign = 1.0 if column in self.names else -1.0
        cells = self._table.column(column if sign > 0 else column[1:]).to_pylist()
        try:
            out = np.array([np.nan if c is None else c for c in cells], dtype=np.float64)
        except (TypeError, ValueError):
            raise DataError(f"{self.path}: column {column!r}: not numbers") from None
        return sign * out
