"""The uniform grid of a record: the length of its intervals, and the gaps at which it is divided."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bms_gateway.errors import DataError, counted
from bms_gateway.thermal import Floats

FINEST_S = 1.0
"""Least length of an interval: a surface follows its core within seconds, and shorter intervals tell nothing more."""
INTERVALS, INTERVALS_MANY_CELLS, MANY_CELLS = 7200, 3600, 6
"""Greatest number of intervals: two hours at 1 Hz, one hour for long strings; a diagnosis then takes seconds."""
GAP_S, GAP_INTERVALS = 120.0, 20.0
"""Where the current is unknown for longer, the heat is unknown: the record is divided there."""
BRIDGE_S, BRIDGE_INTERVALS = 5.0, 5.0
"""Rows further apart are connected by a straight line, and a note reports it."""
BURST = 0.1
"""Rows whose distance is below this share of the upper quartile of distances belong to one burst."""
LEAST_INTERVALS = 60
"""Least number of intervals of a part: a shorter part does not determine its own start temperatures."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Instants and segments.

    Attributes
    ----------
    dt : float
        s.
    instants : ndarray (N + 1,)
        s; `dt` apart, except across gaps.
    segments : tuple of int
        Instant at which each part begins.
    """

    dt: float
    instants: Floats
    segments: tuple[int, ...]

    @property
    def gaps(self) -> list[int]:
        """Intervals that represent gaps."""
        return [start - 1 for start in self.segments[1:]]


def usual_interval(t: Floats) -> float:
    """Time from row to row, s, for any gaps and bursts.

    Examples
    --------
    >>> usual_interval(np.array([0.0, 1.0, 1.001, 2.0, 3.0, 3.001, 4.0, 500.0]))
    1.0
    """
    d = np.diff(t)
    d = d[d >= BURST * float(np.percentile(d, 75))]
    return float(np.round(np.median(d), 6))


def bridged(t: Floats) -> tuple[float, float]:
    """Spacing of rows above which a gap is bridged, and above which it divides the record, s."""
    usual = usual_interval(t)
    return max(BRIDGE_S, BRIDGE_INTERVALS * usual), max(GAP_S, GAP_INTERVALS * usual)


def lay_grid(source: str, t: Floats, cells: int, notes: list[str]) -> Grid:
    """Divide the time with a known current into intervals.

    Parameters
    ----------
    source : str
        Name of the record in error messages.
    t : ndarray (K,)
        Stamps of the current, s.
    cells : int
        Of the string; long strings get fewer intervals.
    notes : list of str
        Notes are appended.

    Raises
    ------
    DataError
        There is not even one interval.
    """
    gap = bridged(t)[1]
    cuts = np.flatnonzero(np.diff(t) > gap) + 1
    parts = [(float(t[a]), float(t[b - 1])) for a, b in pairwise([0, *cuts.tolist(), len(t)])]
    covered = sum(b - a for a, b in parts)
    dt = _interval(usual_interval(t), covered, INTERVALS if cells <= MANY_CELLS else INTERVALS_MANY_CELLS)
    counts = [int((b - a) / dt + 1e-6) for a, b in parts]
    kept = [i for i, n in enumerate(counts) if n >= LEAST_INTERVALS]
    if not kept:
        kept = [int(np.argmax(counts))]
    if not counts[kept[0]]:
        raise DataError(f"{source}: the current is known for less than one interval: nothing can be learnt from it")
    if len(kept) < len(parts):
        lost = sum(b - a for i, (a, b) in enumerate(parts) if i not in kept)
        notes.append(f"{lost / 60.0:.1f} min in {len(parts) - len(kept)} pieces between gaps are too short to be used.")
    instants = [parts[i][0] + dt * np.arange(counts[i] + 1) for i in kept]
    starts = np.cumsum([0, *(len(x) for x in instants[:-1])])
    if len(kept) > 1:
        longest = max(parts[b][0] - parts[a][1] for a, b in pairwise(kept))
        notes.append(
            f"The current is missing for more than {gap:.0f} s at {counted(len(kept) - 1, 'place')}, for {longest:.0f} "
            f"s at the longest: the record is taken as {len(kept)} parts, each with its own start."
        )
    if dt > 1.5 * max(usual_interval(t), FINEST_S):
        notes.append(f"The record is long: its inputs are averaged over {dt:g} s.")
    return Grid(dt, np.concatenate(instants), tuple(starts.tolist()))


def _interval(usual: float, covered: float, most: int) -> float:
    """Interval with a round length if the stamps nearly have one, and long enough to limit their number."""
    base = max(usual, FINEST_S)
    near = float(np.round(base * 20.0) / 20.0)
    base = near if abs(near - base) <= 0.02 * base else base
    return base * max(1.0, float(np.ceil(covered / base / most - 1e-9)))
