"""Cells that show the same share one sentence: which cells they are, their range, and how it goes along the coolant."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

FEW = 4
"""Least number of cells of which it means something that a number grows from cell to cell."""
ALONG = 0.8
"""Least rank correlation of a number with the place along the coolant for which it grows or falls."""


def cells_in_words(cells: Sequence[int]) -> str:
    """Name cells in order.

    Examples
    --------
    >>> cells_in_words([3]), cells_in_words([1, 2, 3, 7])
    ('cell 3', 'cells 1 to 3, 7')
    """
    return f"cell {cells[0]}" if len(cells) == 1 else f"cells {runs(cells)}"


def runs(cells: Sequence[int]) -> str:
    """Name the numbers of cells in order, neighbours from the third on as a stretch.

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
    """Give the range of some values, or the one that they all have.

    Examples
    --------
    >>> span([0.512, 1.1]), span([3.04, 3.02])
    ('0.51 to 1.1', '3')
    """
    known = sorted(values)
    few, many = f"{known[0]:{form}}", f"{known[-1]:{form}}"
    return few if few == many else f"{few} to {many}"


def along(size: Mapping[int, float]) -> str:
    """Say whether a size, by cell, grows or falls along the coolant; empty where it does neither or cells are few."""
    if len(size) < FEW:
        return ""
    place, rank = (np.argsort(np.argsort(x)) for x in (list(size), list(size.values())))
    together = float(np.corrcoef(place, rank)[0, 1])
    if abs(together) < ALONG:
        return ""
    return ", growing along the coolant" if together > 0.0 else ", falling along the coolant"
