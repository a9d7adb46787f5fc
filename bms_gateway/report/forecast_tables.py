"""Tables for forecasts: the coming current, and the true cores of a log."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BufferedReader, TextIOWrapper
from math import isfinite, isinf
from pathlib import Path
from typing import Final

import numpy as np

from bms_gateway.errors import DataError, did_you_mean
from bms_gateway.gunzip import Gunzip
from bms_gateway.report.file_rows import LONGEST_LINE
from bms_gateway.report.table import MOST_NUMBERS, open_table, read_table
from bms_gateway.thermal import Floats

LONG_FORM: Final = ("time_s", "string", "cell", "core_C")
INSTANT: Final = 16  # memory of an instant besides its cores, in numbers


def read_profile(path: Path) -> tuple[Floats, Floats, Floats]:
    """Read a profile: time_s, current_A and perhaps coolant_inlet_C (NaN if there is none), (N,) each.

    Raises
    ------
    DataError
        A column or a current is missing, or the table cannot be read.
    """
    table = read_table(path, needed=("time_s", "current_A"))
    missing = np.flatnonzero(np.isnan(table.current_A))
    if len(missing):
        raise DataError(f"{path}: {table.place(int(missing[0]))}: current_A is missing; a forecast needs every row")
    return table.time_s, table.current_A, table.coolant_inlet_C


def read_truth(path: Path, strings: Sequence[str], cells: Mapping[str, int]) -> dict[str, tuple[Floats, Floats]]:
    """Read true cores: times (K,), s, and cores (K, n), °C, by string.

    Parameters
    ----------
    path : Path
        From `simulate --truth`, or a table with `core_K_C` if there is one string.
    strings : sequence of str
    cells : mapping
        Number of cells of each string.

    Raises
    ------
    DataError
        The table has neither form, or contains none of the strings.
    """
    if path.suffix.lower() not in (".parquet", ".pq"):
        with open_table(path) as opened:  # reports what is wrong with a file that is no table
            names = opened.names
        if "core_C" in names and "string" in names:
            with _rows(path) as rows:
                return _long(path, next(rows, []), rows, strings, cells)
    table = read_table(path, needed=("time_s",))
    if not table.core_C:
        raise DataError(
            f"{path}: no column core_1_C, and none of {', '.join(LONG_FORM[1:])}: nothing is known of cores"
        )
    if len(strings) != 1:
        raise DataError(
            f"{path}: a table speaks of one string, the config has {len(strings)}: give time_s,string,cell,core_C"
        )
    n = cells[strings[0]]
    if (most := max(table.core_C)) > n:
        raise DataError(f"{path}: core_{most}_C: {strings[0]} has cells 1 to {n}")
    nothing = np.full(len(table.time_s), np.nan)
    core = np.column_stack([table.core_C.get(k, nothing) for k in range(1, n + 1)])
    return {strings[0]: (table.time_s, core)}


@contextmanager
def _rows(path: Path) -> Iterator[Iterator[list[str]]]:
    """Open a CSV file as rows of text; an error on the way is a `DataError`."""
    try:
        with path.open("rb") as file:
            source = BufferedReader(Gunzip(file, str(path))) if path.suffix.lower() == ".gz" else file
            with TextIOWrapper(source, encoding="utf-8-sig", newline="") as text:
                yield csv.reader(_lines(path, text))
    except EOFError:
        raise DataError(f"{path}: the gzip data are cut short or damaged") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: is no text") from None
    except csv.Error as e:
        raise DataError(f"{path}: no table: {e}") from None
    except OSError as e:
        raise DataError(f"{path}: cannot be read: {e.strerror or e}") from None


def _lines(path: Path, text: TextIOWrapper) -> Iterator[str]:
    number = 0
    while line := text.readline(LONGEST_LINE):
        number += 1
        if len(line) == LONGEST_LINE:
            raise DataError(f"{path}: line {number}: no end of line in {LONGEST_LINE >> 10} KiB: not a table")
        yield line


def _long(
    path: Path, names: list[str], rows: Iterator[list[str]], strings: Sequence[str], cells: Mapping[str, int]
) -> dict[str, tuple[Floats, Floats]]:
    at = [names.index(n) if n in names else -1 for n in LONG_FORM]
    if -1 in at:
        raise DataError(f"{path}: no column {LONG_FORM[at.index(-1)]!r}{did_you_mean(LONG_FORM[at.index(-1)], names)}")
    found: dict[str, dict[float, Floats]] = {name: {} for name in strings}
    taken = 0
    for line, row in enumerate(rows, 2):
        if line > MOST_NUMBERS:
            raise DataError(f"{path}: line {line}: over {MOST_NUMBERS:,} rows; cut it into several")
        try:
            t, name, k, core = float(row[at[0]]), row[at[1]], int(row[at[2]]), float(row[at[3]])
        except (ValueError, IndexError):
            t, name, k, core = np.nan, "", 0, np.nan
        if not isfinite(t) or isinf(core):
            raise DataError(f"{path}: line {line}: expected numbers for time_s, cell and core_C")
        if name not in found or not 1 <= k <= cells[name]:
            continue
        if t not in found[name]:
            taken += cells[name] + INSTANT
            if taken > MOST_NUMBERS:
                raise DataError(f"{path}: line {line}: more instants than memory is given to; cut it into several")
            found[name][t] = np.full(cells[name], np.nan)
        found[name][t][k - 1] = core
    if not any(found.values()):
        raise DataError(f"{path}: speaks of none of the strings {', '.join(strings)}")
    return {name: (np.array(sorted(of)), np.stack([of[t] for t in sorted(of)])) for name, of in found.items() if of}
