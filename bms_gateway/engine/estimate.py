"""All strings' estimators side by side: observers stacked by string length, an identifier and the health of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from bms_gateway.engine.events import Estimated, Event, Job, Level, Notice, Parameters
from bms_gateway.engine.group import Group, mean_squares, quality_of
from bms_gateway.engine.inputs import Reading, Wire
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.plausible import check_covariance, check_parameters, check_temperatures
from bms_gateway.engine.string import StringEstimator
from bms_gateway.frames.quality import Quality
from bms_gateway.health import Change, HealthResult
from bms_gateway.identify import (
    Estimate,
    FixedIdentifier,
    Tick,
    string_parameters,
)
from bms_gateway.identify.cell_kept import baseline_of
from bms_gateway.identify.cell_live import CellIdentifier, CellResult
from bms_gateway.identify.cells_in_words import sentence
from bms_gateway.identify.contract import FIXED_OFFLINE, IDENTIFIED
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe import Estimate as States
from bms_gateway.observe.measured import SOC_UNKNOWN
from bms_gateway.observe.unseen import RESTED_S
from bms_gateway.thermal import Disturbance

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
        self.strings = [StringEstimator.of(p, w, plan) for p, w in zip(plan.strings, wires, strict=True)]
        plain = [i for i, s in enumerate(self.strings) if not s.plan.model.effects]
        lengths = sorted({self.strings[i].plan.model.cells for i in plain})
        self._groups = []
        for n in lengths:
            members = [i for i in plain if self.strings[i].plan.model.cells == n]
            models = [self.strings[i].plan.model for i in members]
            observer = AdaptiveObserver(models, self._dt, plan.disturbance)
            self._groups.append(Group.of(self.strings, members, observer))
            for j, i in enumerate(members):
                kept = self.strings[i].kept
                if kept is not None:
                    observer.set_parameters(j, kept.values, kept.names, kept.common, kept.own)
        for i, s in enumerate(self.strings):
            if s.plan.model.effects:
                own = _with_effects(s, self._dt, plan.disturbance)
                numbers = own.effect_numbers
                s.effects = tuple(Estimate(x.name, x.value, x.sd, x.unit, FIXED_OFFLINE) for x in numbers)
                self._groups.append(Group.of(self.strings, [i], own))

    def step(self, readings: Sequence[Reading], t1: int) -> TickResult:
        """Advance all strings by one tick that ends at `t1`, ns."""
        events: list[list[Event]] = [[] for _ in self.strings]
        jobs: list[tuple[int, Job]] = []
        if not self._introduced:
            self._introduced = True
            for s, told in zip(self.strings, events, strict=True):
                told.append(Parameters(t1, s.plan.name, (*s.estimates, *s.effects)))
        for group in self._groups:
            self._step_group(group, [readings[i] for i in group.members], t1, events, jobs)
        self._gap_s = 0.0
        # told in the order of the plan, however the strings were grouped
        return TickResult([e for told in events for e in told], sorted(jobs, key=itemgetter(0)))

    def _step_group(
        self, group: Group, readings: list[Reading], t1: int, events: list[list[Event]], jobs: list[tuple[int, Job]]
    ) -> None:
        dt, n = self._dt, group.cells
        strings = [self.strings[i] for i in group.members]
        flow = [s.flow_ratio(r) for s, r in zip(strings, readings, strict=True)] if group.flow else group.unknown
        heat = [s.heat(r, dt) for s, r in zip(strings, readings, strict=True)] if group.voltage else group.unknown
        e = self._observe(group, strings, readings, heat, flow)
        core, core_sd, surface, quality = e.core, e.core_sd, e.surface, quality_of(readings, n)
        usable = core_sd <= AVAILABLE_SD_K
        if not usable.all():
            core, core_sd, surface = (np.where(usable, x, np.nan) for x in (core, core_sd, surface))
            quality = np.where(usable, quality, NOT_AVAILABLE)
        surprise = mean_squares(e.innovation, e.innovation_sd)
        I2, inlet = [r.means.I2 for r in readings], [r.inlet for r in readings]
        if not isinstance(group.observer, AdaptiveObserver):
            effective, shift = group.observer.effective
            I2, inlet = [effective if x == x else x for x in I2], [x + shift for x in inlet]
        since, adopts = dt + self._gap_s, t1 % ADOPT_NS == 0
        for j, (i, s, r) in enumerate(zip(group.members, strings, readings, strict=True)):
            s.core, s.core_sd, s.surface, s.quality = core[j], core_sd[j], surface[j], quality[j]
            s.innovation, s.innovation_sd = e.innovation[j], e.innovation_sd[j]
            told, name = events[i], s.plan.name
            told.append(Estimated(t1, name, s.core, s.core_sd, s.surface, s.quality))
            if s.mismatch.take(surprise[j], dt):
                level = Level.WARNING if s.mismatch.flag.level else Level.NOTICE
                told.append(Notice(t1, level, "mismatch", s.mismatch.sentence(), name))
            tick = Tick(t1, since, I2[j], heat[j], inlet[j], r.y, r.age)
            if wanted := s.learn(tick, r, flow[j]):
                jobs += [(i, job) for job in wanted]
            if adopts and s.plan.identify == "rls" and not s.plan.model.effects:
                self._adopt(group, j)
                told.append(Parameters(t1, name, (*s.estimates, *s.effects)))
                told += _commissioned(s, t1)

    @staticmethod
    def _observe(
        group: Group,
        strings: Sequence[StringEstimator],
        readings: Sequence[Reading],
        heat: Sequence[float],
        flow: Sequence[float],
    ) -> States:
        observer, shape = group.observer, (len(strings), group.cells)
        if not isinstance(observer, AdaptiveObserver):
            return observer.step(strings[0].measured(readings[0]), readings[0].y, readings[0].age)
        return observer.step(
            np.array([r.means.I2 for r in readings]),
            np.array(heat)[:, None] * observer.share if group.voltage else None,
            np.array([r.inlet for r in readings]),
            np.concatenate([r.y for r in readings]).reshape(shape),
            np.concatenate([r.age for r in readings]).reshape(shape),
            np.array(flow) if group.flow else None,
        )

    def _adopt(self, group: Group, j: int) -> None:
        """Give the observer what the identifier knows now."""
        s = self.strings[group.members[j]]
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
        if isinstance(job_result, HealthResult):
            return [_told(change, s.plan.name, now) for change in s.health.accept(job_result, now)]
        if isinstance(job_result, CellResult) and s.cells is not None:
            return self._accept_cells(string, s.cells, job_result, now)
        s.identifier.accept(job_result)
        group = next(g for g in self._groups if string in g.members)
        self._adopt(group, group.members.index(string))
        events: list[Event] = [Parameters(now, s.plan.name, (*s.estimates, *s.effects))]
        return [*events, *_commissioned(s, now)]

    def _accept_cells(self, string: int, cells: CellIdentifier, result: CellResult, now: int) -> list[Event]:
        s = self.strings[string]
        told = cells.warning
        cells.accept(result)
        group = next(g for g in self._groups if string in g.members)
        self._adopt(group, group.members.index(string))
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

    def _names(self, group: Group) -> list[str]:
        return [self.strings[i].plan.name for i in group.members]


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
