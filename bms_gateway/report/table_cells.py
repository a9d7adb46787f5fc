"""Cells of a CSV file: separators, decimal commas, words for blanks, a row of units."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from bms_gateway.report.columns import UNITS, bare_unit

__all__ = ["MISSING", "Decimals", "is_number", "mark_of", "title_lines", "units_row", "whole"]

MISSING: Final = frozenset(
    ("", "na", "n/a", "#n/a", "#na", "nan", "null", "none", "nil", "-", "--", "---", "nv", "#nv")
)
"""Words for a value that is not there, in small letters; `#NV` is the German Excel's `#N/A`."""
MARKS: Final = ";\t,|"
LEAST_COLUMNS: Final = 3
"""Of a table that may have a title."""
MINUS: Final = "\N{MINUS SIGN}"
"""Characters used for "-" in printed tables."""
_POINT: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
_COMMA: Final = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_GROUPED: Final = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_SPACED: Final = re.compile(r"[+-]?\d{1,3}([ \u00a0\u202f]\d{3})+([.,]\d*)?")
"""Thousands separated by blanks, as in French and SI texts."""
_WHOLE: Final = re.compile(r"[+-]?\d+([eE][+-]?\d+)?")


@dataclass(slots=True)
class Decimals:
    """The decimal mark of the numbers of one file; never two in one file."""

    BOTH = "decimal commas and decimal points in one file: it cannot be told which part thousands"
    commas: bool = False
    points: bool = False
    grouped: bool = False

    def number(self, text: str) -> float:
        """Convert one cell.

        Raises
        ------
        ValueError
            Not a number, or the other mark than before.

        Examples
        --------
        >>> d = Decimals()
        >>> d.number("12,5"), d.number("1.234,5")
        (12.5, 1234.5)
        >>> d.number("12.5")
        Traceback (most recent call last):
        ...
        ValueError: decimal commas and decimal points in one file: it cannot be told which part thousands
        """
        text = _plain(text)
        if _COMMA.fullmatch(text) or _GROUPED.fullmatch(text):
            self.commas = True
            if "." in text:
                self.grouped = True
                text = text.replace(".", "")
            text = text.replace(",", ".")
        elif _POINT.fullmatch(text) and not _WHOLE.fullmatch(text):
            self.points = True
        if self.commas and self.points:
            raise ValueError(self.BOTH)
        return float(text)

    def notes(self) -> list[str]:
        """Say what was recognised."""
        if not self.commas:
            return []
        return ["decimal commas" + (", points part thousands" if self.grouped else "")]


def _plain(text: str) -> str:
    """Write a number with a keyboard's minus and without blanks between thousands."""
    text = text.replace(MINUS, "-")
    return "".join(text.split()) if _SPACED.fullmatch(text) else text


def mark_of(lines: Sequence[str]) -> str:
    """Return the separator of the columns: the mark that divides the first lines into equally many, and most, parts.

    Examples
    --------
    >>> mark_of(["Spannung, V;Strom, A;Zeit", "3,7;1,5;0"]), mark_of(["a,b", "1,2"])
    (';', ',')
    """

    def judged(mark: str) -> tuple[bool, float, int]:
        rows = [next(csv.reader([line[:20_000]], delimiter=mark), []) for line in lines]
        below = rows[title_lines(rows) :]
        counts = [len(row) for row in [whole(below[0], below[-1]), *below[1:]]]
        like_head = sum(n == counts[0] for n in counts) / len(counts)
        return counts[0] > 1, like_head, counts[0]

    try:
        return max(MARKS, key=judged)
    except csv.Error:  # reported with its line when it is read
        return next((mark for mark in ",;\t|" if mark in lines[0]), ",")


def title_lines(rows: Sequence[Sequence[str]]) -> int:
    """Count the lines above the names of the columns: they fill less than half of the columns.

    Parameters
    ----------
    rows : sequence of sequence of str
        Cells of the first lines of a file, of which the last is a row of the table.

    Examples
    --------
    >>> title_lines([["Bench 7"], ["2026-11-13"], ["t", "I", "T"], ["0", "1", "20"], ["1", "1", "20"]])
    2
    """
    usual = len(rows[-1])
    head = next((k for k, row in enumerate(rows) if 2 * sum(bool(c.strip()) for c in row) >= usual), 0)
    named = len(whole(rows[head], rows[-1])) == usual and not any(map(is_number, rows[head]))
    return head if named and usual >= LEAST_COLUMNS else 0


def whole(names: Sequence[str], row: Sequence[str]) -> list[str]:
    """Return the names of a header beside a row of which only one ends with a separator.

    Examples
    --------
    >>> whole(["t", "I", ""], ["0", "1"]), whole(["t", "I"], ["0", "1", ""]), whole(["t", "I"], ["0"])
    (['t', 'I'], ['t', 'I', ''], ['t', 'I'])
    """
    if len(names) == len(row) + 1 and not names[-1].strip():
        return list(names[:-1])
    return [*names, ""] if len(row) == len(names) + 1 and not row[-1].strip() else list(names)


def is_number(cell: str) -> bool:
    """Whether a cell is written as a number, with either decimal mark."""
    text = _plain(cell.strip())
    return any(pattern.fullmatch(text) for pattern in (_POINT, _COMMA, _GROUPED))


def units_row(cells: Sequence[str]) -> bool:
    """Whether a row below the header has the units of the columns: nothing in it is a value, something is a unit."""
    given = [c.strip() for c in cells if c.strip()]
    if not given or any(is_number(c) or any(d in "0123456789" for d in c[:2]) for c in given):
        return False
    units = [bare_unit(c) for c in given]
    known = sum(any(u in quantity for quantity in UNITS.values()) for u in units)
    return known >= 1 and 2 * known >= len(given) and not all(u.lower() in MISSING for u in units)
