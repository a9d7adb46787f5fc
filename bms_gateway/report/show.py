"""Readable tables for a terminal: plain aligned text, the same in a pipe."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import floor, isfinite, log10
from typing import TYPE_CHECKING

from bms_gateway.frames.quality import Quality
from bms_gateway.thermal import Floats

if TYPE_CHECKING:
    from bms_gateway.engine.events import Cells


def number(x: float | None, digits: int = 2) -> str:
    """Write a number for people; `–` if there is none.

    Examples
    --------
    >>> number(21.456), number(float("nan")), number(-0.001)
    ('21.46', '–', '0.00')
    """
    # a number that is rounded to zero has no sign
    return "–" if x is None or x != x else f"{round(x, digits) + 0.0:.{digits}f}"


def kelvins(x: float | None) -> str:
    """Write an error in K for people, with three significant digits and three decimals at most; `–` if there is none.

    Examples
    --------
    >>> kelvins(35.728), kelvins(1.6689), kelvins(0.0502), kelvins(9.998), kelvins(float("nan"))
    ('35.7', '1.67', '0.050', '10.0', '–')
    """
    if x is None or not isfinite(x):
        return "–"
    size = floor(log10(abs(float(f"{x:.2e}")))) if x else 0
    return number(x, min(max(2 - size, 0), 3))


def ranges(numbers: Sequence[int]) -> str:
    """Write ascending numbers briefly.

    Examples
    --------
    >>> ranges([1, 2, 3, 7, 11, 12])
    '1-3,7,11,12'
    """
    runs: list[list[int]] = []
    for k in numbers:
        if runs and k == runs[-1][-1] + 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    return ",".join(f"{r[0]}-{r[-1]}" if len(r) > 2 else ",".join(map(str, r)) for r in runs)


def text_table(headers: Sequence[str], rows: Sequence[Sequence[object]], *, left: int = 1) -> str:
    """Align rows under their headers; the first `left` columns to the left, the others, numbers, to the right.

    Examples
    --------
    >>> print(text_table(["cell", "core °C"], [["1", "25.01"], ["12", "7.50"]]))
    cell  core °C
    1       25.01
    12       7.50
    """
    cells = [list(headers), *([str(c) for c in row] for row in rows)]
    widths = [max(len(row[j]) for row in cells) for j in range(len(headers))]
    return "\n".join(
        "  ".join(
            c.ljust(w) if j < left else c.rjust(w) for j, (c, w) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in cells
    )


def cells_table(cells: "Cells", true_core: Floats | None = None) -> str:
    """Table of one string's cells at one tick; NaN is shown as a dash.

    Parameters
    ----------
    cells : Cells
    true_core : ndarray (n,), optional
        Known of a simulation, °C: adds the hottest points, the truth and the error of the cores.
    """
    headers = ["string", "cell", "quality", "core °C", "± sd K", "surface °C"]
    rows = [
        [cells.string, str(k + 1), quality_name(q), number(c), number(s), number(t)]
        for k, (c, s, t, q) in enumerate(zip(cells.core, cells.core_sd, cells.surface, cells.quality, strict=True))
    ]
    if true_core is not None:
        headers += ["hottest °C", "true core °C", "error K"]
        for row, centre, c, t in zip(rows, cells.centre, cells.core, true_core, strict=True):
            row += [number(float(x)) for x in (centre, t, c - t)]
    return text_table(headers, rows, left=3)


def quality_name(quality: int) -> str:
    """Name a quality as reports write it: `good`, `out_of_range`, `estimated`."""
    return Quality(quality).name.lower()


@contextmanager
def live_view() -> Iterator[Callable[[str], None]]:
    """Return a function that draws a text over the previous one; without a terminal it draws nothing."""
    if not sys.stdout.isatty():
        yield _nothing
        return
    from rich.live import Live
    from rich.text import Text

    with Live(auto_refresh=False, transient=True) as live:
        yield lambda text: live.update(Text(text), refresh=True)


def _nothing(_text: str) -> None:
    """Off a terminal only the end counts."""
