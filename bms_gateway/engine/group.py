"""Strings that are observed together, and what is worked out for all of them at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.backlog import Backlog
from bms_gateway.engine.readings import Readings
from bms_gateway.engine.string import StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.observe import AdaptiveObserver, Errors
from bms_gateway.thermal import Floats

if TYPE_CHECKING:
    from bms_gateway.observe.effects import EffectObserver

# of numpy's own type, which it compares much faster than members of an enumeration
GOOD, STALE, ESTIMATED, NEVER = (np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.ESTIMATED, Quality.NEVER))
At = slice | NDArray[np.intp]


@dataclass(slots=True)
class Group:
    """Strings with equal numbers of cells and the observer that stacks them, or one string with effects and its own.

    Attributes
    ----------
    members : list of int
        Numbers of its strings in the plan.
    rows, flat : slice or ndarray of int
        Where its strings and their cells stand among all.
    nominal_flow : ndarray (S,) or None
        m³/s, NaN where not known; None where none of them knows the flow of its coolant.
    voltage : bool
        Whether the heat of any of them may come from its voltage.
    adopts : list of int
        Which of them have a recursive method, whose numbers the observer takes over once in a while.
    unknown : ndarray (S,)
        NaN for each: a quantity that none of them has.
    errors : Errors or None
        Of the newest tick's readings.
    """

    members: list[int]
    strings: list[StringEstimator]
    observer: "AdaptiveObserver | EffectObserver"
    cells: int
    rows: At
    flat: At
    nominal_flow: Floats | None
    voltage: bool
    adopts: list[int]
    unknown: Floats
    backlog: Backlog
    errors: Errors | None = None

    @classmethod
    def of(
        cls,
        strings: Sequence[StringEstimator],
        members: list[int],
        observer: "AdaptiveObserver | EffectObserver",
        dt: float,
    ) -> "Group":
        """Group the strings numbered `members`, which tick every `dt` seconds."""
        mine = [strings[i] for i in members]
        flow = np.array([s.plan.model.flow or np.nan for s in mine])
        return cls(
            members,
            mine,
            observer,
            mine[0].plan.model.cells,
            _at(members),
            _at([k for s in mine for k in range(s.mine.start, s.mine.stop)]),
            None if np.isnan(flow).all() else flow,
            any(s.voltage is not None for s in mine),
            [j for j, s in enumerate(mine) if s.plan.identify == "rls" and not s.plan.model.effects],
            np.full(len(mine), np.nan),
            Backlog(mine, dt),
        )

    def by_cell(self, row: Floats) -> Floats:
        """Take its cells out of those of all (N,), as (S, n)."""
        return row[self.flat].reshape(len(self.members), self.cells)

    def put(self, row: NDArray[Any], values: NDArray[Any]) -> None:
        """Give `values` (S, n) of its cells their places in a row of all (N,)."""
        if isinstance(self.flat, slice):
            row[self.flat].reshape(values.shape)[...] = values
        else:
            row[self.flat] = values.ravel()

    def quality(self, readings: Readings) -> NDArray[np.uint8]:
        """Quality (S, n) of its strings' estimates: the own sensor's, and nowhere better than that of the current."""
        own = readings.quality[self.flat].reshape(len(self.members), self.cells)
        if (never := own == NEVER).any():
            own = np.where(never, ESTIMATED, own)
        current = readings.current_quality[self.rows]
        if (current == GOOD).all():
            return own
        current = np.where(current == NEVER, STALE, current)
        worse = ((own == GOOD) | (own == ESTIMATED)) & (current != GOOD)[:, None]
        return np.where(worse, current[:, None], own)


def _at(places: list[int]) -> At:
    """Address places among many: by a slice where they follow each other, which copies nothing."""
    if all(b - a == 1 for a, b in pairwise(places)):
        return slice(places[0], places[-1] + 1)
    return np.array(places, np.intp)
