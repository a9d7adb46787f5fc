"""Strings with a common observer, and what is computed for all of them at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.backlog import Backlog
from bms_gateway.engine.contradicted import Contradicted
from bms_gateway.engine.core_floor import Floor
from bms_gateway.engine.observed import Observed
from bms_gateway.engine.readings import Readings
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_watch import Share
from bms_gateway.observe import Errors
from bms_gateway.thermal import Floats

# numpy's own type, because numpy compares it much faster than members of an enumeration
GOOD, STALE, ESTIMATED, NEVER, DOUBTFUL = (
    np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.ESTIMATED, Quality.NEVER, Quality.DOUBTFUL)
)
WARM_NS = 1_800_000_000_000  # half an hour: a cell has then lost the heat that no current made
LEFT = 2  # so many sound thermocouples tell better than with a wrong one what the cells have in common
At = slice | NDArray[np.intp]
T = TypeVar("T", bound=np.generic)


@dataclass(slots=True)
class Group:
    """Strings with equal numbers of cells and their stacked observer, or one string with effects and its observer.

    Attributes
    ----------
    members : list of int
        Numbers of its strings in the plan.
    rows, flat : slice or ndarray of int
        Places of its strings among all strings, and of their cells among all cells.
    nominal_flow : ndarray (S,) or None
        Nominal coolant flow, m³/s; NaN if unknown, None if it is unknown for all of them.
    observed : Observed
        Their observer.
    voltage : bool
        Whether any of them takes its heat from the voltage.
    adopts : list of int
        Strings with a recursive method; the observer takes over its numbers from time to time.
    unknown : ndarray (S,)
        NaN for each string: value of a quantity that none of them has.
    doubt : ndarray (S, 1) or None
        Additional share of core minus surface that may be wrong beyond the observer's band; None if it is zero.
    misread : ndarray (S, n) or None
        What constant errors of the thermocouples may have done to the cores, K; None if none was found.
    watch : HeatWatch or None
        Watch over heat that no current makes; None if a string has no sensor that belongs to one cell.
    errors : Errors or None
        Errors of the newest tick's readings.
    heat : ndarray (S,) or None
        Heat of a mean cell from its voltage in the newest tick, W; NaN if unknown, None if there are no voltages.
    contradicted : Contradicted
    heated : dict of (int, int) to int
        Bus time, ns, until which the identifiers of a string do without a cell (0-based) that has heated by itself.
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
    contradicted: Contradicted
    misread: Floats | None = None
    errors: Errors | None = None
    heat: Floats | None = None
    heated: dict[tuple[int, int], int] = field(default_factory=dict)

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
            Contradicted.of(len(mine), mine[0].plan.model.cells),
        )

    def reveal(self, j: int) -> None:
        """Take what the identifier found of the thermocouples, and give the watch the observer's present numbers."""
        found = self.strings[j].constant = self.strings[j].identifier.posterior().constant
        if found is not None and (found.any() or self.misread is not None):
            if self.misread is None:
                self.misread = np.zeros((len(self.members), self.cells))
            p, sensed = self.observed.observer.parameters[j], np.sort(self.strings[j].plan.model.sensors) - 1
            of_cell = np.interp(np.arange(self.cells), sensed, np.abs(found[sensed]))  # by the nearest thermocouples
            self.misread[j] = of_cell * (1.0 + p.R_c / p.R_u)  # a core lies farther from the coolant
        if self.watch is not None:
            self.watch.set_parameters(j, self.observed.observer.parameters[j])

    def resume(self, heat: Mapping[str, Any] | None) -> None:
        """Restore the watch over heat from its stored state, if there is one, along with a restored observer."""
        for j in range(len(self.members)):
            self.reveal(j)
        if self.watch is not None and heat is not None:
            self.watch.restore(heat)
            for s, v in zip(self.strings, self.watch.verdicts, strict=True):
                s.health.heat = v.findings

    def widened(self, sd: Floats, gap: Floats) -> Floats:
        """Sd (S, n), K, of temperatures that lie `gap` above the surface, with what the observer's own lacks."""
        if self.doubt is not None:
            sd = np.hypot(sd, self.doubt * gap)
        return sd if self.misread is None else np.hypot(sd, self.misread)

    def by_cell(self, row: NDArray[T]) -> NDArray[T]:
        """Return the values (S, n) of its cells from those of all cells (N,)."""
        return row[self.flat].reshape(len(self.members), self.cells)

    def put(self, row: NDArray[Any], values: NDArray[Any]) -> None:
        """Write the values (S, n) of its cells to their places in a row of all cells (N,)."""
        if isinstance(self.flat, slice):
            row[self.flat].reshape(values.shape)[...] = values
        else:
            row[self.flat] = values.ravel()

    def quality(self, readings: Readings) -> NDArray[np.uint8]:
        """Quality (S, n) of the estimates: that of the cell's own sensor, but never better than that of the current."""
        own = readings.quality[self.flat].reshape(len(self.members), self.cells)
        if (never := own == NEVER).any():
            own = np.where(never, ESTIMATED, own)
        current = readings.current_quality[self.rows]
        if (current == GOOD).all():
            return own
        current = np.where(current == NEVER, STALE, current)
        worse = ((own == GOOD) | (own == ESTIMATED)) & (current != GOOD)[:, None]
        return np.where(worse, current[:, None], own)

    def believed(self, y: Floats) -> Floats:
        """Return the surfaces (S, n) without those of thermocouples that are reported to be wrong.

        They stay if fewer than two thermocouples of the string would be left.
        """
        return self._without(y, [s.wrong for s in self.strings])

    def learnt(self, believed: Floats, now_ns: int) -> Floats:
        """Return the surfaces (S, n) from which identifiers learn: also without cells that heat by themselves.

        A cell stays warm for a while after its heat has ended.
        """
        for j, s in enumerate(self.strings):
            self.heated |= {(j, k): now_ns + WARM_NS for k in s.heating}
        if not self.heated:
            return believed
        self.heated = {at: until for at, until in self.heated.items() if until > now_ns}
        left_out = [s.wrong + tuple(k for i, k in self.heated if i == j) for j, s in enumerate(self.strings)]
        return self._without(believed, left_out)

    def does_without(self, j: int, cells: Sequence[int]) -> bool:
        """Return whether enough thermocouples of string `j` are left without those of some cells (0-based)."""
        return len({k - 1 for k in self.strings[j].plan.model.sensors} - set(cells)) >= LEFT

    def _without(self, y: Floats, left_out: Sequence[tuple[int, ...]]) -> Floats:
        if not any(left_out):
            return y
        kept = y.copy()
        for j, cells in enumerate(left_out):
            if cells and self.does_without(j, cells):
                kept[j, list(cells)] = np.nan
        return kept

    def burnt(self, own: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
        """Mark cells (S, n) that no number of the model describes.

        While a cell that has run away has no good reading, these are this cell, and those of its two neighbours
        that have none either. `own` is the `quality`. None: no cell has run away.
        """
        if not any(s.fire for s in self.strings):
            return None
        marked = np.zeros(own.shape, np.bool_)
        for j, s in enumerate(self.strings):
            for k in s.fire:
                if own[j, k] != GOOD:
                    beside = slice(max(k - 1, 0), k + 2)
                    marked[j, beside] |= own[j, beside] != GOOD
        return marked

    def doubtful(self, quality: NDArray[np.uint8], cold: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
        """Quality (S, n), set to `doubtful` for strings whose cores are not proven and for `cold` cores."""
        doubted = [bool(s.doubts) for s in self.strings]
        if cold is None and not any(doubted):
            return quality
        trusted = (quality == GOOD) | (quality == ESTIMATED)
        without = np.array(doubted)[:, None] if cold is None else np.array(doubted)[:, None] | cold
        return np.where(trusted & without, DOUBTFUL, quality)


def _watch(strings: Sequence[StringEstimator], dt: float, shares: Sequence[Share]) -> HeatWatch | None:
    models = [s.plan.model for s in strings]
    if not all(m.sensors for m in models) or any(s.plan.of_several for s in strings):
        return (
            None  # if it is not known which cell a reading belongs to, a worse cooled cell explains it as well as heat
        )
    return HeatWatch(models, dt, ["coolant_inlet" in s.wire.constants for s in strings], shares)


def index_of(places: list[int]) -> At:
    """Make an index of some places: a slice if they are consecutive, because a slice copies nothing."""
    if all(b - a == 1 for a, b in pairwise(places)):
        return slice(places[0], places[-1] + 1)
    return np.array(places, np.intp)
