"""Ticks of all strings of a group that the identifiers have not used yet.

An identifier that collects windows needs a tick at once only if the tick is unusual or may end a window. Regular ticks
may wait, and wait here in columns. A string takes all its waiting ticks at once: when their number reaches its limit,
when its current or inlet is missing, or when its state is needed. The result equals that of single ticks to the last
bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

import numpy as np

from bms_gateway.engine.events import Job
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.identify import PairMeans, Tick, Ticks
from bms_gateway.identify.ticks import ENDLESS
from bms_gateway.observe.model import Bools
from bms_gateway.thermal import Floats

BLOCK = 60
"""Number of ticks in one block of columns: this needs few objects, and no second copy of a long backlog."""


class GroupTick(NamedTuple):
    """One tick of S strings of n cells; see `Tick` and `Reading` for the quantities, (S,) or (S, n).

    Attributes
    ----------
    flow : ndarray (S,) or None
        Flow over nominal flow; NaN for a string whose flow is unknown, None if all are unknown.
    cells : sequence of PairMeans or None
        One per string, or empty.
    """

    time_ns: int
    dt: float
    square: Floats
    heat: Floats
    inlet: Floats
    flow: Floats | None
    current: Floats
    soc: Floats
    surface: Floats
    age: Floats
    cells: Sequence[PairMeans | None]

    def of(self, j: int) -> Tick:
        """Return the tick of string `j`."""
        square, heat, inlet = float(self.square[j]), float(self.heat[j]), float(self.inlet[j])
        return Tick(self.time_ns, self.dt, square, heat, inlet, self.surface[j], self.age[j], float(self.current[j]))


@dataclass(frozen=True, slots=True)
class _Block:
    """Ticks number `first` to `end` − 1, a column per quantity of `Ticks`, stacked along the first axis."""

    first: int
    end: int
    columns: tuple[Floats, ...]


class Backlog:
    """See the module's text.

    Parameters
    ----------
    strings : sequence of StringEstimator
    dt : float, s
        Period of regular ticks.
    """

    def __init__(self, strings: Sequence[StringEstimator], dt: float) -> None:
        self._strings, self._dt = strings, dt
        self._now = 0  # number of the next tick
        # per string: number of the first tick that it has not used yet
        self._taken = np.zeros(len(strings), np.int64)
        self._due = np.zeros(len(strings), np.int64)  # per string: number of the tick that it needs at once
        self._next = self._least = 0  # the least of both
        self._blocks: list[_Block] = []
        self._single: list[GroupTick] = []  # the newest ticks, not in a block yet

    @property
    def kept(self) -> int:
        """Number of ticks that are kept for strings that have not used them."""
        return sum(b.end - b.first for b in self._blocks) + len(self._single)

    def add(self, tick: GroupTick) -> list[tuple[int, Job]]:
        """Add a tick.

        Returns
        -------
        list of (int, Job)
            Jobs of the strings, with the index of the string in the group.
        """
        usual: Bools = np.isfinite(tick.square + tick.inlet)
        if tick.flow is not None:
            usual &= np.isnan(tick.flow)
        if tick.dt != self._dt:
            usual[:] = False
        jobs: list[tuple[int, Job]] = []
        now = self._now
        if now >= self._next or not usual.all():
            for j in np.flatnonzero((~usual & (self._taken < ENDLESS)) | (self._due <= now)).tolist():
                self._bring(j)
                s, pairs = self._strings[j], tick.cells[j] if tick.cells else None
                flow = nan if tick.flow is None else float(tick.flow[j])
                found = s.learn(tick.of(j), float(tick.current[j]), float(tick.soc[j]), flow, pairs)
                jobs += [(j, job) for job in found]
                patience = s.patience(self._dt)
                self._taken[j] = now + 1 if patience < ENDLESS else ENDLESS
                self._due[j] = min(now + 1 + patience, ENDLESS)
            self._next = int(self._due.min())
            self._forget()
        self._now += 1
        if self._least <= now:
            self._single.append(tick)
            if len(self._single) >= BLOCK:
                self._stack()
        return jobs

    def catch_up(self, j: int) -> None:
        """Give string `j` all its waiting ticks, and the next tick at once, because something about it changes."""
        self._bring(j)
        self._due[j] = self._next = self._now

    def _bring(self, j: int) -> None:
        """Give string `j` the regular ticks that wait for it."""
        since = int(self._taken[j])
        if since >= self._now:
            return
        self._stack()
        for b in self._blocks:
            if b.end > since:
                self._strings[j].take(Ticks(self._dt, *(c[max(0, since - b.first) :, j] for c in b.columns)))
        self._taken[j] = self._now

    def _stack(self) -> None:
        if not self._single:
            return
        columns = zip(
            *((t.square, t.heat, t.inlet, t.current, t.soc, t.surface, t.age) for t in self._single), strict=True
        )
        self._blocks.append(_Block(self._now - len(self._single), self._now, tuple(np.stack(c) for c in columns)))
        self._single = []

    def _forget(self) -> None:
        """Delete the ticks that every string has used."""
        self._least = int(self._taken.min())
        self._blocks = [b for b in self._blocks if b.end > self._least]
