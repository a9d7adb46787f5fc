"""Where a fit computes its columns: in longer intervals, at one place for all readings of a channel in an interval.

Columns only give the direction of a step; the minimised cost uses every reading. Over a few seconds the columns are
nearly straight lines. Readings in one interval therefore share their mean column: nearly the same result, for a
fraction of the products and half of the recursion.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Span, every_second

LONGEST_S = 6.0
"""Longest joined interval: below a surface's own time constant."""
FEWEST = 8
"""Least intervals of a span for joining; with fewer, nothing is saved."""
WORK, LONG_S = 30_000, 12.0
"""Cells times intervals above which intervals are joined up to `LONG_S`: columns of a long string take minutes."""


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
        Place of each reading.
    first, count : ndarray of int (M',)
        First reading of each place, and number of its readings.
    factor : int
        Length of the intervals of `at` over that of the record's.
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
        """Residuals (M,), in units of the noise, as sums for the places (M',)."""
        return np.asarray(np.add.reduceat(r, self.first) / np.sqrt(self.count))

    def averaged(self, x: Floats) -> Floats:
        """Means (M', …) of values at the readings (M, …)."""
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
    # for each row of the record: the row of `at` before it, and the distance to it in intervals of `at`
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
    """Row of the coarse trajectory before each row of the fine one, and the distance in coarse intervals."""
    rows, beyond, last = [], [], 0
    for f, c in zip(fine, coarse, strict=True):
        at = np.arange(len(f) + 1) / factor
        before = np.minimum(at.astype(np.intp), len(c) - 1)
        rows.append(before + last)
        beyond.append(at - before)
        last += len(c) + 1
    return np.concatenate(rows), np.concatenate(beyond)
