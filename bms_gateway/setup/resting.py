"""Estimates an unmeasured temperature of the surroundings from the lowest readings, at rest if there is a rest."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.setup.intervals import silences
from bms_gateway.setup.proposal import Proposal, Proposed
from bms_gateway.thermal import Floats

REST_SHARE: Final = 0.02
"""Share of the greatest current below which a pack rests: its heat is less than a thousandth of the greatest heat."""
REST_S: Final = 180.0
"""Shortest rest in which surfaces come near their surroundings."""
UNKNOWN_K: Final = 3.0
"""sd of a lowest reading that is not at rest: cells under load are warmer than their surroundings."""
LEAST_K: Final = 1.0
"""Least sd of a reading at rest: a cell cools for an hour."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Temperature of the surroundings of a string.

    Attributes
    ----------
    value_C, sd_K : float
    rest : bool
        Whether it was read at rest.
    """

    value_C: float
    sd_K: float = UNKNOWN_K
    rest: bool = False


def surroundings(proposal: Proposal, string: int) -> Surroundings:
    """Take the lowest readings of a string's thermocouples: the surroundings are hardly warmer.

    Readings of a rest are taken if they are nearly as low as all others. Their scatter is the sd: cells differ, and
    still cool down.
    """
    cells = [p for p in proposal.of("surface") if p.string == string]
    if not cells:
        return Surroundings(25.0)
    lows = [float(np.quantile(x, 0.02)) for p in cells if len(x := _celsius(p))]
    if not lows:
        return Surroundings(25.0)
    lowest = _lower(lows)
    found = []
    for start, stop in _rests(next(proposal.of("current", string))):
        parts = [_celsius(p, start, stop) for p in cells]
        readings = [x for x in parts if len(x)]
        if len(readings) < len(cells):
            continue
        C = _lower([float(np.quantile(x, 0.05)) for x in readings])
        apart = float(np.sqrt(np.mean((np.concatenate(readings) - C) ** 2)))
        found.append(Surroundings(C, min(max(apart, LEAST_K), UNKNOWN_K), rest=True))
    best = min(found, key=lambda s: s.value_C, default=None)
    return best if best is not None and best.value_C <= lowest + LEAST_K else Surroundings(lowest)


def _lower(values: list[float]) -> float:
    """Lower quartile of values: the least of many values may come from a broken sensor."""
    return float(sorted(values)[len(values) // 4])


def _rests(current: Proposed) -> Iterator[tuple[float, float]]:
    """Give begin and end of each long rest, s; a silence is no rest, because a clock may have been set."""
    t, amps = current.series.t, np.abs(current.factor * current.series.x)
    still = amps <= max(REST_SHARE * float(amps.max()), current.resolution)
    silent = silences((t * 1e9).astype(np.int64)) > 0
    begins = np.flatnonzero(np.diff(still, prepend=False) | silent)
    for first, end in pairwise([*begins.tolist(), len(t)]):
        if still[first] and t[end - 1] - t[first] >= REST_S:
            yield float(t[first]), float(t[end - 1])


def _celsius(p: Proposed, start: float = -np.inf, stop: float = np.inf) -> Floats:
    """Give the readings of a time that are plausible for surroundings."""
    inside = (start <= p.series.t) & (p.series.t <= stop)
    C = p.factor * p.series.x[inside] + p.shift
    least, most = INPUTS["coolant_inlet"].plausible
    return np.asarray(C[(least <= C) & (most >= C)])
