"""Rows of a table from the ring of recent signals, a block at a time: a day's table is never held in memory."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import DataError, StateError
from bms_gateway.frames.vocabulary import INPUTS, WHOLE
from bms_gateway.store.recent import Block, read_recent
from bms_gateway.thermal import Floats

NEEDED = tuple(INPUTS[q].column for q in WHOLE if INPUTS[q].needed)
SECOND_US = 1_000_000
MOST_CELLS = 200_000
"""Cells of the table that are text at the same time: each takes some hundred bytes."""
Samples = tuple[NDArray[np.int64], Floats]


@dataclass(slots=True)
class Excerpt:
    """Part of the ring for a table.

    Attributes
    ----------
    columns : dict of str to list of str
        Columns that have a value, by string, in the order of the newest block.
    first_us, last_us : int
        Range of the times of rows.
    turned_back : bool
        Whether the clock went back: the table then starts after this.
    problems : list of StateError
        Parts of the ring that could not be used.
    """

    first_us: int
    last_us: int
    columns: dict[str, list[str]] = field(default_factory=dict)
    turned_back: bool = False
    problems: list[StateError] = field(default_factory=list)
    _since: tuple[int, int] = (0, 0)
    _directory: Path = Path()

    def rows(self, string: str) -> Iterator[list[str]]:
        """Give the rows of a string's table as text: `time_s`, then its columns; blanks for missing values."""
        newest = -1
        for block in read_recent(self._directory, []):
            if block.place < self._since or string not in block.layout:
                continue
            yield from _rows(block, string, self.columns[string], max(self.first_us, newest + 1), self.last_us)
            newest = max(newest, block.last_us)


def excerpt(directory: Path, last_s: float, until_us: int | None = None) -> Excerpt:
    """Search the ring.

    Parameters
    ----------
    directory : Path
    last_s : float
        Length of the part, s before the end.
    until_us : int, optional
        End, µs, if it is not the newest sample.

    Returns
    -------
    Excerpt

    Raises
    ------
    DataError
        Nothing was recorded.
    """
    problems: list[StateError] = []
    spans = [(b.first_us, b.last_us, b.place) for b in read_recent(directory, problems)]
    if not spans:
        why = f" ({problems[0]})" if problems else ""
        raise DataError(f"{directory}: no recent signals are recorded there{why}")
    back = [k for k in range(1, len(spans)) if spans[k][1] < spans[k - 1][0]]
    skip = back[-1] if back else 0
    last, since = max(end for _, end, _ in spans[skip:]), spans[skip][2]
    end = last if until_us is None else until_us
    found = Excerpt(
        end - round(last_s * SECOND_US), min(last, end), problems=problems, _since=since, _directory=directory
    )
    found.turned_back = skip > 0 and found.first_us < spans[skip][0]
    seen: dict[str, dict[str, None]] = {}
    for block in read_recent(directory, []):
        if block.place >= since and block.last_us >= found.first_us and block.first_us <= found.last_us:
            _note_columns(block, seen)
    found.columns = {
        name: [*NEEDED, *(c for c in columns if c not in NEEDED)] for name, columns in seen.items() if columns
    }
    return found


def _note_columns(block: Block, seen: dict[str, dict[str, None]]) -> None:
    for name, columns in block.layout.items():
        mine = seen.setdefault(name, {})
        for column, source in columns.items():
            if isinstance(source, float) or source in block.samples:
                mine[column] = None


def _rows(block: Block, string: str, columns: Sequence[str], first_us: int, last_us: int) -> Iterator[list[str]]:
    layout = block.layout[string]
    mine = {c: layout[c] for c in columns if c in layout}
    heard = {c: block.samples[i] for c, i in mine.items() if not isinstance(i, float) and i in block.samples}
    if not heard:
        return
    # a sample may fill several columns
    stamps: NDArray[np.int64] = np.unique(np.concatenate([block.samples[i][0] for i in _inputs(mine, block)]))
    stamps = stamps[(stamps >= first_us) & (stamps <= last_us)]
    count = max(1, MOST_CELLS // (1 + len(columns)))
    for at in range(0, len(stamps), count):
        yield from _some_rows(stamps[at : at + count], columns, mine, heard)


def _inputs(mine: Mapping[str, int | float], block: Block) -> set[int]:
    return {i for i in mine.values() if not isinstance(i, float) and i in block.samples}


def _some_rows(
    stamps: NDArray[np.int64], columns: Sequence[str], mine: Mapping[str, int | float], heard: Mapping[str, Samples]
) -> Iterator[list[str]]:
    text = []
    for column in columns:
        cells = np.full(len(stamps), "", dtype="U24")
        if column in heard:
            time, value = heard[column]
            inside = (time >= stamps[0]) & (time <= stamps[-1])
            cells[np.searchsorted(stamps, time[inside])] = value[inside].astype(np.float32).astype("U24")
        elif isinstance(constant := mine.get(column), float):
            cells[:] = f"{constant:.9g}"
        text.append(cells.tolist())
    seconds = [f"{t // SECOND_US}.{t % SECOND_US:06d}" for t in stamps.tolist()]
    yield from (list(row) for row in zip(seconds, *text, strict=True))
