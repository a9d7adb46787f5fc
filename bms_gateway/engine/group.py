"""Strings that are observed together, and what is worked out for all of them at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.inputs import Reading
from bms_gateway.engine.string import StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import Floats

if TYPE_CHECKING:
    from bms_gateway.observe.effects import EffectObserver

# of numpy's own type, which it compares much faster than members of an enumeration
GOOD, STALE, ESTIMATED, NEVER = (np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.ESTIMATED, Quality.NEVER))


@dataclass(slots=True)
class Group:
    """Strings with equal numbers of cells and the observer that stacks them, or one string with effects and its own."""

    members: list[int]
    observer: "AdaptiveObserver | EffectObserver"
    cells: int
    flow: bool
    """Whether any of them knows the flow of its coolant."""
    voltage: bool
    """Whether the heat of any of them may come from its voltage."""
    unknown: list[float]
    """NaN for each: a quantity that none of them has."""

    @classmethod
    def of(
        cls,
        strings: Sequence[StringEstimator],
        members: list[int],
        observer: "AdaptiveObserver | EffectObserver",
    ) -> "Group":
        """Group the strings numbered `members`."""
        mine = [strings[i] for i in members]
        flow, voltage = any(s.plan.model.flow for s in mine), any(s.voltage is not None for s in mine)
        return cls(members, observer, mine[0].plan.model.cells, flow, voltage, [nan] * len(mine))


def mean_squares(innovation: Floats, sd: Floats) -> list[float]:
    """Mean over each string's readings of the innovation's square in units of its variance; NaN without a reading."""
    squares = np.square(innovation / sd)
    there = np.isfinite(squares)
    count = there.sum(axis=1)
    mean = np.where(there, squares, 0.0).sum(axis=1) / np.maximum(count, 1)
    return [float(x) if k else nan for x, k in zip(mean.tolist(), count.tolist(), strict=True)]


def quality_of(readings: Sequence[Reading], cells: int) -> NDArray[np.uint8]:
    """Quality (S, n) of strings' estimates: the own sensor's, and nowhere better than that of the current."""
    own = np.concatenate([r.quality for r in readings]).reshape(-1, cells)
    own = np.where(own == NEVER, ESTIMATED, own)
    current = np.array([STALE if r.current_quality == NEVER else r.current_quality for r in readings], np.uint8)
    worse = ((own == GOOD) | (own == ESTIMATED)) & (current != GOOD)[:, None]
    return np.where(worse, current[:, None], own)
