"""All strings' estimators side by side: observers stacked by string length, an identifier and the health of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import nan
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from bms_gateway.engine.backlog import GroupTick
from bms_gateway.engine.events import Estimated, Event, Job, Level, Notice, Parameters
from bms_gateway.engine.group import Group
from bms_gateway.engine.inputs import Wire
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.plausible import check_covariance, check_parameters, check_temperatures
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.engine.string import Newest, StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.health import Change, HealthResult, Mismatch, Mismatches
from bms_gateway.identify import (
    Estimate,
    FixedIdentifier,
    string_parameters,
)
from bms_gateway.identify.cell_kept import baseline_of
from bms_gateway.identify.cell_live import CellIdentifier, CellResult
from bms_gateway.identify.cells_in_words import sentence
from bms_gateway.identify.contract import FIXED_OFFLINE, IDENTIFIED
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.measured import SOC_UNKNOWN
from bms_gateway.observe.unseen import RESTED_S
from bms_gateway.thermal import Disturbance, Floats

if TYPE_CHECKING:
    from bms_gateway.observe.effects import EffectObserver

NOT_AVAILABLE = np.uint8(Quality.NOT_AVAILABLE)  # of numpy's own type, which it compares faster
AVAILABLE_SD_K = 12.0
"""A core known no better than this is sent as not available: no decision can be built on it, and the DBC ends there."""


ADOPT_NS = 60_000_000_000  # the recursive method moves with every tick; the observer's matrices need not


@dataclass(slots=True)
class TickResult:
    """What one tick gave beside the numbers: events, and jobs with the string they belong to."""

    events: list[Event] = field(default_factory=list)
    jobs: list[tuple[int, Job]] = field(default_factory=list)


class Estimators:
    """Estimators of a plan.

    Parameters
    ----------
    plan : Plan
    wires : sequence of Wire
        One per string.
    """

    def __init__(self, plan: Plan, wires: Sequence[Wire]) -> None:
        self._dt = plan.tick_ns * 1e-9
        self._introduced = False  # what is known at the start has been told
        self._gap_s = 0.0  # since the last tick, beyond its period
        self._layout = Layout.of([p.name for p in plan.strings], [p.model.cells for p in plan.strings])
        self._mismatches = Mismatches(len(plan.strings))
        self.newest = Newest.nothing(sum(p.model.cells for p in plan.strings))
        self.strings = [
            StringEstimator.of(p, w, plan, self.newest, mine, Mismatch(self._mismatches, i))
            for i, (p, w, mine) in enumerate(zip(plan.strings, wires, self._layout.parts, strict=True))
        ]
        plain = [i for i, s in enumerate(self.strings) if not s.plan.model.effects]
        lengths = sorted({self.strings[i].plan.model.cells for i in plain})
        self._groups: list[Group] = []
        for n in lengths:
            members = [i for i in plain if self.strings[i].plan.model.cells == n]
            models = [self.strings[i].plan.model for i in members]
            observer = AdaptiveObserver(models, self._dt, plan.disturbance)
            self._groups.append(Group.of(self.strings, members, observer, self._dt))
            for j, i in enumerate(members):
                kept = self.strings[i].kept
                if kept is not None:
                    observer.set_parameters(j, kept.values, kept.names, kept.common, kept.own)
        for i, s in enumerate(self.strings):
            if s.plan.model.effects:
                own = _with_effects(s, self._dt, plan.disturbance)
                numbers = own.effect_numbers
                s.effects = tuple(Estimate(x.name, x.value, x.sd, x.unit, FIXED_OFFLINE) for x in numbers)
                self._groups.append(Group.of(self.strings, [i], own, self._dt))

    def step(self, readings: Readings, t1: int) -> TickResult:
        """Advance all strings by one tick that ends at `t1`, ns."""
        newest = self.newest
        newest.renew()
        surprise = np.empty(len(self.strings))
        told: dict[int, list[Event]] = {}
        jobs: list[tuple[int, Job]] = []
        if not self._introduced:
            self._introduced = True
            for i, s in enumerate(self.strings):
                told[i] = [Parameters(t1, s.plan.name, (*s.estimates, *s.effects))]
        for group in self._groups:
            surprise[group.rows] = self._step_group(group, readings, t1, jobs)
        for i in self._mismatches.take(surprise, self._dt):
            s = self.strings[i]
            level = Level.WARNING if s.mismatch.flag.level else Level.NOTICE
            told.setdefault(i, []).append(Notice(t1, level, "mismatch", s.mismatch.sentence(), s.plan.name))
        if t1 % ADOPT_NS == 0:
            for group in self._groups:
                for j in group.adopts:
                    self._adopt(group, j)
                    s = group.strings[j]
                    events = told.setdefault(group.members[j], [])
                    events.append(Parameters(t1, s.plan.name, (*s.estimates, *s.effects)))
                    events += _commissioned(s, t1)
        self._gap_s = 0.0
        all_cells = Estimated(t1, self._layout, newest.core, newest.core_sd, newest.surface, newest.quality)
        # told in the order of the plan, however the strings were grouped
        in_order = [e for i in sorted(told) for e in told[i]]
        return TickResult([all_cells, *in_order], sorted(jobs, key=itemgetter(0)))

    def _step_group(self, group: Group, readings: Readings, t1: int, jobs: list[tuple[int, Job]]) -> Floats:
        """Advance a group; how surprised each of its strings was. What it wants computed joins `jobs`."""
        dt, newest = self._dt, self.newest
        I, square, V, IV, _ = readings.means[:, group.rows]  # noqa: E741
        inlet, y, age = readings.inlet[group.rows], group.by_cell(readings.y), group.by_cell(readings.age)
        flow = None if group.nominal_flow is None else readings.flow[group.rows] / group.nominal_flow
        heat = group.unknown
        if group.voltage:
            of_each = zip(group.strings, I.tolist(), V.tolist(), IV.tolist(), strict=True)
            heat = np.array([s.heat(i, v, iv, dt) for s, i, v, iv in of_each])
        observer = group.observer
        if isinstance(observer, AdaptiveObserver):
            given = heat[:, None] * observer.share if group.voltage else None
            e = observer.step(square, given, inlet, y, age, flow)
        else:
            e = observer.step(group.strings[0].measured(readings[group.members[0]]), y[0], age[0])
            effective, shift = observer.effective
            square, inlet = np.where(np.isnan(square), nan, effective), inlet + shift
        core, core_sd, surface, quality = e.core, e.core_sd, e.surface, group.quality(readings)
        usable = core_sd <= AVAILABLE_SD_K
        if not usable.all():
            core, core_sd, surface = (np.where(usable, x, np.nan) for x in (core, core_sd, surface))
            quality = np.where(usable, quality, NOT_AVAILABLE)
        for row, values in (
            (newest.core, core),
            (newest.core_sd, core_sd),
            (newest.surface, surface),
            (newest.quality, quality),
        ):
            group.put(row, values)
        cells = [readings.cells[i] for i in group.members] if readings.cells else ()
        soc, since = readings.soc[group.rows], dt + self._gap_s
        tick = GroupTick(t1, since, square, heat, inlet, flow, I, soc, y, age, cells)
        jobs += [(group.members[j], job) for j, job in group.backlog.add(tick)]
        group.errors = e.errors
        return e.errors.mean_square()

    def errors(self) -> tuple[Floats, Floats]:
        """Tell what readings of all cells (N,) were off at the newest tick, and should be, K; NaN where unread."""
        value, sd = np.full((2, len(self.newest.core)), nan)
        for group in self._groups:
            if group.errors is not None:
                group.put(value, group.errors.on_cells(group.errors.value))
                group.put(sd, group.errors.on_cells(group.errors.sd))
        return value, sd

    def _adopt(self, group: Group, j: int) -> None:
        """Give the observer what the identifier knows now."""
        s = group.strings[j]
        cells = s.cells.numbers() if s.cells is not None else None
        if cells is not None and isinstance(group.observer, AdaptiveObserver):
            group.observer.set_parameters(j, cells.values, cells.names, cells.common, cells.own)
            s.estimates = s.known()
            return
        posterior = s.identifier.posterior()
        numbers = string_parameters(s.plan.model, posterior.names, posterior.mean)
        values = {name: getattr(numbers, name) for name in posterior.names}
        if isinstance(group.observer, AdaptiveObserver):
            own = None if s.kept is None else s.kept.own  # what is common scales the cells; how they differ stays
            group.observer.set_parameters(j, values, posterior.names, posterior.cov, own)
        else:
            group.observer.set_parameters(j, values, posterior.names, posterior.cov)
        s.estimates = s.known()

    def accept(self, string: int, job_result: object, now: int) -> list[Event]:
        """Take the result of a string's job into use."""
        s = self.strings[string]
        group, j = self._place(string)
        group.backlog.catch_up(j)  # what has waited belongs to what was known until now
        if isinstance(job_result, HealthResult):
            return [_told(change, s.plan.name, now) for change in s.health.accept(job_result, now)]
        if isinstance(job_result, CellResult) and s.cells is not None:
            return self._accept_cells(string, s.cells, job_result, now)
        s.identifier.accept(job_result)
        self._adopt(group, j)
        events: list[Event] = [Parameters(now, s.plan.name, (*s.estimates, *s.effects))]
        return [*events, *_commissioned(s, now)]

    def _accept_cells(self, string: int, cells: CellIdentifier, result: CellResult, now: int) -> list[Event]:
        s = self.strings[string]
        told = cells.warning
        cells.accept(result)
        self._adopt(*self._place(string))
        events: list[Event] = [Parameters(now, s.plan.name, s.estimates)]
        events.append(Notice(now, Level.INFO, "cells", sentence(result.fit), s.plan.name))
        if cells.warning and cells.warning != told:
            events.append(Notice(now, Level.WARNING, "skew", cells.warning, s.plan.name))
        if result.over and cells.numbers() is not None:
            base = baseline_of(s.plan.model)
            at = result.fit.layout.at("R_e")
            ln = None if base is None else base.mean[at] - base.mean[at].mean()
            found = s.health.fitted(np.log(result.fit.R_e), result.fit.rel_sd, ln)
            events += [_told(change, s.plan.name, now) for change in found]
        return events

    def pass_time(self, gap_s: float | None, *, unseen: bool = False) -> None:
        """Carry all over a time without frames (None: of unknown length); `unseen`: we were off, current may flow."""
        self._gap_s = RESTED_S if gap_s is None else gap_s
        for group in self._groups:
            if gap_s is None:
                group.observer.propagate_unknown()
            else:
                group.observer.propagate(gap_s, unseen=unseen)
        for s in self.strings:
            s.mismatch.resume()
            if s.voltage is not None:
                s.voltage.reset()

    def snapshot(self) -> dict[str, Any]:
        """State by string and by group of equal length, JSON-able."""
        strings = {
            s.plan.name: {
                "plan": _fingerprint(s.plan),
                "identifier": s.identifier.snapshot(),
                "health": s.health.snapshot(),
                "cells": None if s.cells is None else s.cells.snapshot(),
            }
            for s in self.strings
        }
        observers = [{"strings": self._names(g), "state": g.observer.snapshot()} for g in self._groups]
        return {"strings": strings, "observers": observers}

    def restore(self, state: Mapping[str, Any]) -> list[str]:
        """Take up a stored state as far as it belongs to this plan.

        Returns
        -------
        list of str
            What was left out and why, a sentence each.
        """
        same = set()
        for s in self.strings:
            stored = state["strings"].get(s.plan.name)
            if stored is None or stored["plan"] != _fingerprint(s.plan):
                continue
            s.identifier.restore(stored["identifier"])
            check_parameters(s.plan.name, s.identifier.posterior())
            if "health" in stored:  # states of before health had a memory of its own have none
                s.health.restore(stored["health"])
            if s.cells is not None and stored.get("cells") is not None:
                s.cells.restore(stored["cells"])
            s.estimates = s.known()
            same.add(s.plan.name)
        observers = {tuple(o["strings"]): o["state"] for o in state["observers"]}
        cold: set[str] = set()
        for g in self._groups:
            names = self._names(g)
            if tuple(names) in observers and same.issuperset(names):
                g.observer.restore(observers[tuple(names)])
                for name, P in zip(names, g.observer.covariances, strict=True):
                    check_covariance(name, "temperatures", P)
                check_temperatures(names, g.observer.estimate())
                continue
            cold.update(names)
            for j, name in enumerate(names):
                if name in same and not isinstance(self.strings[g.members[j]].identifier, FixedIdentifier):
                    self._adopt(g, j)
        return [
            f"{s.plan.name}: "
            + ("temperatures start anew" if s.plan.name in same else "new or changed, starts from its model file")
            for s in self.strings
            if s.plan.name in cold
        ]

    def _place(self, string: int) -> tuple[Group, int]:
        """Find a string's group, and its place there."""
        group = next(g for g in self._groups if string in g.members)
        return group, group.members.index(string)

    def _names(self, group: Group) -> list[str]:
        return [s.plan.name for s in group.strings]


