"""Where a fit takes its columns: in intervals twice as long, one place for all readings that a channel has in one.

Columns only show a fit the way: what it minimises is taken at every reading. Over a few seconds they are as good as
straight, so that readings in one interval share their mean one, which is all but the gradient's noise of what each
would give, for a fraction of the products and half of the recursion.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Span, every_second

LONGEST_S = 6.0
"""Intervals are joined up to here: below a surface's own time constant."""
FEWEST = 8
"""Intervals of a span that are left as they are: nothing is saved."""
WORK, LONG_S = 30_000, 12.0
"""Cells times intervals beyond which intervals are joined up to `LONG_S`: the columns of a long string cost minutes."""


@dataclass(frozen=True, slots=True)
class Places:
    """The places of one record.

    Attributes
    ----------
    at : Measured
        The record with M' places for its readings: means of time and temperature.
    rows : ndarray of int (R',)
        Rows of the record's trajectory at the instants of `at`.
    place : ndarray of int (M,)
        Of each reading.
    first, count : ndarray of int (M',)
        First reading of each place, and how many follow it there.
    factor : int
        By which the intervals of `at` are longer than the record's.
    """

    at: Measured
    rows: NDArray[np.intp]
    place: NDArray[np.intp]
    first: NDArray[np.intp]
    count: NDArray[np.intp]
    factor: int

    @property
    def joined(self) -> bool:
        """Whether the intervals of `at` are longer than the record's."""
        return self.factor > 1

    def gathered(self, r: Floats) -> Floats:
        """Residuals (M,), in units of the noise, of the means (M',): what a place's column sees of them."""
        return np.asarray(np.add.reduceat(r, self.first) / np.sqrt(self.count))

    def averaged(self, x: Floats) -> Floats:
        """Means (M', …) of what was taken at the readings (M, …)."""
        count = self.count.reshape(-1, *(1,) * (x.ndim - 1))
        return np.asarray(np.add.reduceat(x, self.first) / count)


def places(m: Measured) -> Places:
    """Find the places of a record."""
    drive, spans, rows, factor = m.drive, m.spans, _rows(m.spans), 1
    while min(len(s) for s in spans) >= FEWEST:
        long = len(m.start[0]) * drive.N > WORK
        if 2.0 * drive.dt > (LONG_S if long else LONGEST_S) or (factor > 1 and not long):
            break
        drive, spans, kept = every_second(drive, spans)
        rows, factor = rows[kept], 2 * factor
    # of each row of the record: the row of `at` before it, and how far beyond, in its intervals
    row, beyond = _before(m.spans, spans, factor)
    row, share = row[m.row], beyond[m.row] + m.share / factor
    key = (m.channel * (len(rows) + 1) + row) * 2 + m.used
    first = np.flatnonzero(np.diff(key, prepend=key[:1] - 1))
    count = np.diff(np.append(first, len(key)))
    place = np.repeat(np.arange(len(first)), count)
    at = replace(
        m,
        drive=drive,
        spans=tuple(spans),
        channel=m.channel[first],
        row=row[first],
        share=np.add.reduceat(share, first) / count,
        y=np.add.reduceat(m.y, first) / count,
        used=m.used[first],
    )
    return Places(at, rows, place, first, count, factor)


def _rows(spans: tuple[Span, ...]) -> NDArray[np.intp]:
    return np.arange(sum(len(s) + 1 for s in spans))


def _before(fine: tuple[Span, ...], coarse: tuple[Span, ...], factor: int) -> tuple[NDArray[np.intp], Floats]:
    """Row of the coarse trajectory before each of the fine one's, and how many coarse intervals lie between."""
    rows, beyond, last = [], [], 0
    for f, c in zip(fine, coarse, strict=True):
        at = np.arange(len(f) + 1) / factor
        before = np.minimum(at.astype(np.intp), len(c) - 1)
        rows.append(before + last)
        beyond.append(at - before)
        last += len(c) + 1
    return np.concatenate(rows), np.concatenate(beyond)
