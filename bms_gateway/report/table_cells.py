"""Cells of a CSV file: what parts them, decimal commas, words for nothing, a row of units."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from bms_gateway.report.columns import UNITS, bare_unit

__all__ = ["MISSING", "Decimals", "is_number", "mark_of", "units_row"]

MISSING: Final = frozenset(("", "na", "n/a", "#n/a", "#na", "nan", "null", "none", "nil", "-", "--", "---", "nv"))
"""Words for a value that is not there, in small letters."""
MARKS: Final = ";\t,|"
_POINT: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
_COMMA: Final = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_GROUPED: Final = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_WHOLE: Final = re.compile(r"[+-]?\d+([eE][+-]?\d+)?")


@dataclass(slots=True)
class Decimals:
    """What the numbers of one file have for a decimal mark; never two in one file."""

    BOTH = "decimal commas and decimal points in one file: it cannot be told which part thousands"
    commas: bool = False
    points: bool = False
    grouped: bool = False

    def number(self, text: str) -> float:
        """Convert one cell.

        Raises
        ------
        ValueError
            No number, or the other mark than before.

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


def mark_of(lines: Sequence[str]) -> str:
    """Tell what parts the columns: the mark that cuts the first lines into equally many, and into most.

    Examples
    --------
    >>> mark_of(["Spannung, V;Strom, A;Zeit", "3,7;1,5;0"]), mark_of(["a,b", "1,2"])
    (';', ',')
    """

    def judged(mark: str) -> tuple[bool, int, int]:
        counts = [len(next(csv.reader([line[:20_000]], delimiter=mark), [])) for line in lines]
        like_head = sum(n == counts[0] for n in counts)
        return counts[0] > 1, like_head, counts[0]

    try:
        return max(MARKS, key=judged)
    except csv.Error:  # told with its line where it is read
        return next((mark for mark in ",;\t|" if mark in lines[0]), ",")


def is_number(cell: str) -> bool:
    """Whether a cell is written as a number, with either decimal mark."""
    text = cell.strip()
    return any(pattern.fullmatch(text) for pattern in (_POINT, _COMMA, _GROUPED))


def units_row(cells: Sequence[str]) -> bool:
    """Whether a row below the header has the units of the columns: nothing in it is a value, something is a unit."""
    given = [c.strip() for c in cells if c.strip()]
    if not given or any(is_number(c) or any(d.isdigit() for d in c[:2]) for c in given):
        return False
    units = [bare_unit(c) for c in given]
    known = sum(any(u in quantity for quantity in UNITS.values()) for u in units)
    return known >= 1 and 2 * known >= len(given) and not all(u.lower() in MISSING for u in units)