def _told(change: Change, string: str, now: int) -> Notice:
    """Tell of a flag that has moved."""
    level = Level.WARNING if change.level else Level.NOTICE
    return Notice(now, level, change.code, change.text, string, change.cell)


def _commissioned(s: StringEstimator, now: int) -> list[Event]:
    """Let the health take the identifier's numbers for the baseline once they are known."""
    R_e = next(e for e in s.estimates if e.name == "R_e")
    p = s.identifier.posterior()
    if not s.health.offer(p.names, p.mean, p.cov, R_e.value, R_e.status == IDENTIFIED):
        return []
    s.health.history.note(now, "commissioned from the first drives")
    text = "commissioned: from now on growth of R_e is followed against the parameters identified so far"
    return [Notice(now, Level.INFO, "ageing", text, s.plan.name)]


def _with_effects(s: StringEstimator, dt: float, disturbance: Disturbance) -> "EffectObserver":
    from bms_gateway.observe.effects import (
        EffectObserver,
    )  # the catalogue doubles the time of a start: only who needs it

    return EffectObserver(s.plan.model, dt, disturbance, soc=s.wire.constants.get("soc", SOC_UNKNOWN))


def _fingerprint(plan: StringPlan) -> str:
    """Sum up what a stored state must agree with: the model file and the method."""
    m = plan.model
    priors = {k: (np.asarray(p.value).tolist(), p.rel_sd) for k, p in sorted(m.priors.items())}
    text = repr((m.cells, m.sensors, m.condition, m.coolant, m.flow, priors, plan.identify))
    if m.commissioning is not None:
        text += repr((m.commissioning.names, m.commissioning.rel_sd.tolist(), m.commissioning.electrical.tolist()))
    for e in m.effects:
        text += repr((e.key, sorted(e.values.items()), sorted(e.sd.items())))
    return sha256(text.encode()).hexdigest()[:16]
