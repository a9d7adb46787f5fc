"""Rows of CSV and Parquet files in pieces, so that a file of any size takes the memory of one piece."""

import csv
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import DataError, MissingExtraError
from bms_gateway.gunzip import Gunzip
from bms_gateway.report.dates import DateForm
from bms_gateway.report.table_cells import MISSING, Decimals, is_number, mark_of, title_lines, units_row, whole
from bms_gateway.report.text import CALLED, HEAD, Recoded, decoded, refuse_others, utf16
from bms_gateway.thermal import Floats

CHUNK: Final = 1 << 18  # bytes of text per block; its cells need some megabytes
LONGEST_LINE: Final = 1 << 17  # bytes; the names of all columns of a thousand cells have half of it
MOST_COLUMNS: Final = 10_000  # three for each of a thousand cells, and as many again with other names
LONGEST_NAME: Final = 500  # characters of a column's name: a path through the messages of a bus has half of it
MOST_IDLE: Final = 1_000_000  # consecutive lines that are blank or remarks
BATCH: Final = 1 << 14  # rows of Parquet
PER_SECOND: Final = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}  # units of stamps in Parquet
_EPOCH: Final = datetime(1970, 1, 1)
MOST_TITLE: Final = 40  # first lines, among which the names of the columns are
MOST_SAMPLED: Final = 2000  # rows from which the form of times is found


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive rows of a file.

    Attributes
    ----------
    lines : ndarray of int (N,)
        Number of each row in the file.
    values : dict of str to ndarray (N,)
        Values by the name of the column as it was requested; NaN for blanks.
    read : float
        Bytes of the file for these rows.
    """

    lines: NDArray[np.int64]
    values: dict[str, Floats]
    read: float


class Rows(Protocol):
    """An open file.

    Attributes
    ----------
    names : list of str
        Names of its columns.
    word : str
        Word for a row: "line" or "row".
    units : list of str or None
        From a row of units below the names.
    notes : sequence of str
        What was recognised so far, a sentence each; complete after the last piece.
    began_s : float or None
        First time, s since 1970, of a file with date-times; known after the first piece.
    """

    names: list[str]
    word: str
    units: list[str] | None

    @property
    def notes(self) -> Sequence[str]:
        """See above."""
        ...

    @property
    def began_s(self) -> float | None:
        """See above."""
        ...

    def sample(self, column: str) -> list[str]:
        """Return the first cells of a column as written; none if they are numbers already."""
        ...

    def pieces(self, columns: Collection[str], dates: Mapping[str, DateForm]) -> Iterator[Piece]:
        """Yield the rows of these columns; `-name` changes the sign, `dates` has the forms of columns of times.

        Raises
        ------
        DataError
            A cell is not a number, or a line is not a row.
        EOFError
            The gzip data are damaged.
        """
        ...


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines of text, and their numbers in the file."""

    number: NDArray[np.int64]
    text: list[str]

    def only(self, count: int, first: int = 0) -> "_Lines":
        """Return a few of them."""
        return _Lines(self.number[first : first + count], self.text[first : first + count])

    def after(self, count: int) -> "_Lines":
        """Return the rest."""
        return _Lines(self.number[count:], self.text[count:])


