"""One sentence for cells with the same finding: which cells, their range, and the trend along the coolant."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from bms_gateway.errors import counted

FEW = 4
"""Least number of cells for a trend from cell to cell."""
ALONG = 0.8
"""Least rank correlation of a number with the position along the coolant for which it grows or falls."""


def cells_in_words(cells: Sequence[int]) -> str:
    """Name cells in order.

    Examples
    --------
    >>> cells_in_words([3]), cells_in_words([1, 2, 3, 7])
    ('cell 3', 'cells 1 to 3, 7')
    """
    return f"cell {cells[0]}" if len(cells) == 1 else f"cells {runs(cells)}"


def unused_sentence(cells: Sequence[int]) -> str:
    """Say that a table has surfaces of cells at which the model has no sensor.

    Examples
    --------
    >>> unused_sentence([5])
    '1 temperature of the table is not used, because the model has no sensor there: cell 5.'
    """
    verb = "is" if len(cells) == 1 else "are"
    said = f"{counted(len(cells), 'temperature')} of the table {verb} not used"
    return f"{said}, because the model has no sensor there: {cells_in_words(cells)}."


def unread_sentence(what: str, cells: Sequence[int]) -> str:
    """Say that no temperature of some cells can be used.

    Parameters
    ----------
    what : str
        `surface` or `core`.
    cells : sequence of int

    Examples
    --------
    >>> unread_sentence("core", [2])
    'The record has no usable core temperature of cell 2: there are no values, or impossible ones.'
    """
    which = cells_in_words(cells)
    return f"The record has no usable {what} temperature of {which}: there are no values, or impossible ones."


def runs(cells: Sequence[int]) -> str:
    """List the numbers of cells in order; three or more neighbours become a range.

    Examples
    --------
    >>> runs([1, 2, 3, 4, 7, 9, 10])
    '1 to 4, 7, 9, 10'
    """
    found: list[list[int]] = []
    for k in cells:
        if found and k == found[-1][-1] + 1:
            found[-1].append(k)
        else:
            found.append([k])
    return ", ".join(f"{r[0]} to {r[-1]}" if len(r) > 2 else ", ".join(map(str, r)) for r in found)


def span(values: Iterable[float], form: str = ".2g") -> str:
    """Return the range of some values, or their common value.

    Examples
    --------
    >>> span([0.512, 1.1]), span([3.04, 3.02])
    ('0.51 to 1.1', '3')
    """
    known = sorted(values)
    few, many = f"{known[0]:{form}}", f"{known[-1]:{form}}"
    return few if few == many else f"{few} to {many}"


def along(size: Mapping[int, float]) -> str:
    """Say whether a size, by cell, grows or falls along the coolant; empty if it does neither or cells are few."""
    if len(size) < FEW:
        return ""
    place, rank = (np.argsort(np.argsort(x)) for x in (list(size), list(size.values())))
    together = float(np.corrcoef(place, rank)[0, 1])
    if abs(together) < ALONG:
        return ""
    return ", growing along the coolant" if together > 0.0 else ", falling along the coolant"
