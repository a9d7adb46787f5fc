"""Strings that are observed together, and what is worked out for all of them at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.backlog import Backlog
from bms_gateway.engine.core_floor import Floor
from bms_gateway.engine.observed import Observed
from bms_gateway.engine.readings import Readings
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_watch import Share
from bms_gateway.observe import Errors
from bms_gateway.thermal import Floats

# of numpy's own type, which it compares much faster than members of an enumeration
GOOD, STALE, ESTIMATED, NEVER, DOUBTFUL = (
    np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.ESTIMATED, Quality.NEVER, Quality.DOUBTFUL)
)
At = slice | NDArray[np.intp]
T = TypeVar("T", bound=np.generic)


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
    observed : Observed
        Their observer.
    voltage : bool
        Whether the heat of any of them may come from its voltage.
    adopts : list of int
        Which of them have a recursive method, whose numbers the observer takes over once in a while.
    unknown : ndarray (S,)
        NaN for each: a quantity that none of them has.
    doubt : ndarray (S, 1) or None
        Share of the difference core to surface that may be wrong beyond what the observer knows; None where it is zero.
    watch : HeatWatch or None
        Over heat that no current makes; None where a string has no sensor for a cell of its own.
    errors : Errors or None
        Of the newest tick's readings.
    heat : ndarray (S,) or None
        Of a mean cell by its voltage in the newest tick, W; NaN where none tells, None where there are no voltages.
    """

    members: list[int]
    strings: list[StringEstimator]
    observed: Observed
    cells: int
    rows: At
    flat: At
    nominal_flow: Floats | None
    voltage: bool
    adopts: list[int]
    unknown: Floats
    backlog: Backlog
    doubt: Floats | None
    floor: Floor
    watch: HeatWatch | None
    errors: Errors | None = None
    heat: Floats | None = None

    @classmethod
    def of(
        cls,
        strings: Sequence[StringEstimator],
        members: list[int],
        observed: Observed,
        dt: float,
    ) -> "Group":
        """Group the strings numbered `members`, which tick every `dt` seconds."""
        mine = [strings[i] for i in members]
        flow = np.array([s.plan.model.flow or np.nan for s in mine])
        return cls(
            members,
            mine,
            observed,
            mine[0].plan.model.cells,
            index_of(members),
            index_of([k for s in mine for k in range(s.mine.start, s.mine.stop)]),
            None if np.isnan(flow).all() else flow,
            any(s.voltage is not None for s in mine),
            [j for j, s in enumerate(mine) if s.plan.identify == "rls" and not s.plan.model.effects],
            np.full(len(mine), np.nan),
            Backlog(mine, dt),
            np.array([[s.plan.model.core_doubt] for s in mine]) if any(s.plan.model.core_doubt for s in mine) else None,
            Floor.of([s.plan.model for s in mine]),
            _watch(mine, dt, observed.shares),
        )

    def reveal(self, j: int) -> None:
        """Let the watch over heat have the numbers that the observer has now."""
        if self.watch is not None:
            self.watch.set_parameters(j, self.observed.observer.parameters[j])

    def resume(self, heat: Mapping[str, Any] | None) -> None:
        """Let the watch over heat go on from what was stored of it, if anything, beside a restored observer."""
        for j in range(len(self.members)):
            self.reveal(j)
        if self.watch is not None and heat is not None:
            self.watch.restore(heat)
            for s, v in zip(self.strings, self.watch.verdicts, strict=True):
                s.health.heat = v.findings

    def by_cell(self, row: NDArray[T]) -> NDArray[T]:
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

    def doubtful(self, quality: NDArray[np.uint8], cold: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
        """Quality (S, n) with doubt in place of trust: of strings whose cores are not proven, and of `cold` cores."""
        doubted = [bool(s.doubts) for s in self.strings]
        if cold is None and not any(doubted):
            return quality
        trusted = (quality == GOOD) | (quality == ESTIMATED)
        without = np.array(doubted)[:, None] if cold is None else np.array(doubted)[:, None] | cold
        return np.where(trusted & without, DOUBTFUL, quality)


def _watch(strings: Sequence[StringEstimator], dt: float, shares: Sequence[Share]) -> HeatWatch | None:
    models = [s.plan.model for s in strings]
    if not all(m.sensors for m in models) or any(s.plan.of_several for s in strings):
        return None  # of a reading that is some cell's, a worse cooled cell explains as much as heat
    return HeatWatch(models, dt, ["coolant_inlet" in s.wire.constants for s in strings], shares)


def index_of(places: list[int]) -> At:
    """Address places among many: by a slice where they follow each other, which copies nothing."""
    if all(b - a == 1 for a, b in pairwise(places)):
        return slice(places[0], places[-1] + 1)
    return np.array(places, np.intp)