class _Csv:
    """Lines of a CSV file; blank lines and comments are skipped."""

    word = "line"
    began_s = None

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path = path
        self._file = file
        self._source, self._codec = self._open(file)
        self._said: list[str] = [] if self._codec == "utf-8" else ["read as UTF-16"]
        self._codec = "utf-8"
        self._decimals = Decimals()
        self._blocks = self._lines()
        first = next(self._blocks, None)
        if first is not None and first.text[0].lower().startswith("sep=") and len(first.text[0]) <= 5:
            # a line of Excel that names the separator
            first = first.after(1) if len(first.text) > 1 else next(self._blocks, None)
        if first is None:
            raise DataError(f"{path}: empty")
        self._mark = mark_of(first.text[:MOST_TITLE])
        first = self._below_title(first)
        number, head = int(first.number[0]), first.text[0]
        self.names = [name.strip() for name in self._cells(first.only(1), None)]
        _refuse_long_head(f"{path}: line {number}", self.names)
        twice = next((name for name, count in Counter(self.names).items() if name and count > 1), None)
        if twice is not None:
            raise DataError(f"{path}: line {number}: column {twice!r} stands there twice")
        if len(self.names) > 1 and all(is_number(name) for name in self.names):
            raise DataError(
                f"{path}: line {number}: {head[:40]!r} are numbers where a header of names should be, such as "
                "time_s,current_A,coolant_inlet_C,surface_1_C"
            )
        self._first = first.after(1)
        if not self._first.text:
            self._first = next(self._blocks, self._first)
        if self._first.text:
            self.names = whole(self.names, self._cells(self._first.only(1), None))
        self.units = self._units()

    def _open(self, file: BinaryIO) -> tuple[Any, str]:
        """Unpack, and convert UTF-16; return the codec too."""
        packed = self.path.suffix == ".gz"
        with self.path.open("rb") as other:
            head = _head(Gunzip(other, str(self.path)) if packed else other)
        refuse_others(self.path, head)
        source = Gunzip(file, str(self.path)) if packed else file
        codec = utf16(head)
        return (source, "utf-8") if codec is None else (Recoded(source, codec, self.path), codec)

    def _below_title(self, first: "_Lines") -> "_Lines":
        """Leave out lines above the names of the columns."""
        above = title_lines([self._cells(first.only(1, k), None) for k in range(min(len(first.text), MOST_TITLE))])
        if above:
            lines = (
                f"line {first.number[0]} is"
                if above == 1
                else f"lines {first.number[0]} to {first.number[above - 1]} are"
            )
            self._said.append(f"{lines} read as a title, line {first.number[above]} as the names of the columns")
        return first.after(above)

    def _units(self) -> list[str] | None:
        """Read a row of units below the header."""
        if not self._first.text:
            return None
        cells = self._cells(self._first.only(1), None)
        if len(cells) != len(self.names) or not units_row(cells):
            return None
        self._said.append(f"line {self._first.number[0]} is read as the units of the columns")
        self._first = self._first.after(1)
        return cells

    @property
    def notes(self) -> list[str]:
        """See `Rows`."""
        return [*self._said, *self._decimals.notes()]

    def sample(self, column: str) -> list[str]:
        """See `Rows`."""
        at, width = self.names.index(column), len(self.names)
        rows = [self._cells(self._first.only(1, k), None) for k in range(min(len(self._first.text), MOST_SAMPLED))]
        return [row[at] for row in rows if len(row) == width]

    def pieces(self, columns: Collection[str], dates: Mapping[str, DateForm]) -> Iterator[Piece]:
        """See `Rows`."""
        places = {c: self.names.index(c if c in self.names else c[1:]) for c in columns}
        width, at = len(self.names), 0
        lines: _Lines | None = self._first
        while lines is not None:
            if lines.text:
                cells = self._cells(lines, width)
                values = {c: self._values(c, cells[k::width], lines.number, dates) for c, k in places.items()}
                before, at = at, self._file.tell()
                yield Piece(lines.number, values, at - before)
            lines = next(self._blocks, None)

    def _lines(self) -> Iterator["_Lines"]:
        """Yield groups of lines that are neither blank nor comments; no group is empty."""
        carry, number, read, first = b"", 1, 0, 1
        while block := self._source.read(CHUNK):
            text = carry + block
            # a line feed that belongs to a carriage return may come with the next block
            cut = max(text.rfind(b"\n"), text.rfind(b"\r", 0, -1)) + 1
            carry = text[cut:]
            lines, count = self._text(text[:cut], number, read)
            number, read = number + count, read + cut
            if lines.text:
                first = number
                yield lines
            if len(carry) > LONGEST_LINE:
                raise self._endless(number)
            if number - first > MOST_IDLE:
                raise DataError(f"{self.path}: line {number}: a million lines without a row: not a table")
        lines, _ = self._text(carry, number, read)
        if lines.text:
            yield lines

    def _text(self, raw: bytes, number: int, read: int) -> tuple["_Lines", int]:
        text, codec = decoded(self.path, raw, read, self._codec)
        if codec != self._codec:
            self._codec = codec
            self._said.append(f"not UTF-8 from line {number} on: read as {CALLED[codec]}")
        lines = text.splitlines()
        if "#" not in text and all(map(str.strip, lines)):
            return _Lines(np.arange(number, number + len(lines)), lines), len(lines)
        kept = [i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")]
        return _Lines(number + np.array(kept, np.int64), [lines[i] for i in kept]), len(lines)

    def _cells(self, lines: "_Lines", width: int | None) -> list[str]:
        """Return the cells of lines one after the other, `width` per line if it is known."""
        if max(map(len, lines.text)) > LONGEST_LINE:
            raise self._endless(next(n for n, x in zip(lines.number, lines.text, strict=True) if len(x) > LONGEST_LINE))
        mark, text = self._mark, self._mark.join(lines.text)
        if '"' not in text:
            wide = [line.count(mark) + 1 for line in lines.text] if width else []
            cells = text.split(mark)
        else:
            rows = [self._quoted(i, line) for i, line in zip(lines.number.tolist(), lines.text, strict=True)]
            wide = [len(row) for row in rows] if width else []
            cells = [cell for row in rows for cell in row]
        if wide.count(width or 0) != len(wide):
            k = next(k for k, n in enumerate(wide) if n != width)
            why = ""
            if mark == "," and wide[k] > (width or 0) and wide.count(wide[k]) == len(wide):
                why = (
                    ": decimal commas between commas? Write the numbers with points, or part the columns by semicolons"
                )
            raise DataError(f"{self.path}: line {lines.number[k]}: {wide[k]} columns, the header has {width}{why}")
        return cells

    def _endless(self, number: int) -> DataError:
        return DataError(f"{self.path}: line {number}: no end of line in {LONGEST_LINE >> 10} KiB: not a table")

    def _quoted(self, number: int, line: str) -> list[str]:
        try:
            return next(csv.reader([line], delimiter=self._mark))
        except csv.Error as e:
            raise DataError(f"{self.path}: line {number}: {e}") from None

    def _values(self, column: str, cells: list[str], lines: NDArray[np.int64], dates: Mapping[str, DateForm]) -> Floats:
        if column not in dates:
            return self._numbers(column, cells, lines)
        try:
            return dates[column].seconds(cells)
        except ValueError as e:
            at = int(e.args[0])
            raise DataError(
                f"{self.path}: line {lines[at]}: column {column!r}: {cells[at].strip()[:40]!r} is no time; the "
                f"column has {dates[column].name}"
            ) from None

    def _numbers(self, column: str, cells: list[str], lines: NDArray[np.int64]) -> Floats:
        sign = 1.0 if column in self.names else -1.0
        if "" in cells:
            cells = [c or "nan" for c in cells]
        out: Floats | None
        try:
            out = np.array(cells, dtype=np.float64)
            if not self._decimals.points and any("." in c for c in cells):
                self._decimals.points = True
        except ValueError:
            out = None
        if out is None or (self._decimals.points and self._decimals.commas):  # one by one, to find the place
            out = np.array([self._number(c, i, column) for c, i in zip(cells, lines.tolist(), strict=True)])
        wild = np.flatnonzero(np.isinf(out))
        if len(wild):
            raise self._broken(cells[wild[0]], int(lines[wild[0]]), column)
        return sign * out if sign < 0 else out

    def _number(self, cell: str, line: int, column: str) -> float:
        """Slow path: words for blanks, decimal commas; any other text is an error with its line."""
        text = cell.strip()
        if text.lower() in MISSING:
            return np.nan
        try:
            return self._decimals.number(text)
        except ValueError as e:
            if e.args[0] == Decimals.BOTH:
                raise DataError(
                    f"{self.path}: line {line}: column {column!r}: {text[:40]!r}: {Decimals.BOTH}"
                ) from None
            raise self._broken(cell, line, column) from None

    def _broken(self, cell: str, line: int, column: str) -> DataError:
        return DataError(f"{self.path}: line {line}: column {column!r}: {cell.strip()[:40]!r} is not a number")


def _refuse_long_head(where: str, names: Sequence[str]) -> None:
    """Refuse more columns, or longer names, than any table has."""
    if len(names) > MOST_COLUMNS:
        raise DataError(f"{where}: {len(names):,} columns, more than {MOST_COLUMNS:,}")
    for at, name in enumerate(names, 1):
        if len(name) > LONGEST_NAME:
            raise DataError(
                f"{where}: the name of column {at}, {name[:40]!r} …, has {len(name):,} characters; at most "
                f"{LONGEST_NAME} are read: shorten it"
            )


def _head(source: Any) -> bytes:
    """Read the first bytes, which show the kind of a file; gzip data may come in small pieces."""
    head = b""
    while len(head) < HEAD and (more := source.read(HEAD - len(head))):
        head += more
    return head


class _Parquet:
    """Columns of a Parquet file."""

    word = "row"

    def __init__(self, path: Path, file: Any, numeric: set[str], stamps: Mapping[str, int]) -> None:
        self.path = path
        self._file, self._numeric, self._stamps = file, numeric, stamps
        self.names: list[str] = list(file.schema_arrow.names)
        _refuse_long_head(str(path), self.names)
        self.units: list[str] | None = None
        self.notes: list[str] = []
        self._epoch: dict[str, int] = {}

    @property
    def began_s(self) -> float | None:
        """See `Rows`."""
        return next((first / self._stamps[name] for name, first in self._epoch.items()), None)

    def sample(self, column: str) -> list[str]:  # noqa: ARG002 — stamps are stamps here
        """See `Rows`."""
        return []

    def pieces(self, columns: Collection[str], dates: Mapping[str, DateForm]) -> Iterator[Piece]:  # noqa: ARG002
        """See `Rows`."""
        named = {c: c if c in self.names else c[1:] for c in columns}
        for c, name in named.items():
            if self.names.count(name) > 1:
                raise DataError(f"{self.path}: column {name!r} stands there twice")
            if name not in self._numeric:
                raise self._no_numbers(c)
        row, N = 1, self._file.metadata.num_rows
        share = self.path.stat().st_size / max(N, 1)
        for batch in self._file.iter_batches(BATCH, columns=sorted(set(named.values())), use_threads=False):
            values = {c: self._values(c, name, batch.column(name)) for c, name in named.items()}
            lines = np.arange(row, row + batch.num_rows)
            row += batch.num_rows
            if batch.num_rows:
                yield Piece(lines, values, share * batch.num_rows)

    def _values(self, column: str, name: str, cells: Any) -> Floats:
        if name in self._stamps:  # as whole numbers: dates of Python have no nanoseconds, and end with the year 9999
            return self._numbers(column, self._seconds(name, cells.cast("int64").to_pylist()))
        return self._numbers(column, cells.to_pylist())

    def _numbers(self, column: str, cells: list[Any]) -> Floats:
        try:
            out = np.array([np.nan if c is None else c for c in cells], dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise self._no_numbers(column) from None
        return out if column in self.names else -out

    def _seconds(self, name: str, cells: list[int | None]) -> list[float | None]:
        """Count stamps from the first one."""
        per_second = self._stamps[name]
        if name not in self._epoch:
            first = next((c for c in cells if c is not None), None)
            if first is None:
                return [None] * len(cells)
            self._epoch[name] = first
            began: object = f"{first / per_second:g} s after 1970"
            with suppress(OverflowError):  # beyond the calendar
                began = _EPOCH + timedelta(microseconds=first * 1_000_000 // per_second)
            self.notes.append(f"{name!r} has dates: time_s is counted from its first row, {began}")
        first = self._epoch[name]
        return [None if c is None else (c - first) / per_second for c in cells]

    def _no_numbers(self, column: str) -> DataError:
        return DataError(f"{self.path}: column {column!r}: not numbers")


@contextmanager
def open_csv(path: Path) -> Iterator[Rows]:
    """Open a CSV file, or one compressed by gzip.

    Raises
    ------
    DataError
        Empty, or not text.
    EOFError
        The gzip data are damaged.
    OSError
    """
    with path.open("rb") as file:
        if path.suffix == ".gz":
            if file.read(2) not in (b"", b"\x1f\x8b"):
                raise DataError(f"{path}: not gzip data: leave .gz out of its name")
            file.seek(0)
        yield _Csv(path, file)


@contextmanager
def open_parquet(path: Path) -> Iterator[Rows]:
    """Open a Parquet file.

    Raises
    ------
    DataError
        The file is not a Parquet file.
    MissingExtraError
        pyarrow is not installed.
    OSError
    """
    try:
        import pyarrow  # type: ignore[import-not-found,import-untyped,unused-ignore]
        import pyarrow.parquet  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        raise MissingExtraError("reading Parquet", "report") from None
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            kinds = pyarrow.types
            tests = (kinds.is_integer, kinds.is_floating, kinds.is_decimal, kinds.is_boolean, kinds.is_null,
                     kinds.is_timestamp)  # fmt: skip
            numeric = {f.name for f in file.schema_arrow if any(test(f.type) for test in tests)}
            stamps = {f.name: PER_SECOND[f.type.unit] for f in file.schema_arrow if kinds.is_timestamp(f.type)}
            yield _Parquet(path, file, numeric, stamps)
    except pyarrow.ArrowException as e:
        raise DataError(f"{path}: not a Parquet file: {' '.join(str(e).split())}") from None
