"""All strings' estimators side by side: observers stacked by string length, an identifier and the health of each."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import nan
from operator import itemgetter
from typing import Any

import numpy as np

from bms_gateway.engine.backlog import GroupTick
from bms_gateway.engine.core_floor import Step
from bms_gateway.engine.events import Estimated, Event, Job, Level, Notice, Parameters
from bms_gateway.engine.forecast import Forecasts
from bms_gateway.engine.group import Group
from bms_gateway.engine.observed import Driven, StringWithEffects, kind_of, plain_strings
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.plausible import check_covariance, check_numbers, check_parameters, check_temperatures
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.engine.string_estimator import Newest, StringEstimator, unproven
from bms_gateway.engine.wiring import Wire
from bms_gateway.errors import OtherStatesError
from bms_gateway.frames.quality import AVAILABLE_SD_K, Quality
from bms_gateway.health import Change, HealthResult, Mismatch, Mismatches
from bms_gateway.health.heat import Finding
from bms_gateway.health.heat.heat_tick import HeatTick
from bms_gateway.identify.cell_kept import baseline_of
from bms_gateway.identify.cell_live import CellIdentifier, CellResult
from bms_gateway.identify.cells_in_words import sentence
from bms_gateway.identify.contract import IDENTIFIED
from bms_gateway.identify.doubt import HOPELESS
from bms_gateway.observe.unseen import RESTED_S
from bms_gateway.thermal import Floats

GOOD, NOT_AVAILABLE = (np.uint8(q) for q in (Quality.GOOD, Quality.NOT_AVAILABLE))  # numpy compares its own type faster
ABOVE_K = 0.3
"""K, three times the noise of a thermocouple: a good reading replaces the hottest point if it exceeds it by more."""
BEFORE_S, ALL_S = 30.0, 1e5
"""s: the onset of a fault is known to a few steps of the watch; longer than any window."""
ADOPT_NS = 60_000_000_000  # the recursive method changes at every tick; the observer need not follow each time


@dataclass(slots=True)
class TickResult:
    """Results of a tick besides the estimates: events, and jobs with their string."""

    events: list[Event] = field(default_factory=list)
    jobs: list[tuple[int, Job]] = field(default_factory=list)


class Estimators:
    """Estimators of a plan.

    Parameters
    ----------
    plan : Plan
    wires : sequence of Wire
        One per string.

    Attributes
    ----------
    strings : list of StringEstimator
        In the order of the plan.
    groups : list of Group
        Strings that are computed together.
    mismatches : Mismatches
        Agreement of each string's readings with its model.
    newest : Newest
        Results for all cells at the newest tick.
    """

    def __init__(self, plan: Plan, wires: Sequence[Wire]) -> None:
        self._dt = plan.tick_ns * 1e-9
        self._introduced = False  # whether the parameters known at the start have been reported
        self._gap_s = 0.0  # time since the last tick, beyond the period of ticks
        self._layout = Layout.of([p.name for p in plan.strings], [p.model.cells for p in plan.strings])
        self.mismatches = Mismatches(len(plan.strings))
        self.newest = Newest.nothing(sum(p.model.cells for p in plan.strings))
        self.strings = [
            StringEstimator.of(p, w, plan, self.newest, mine, Mismatch(self.mismatches, i))
            for i, (p, w, mine) in enumerate(zip(plan.strings, wires, self._layout.parts, strict=True))
        ]
        plain = [i for i, s in enumerate(self.strings) if not s.plan.model.effects]
        self.groups: list[Group] = []
        kinds = {i: kind_of(self.strings[i].plan) for i in plain}
        for kind in sorted(set(kinds.values())):
            members = [i for i in plain if kinds[i] == kind]
            stacked = plain_strings(self.strings, members, self._dt, plan.disturbance)
            self.groups.append(Group.of(self.strings, members, stacked, self._dt))
        for i, s in enumerate(self.strings):
            if s.plan.model.effects:
                own = StringWithEffects.of(s, i, self._dt, plan.disturbance)
                self.groups.append(Group.of(self.strings, [i], own, self._dt))
        for group in self.groups:
            for j, s in enumerate(group.strings):
                if s.kept is not None:
                    group.reveal(j)
        self.forecasts = Forecasts(self.groups, self.strings, plan.alerts.core_max_C)

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
                told[i] = [Parameters(t1, s.plan.name, (*s.estimates, *s.effects), s.constant), *_proven(s, False, t1)]
        found: list[tuple[int, Finding]] = []
        for group in self.groups:
            surprise[group.rows] = self._step_group(group, readings, t1, jobs, found)
        for i, f in found:
            s = self.strings[i]
            told.setdefault(i, []).append(_found(f, s.plan.name, t1))
        for i in self.mismatches.take(surprise, self._dt):
            s = self.strings[i]
            level = Level.WARNING if s.mismatch.flag.level else Level.NOTICE
            told.setdefault(i, []).append(Notice(t1, level, "mismatch", s.mismatch.sentence(), s.plan.name))
        for i, change in self._discharges(readings, t1):
            told.setdefault(i, []).append(_told(change, self.strings[i].plan.name, t1))
        if t1 % ADOPT_NS == 0:
            self._adopt_all(told, t1)
        self._gap_s = 0.0
        foreseen = self.forecasts.take(readings, t1)
        numbers = newest.core, newest.core_sd, newest.surface, newest.quality, newest.centre, newest.centre_sd
        heats = newest.heat, newest.heat_sd
        all_cells = Estimated(t1, self._layout, *numbers, *heats)
        # reported in the order of the plan, whatever the groups are
        in_order = [e for i in sorted(told) for e in told[i]]
        if foreseen is not None:
            in_order.append(foreseen)
        return TickResult([all_cells, *in_order], sorted(jobs, key=itemgetter(0)))

    def _adopt_all(self, told: dict[int, list[Event]], t1: int) -> None:
        """Give the observers the present numbers of the recursive methods."""
        for group in self.groups:
            for j in group.adopts:
                self._adopt(group, j)
                s = group.strings[j]
                events = told.setdefault(group.members[j], [])
                events.append(Parameters(t1, s.plan.name, (*s.estimates, *s.effects), s.constant))
                events += _commissioned(s, t1)

    def _step_group(
        self,
        group: Group,
        readings: Readings,
        t1: int,
        jobs: list[tuple[int, Job]],
        found: list[tuple[int, Finding]],
    ) -> Floats:
        """Advance a group; return the agreement of each of its strings with its model.

        Jobs of the group are added to `jobs`, findings of the watch over heat to `found`.
        """
        dt, newest = self._dt, self.newest
        I, I2, V, IV, _ = readings.means[:, group.rows]  # noqa: E741
        inlet, y, age = readings.inlet[group.rows], group.by_cell(readings.y), group.by_cell(readings.age)
        believed = group.believed(y)
        flow = None if group.nominal_flow is None else readings.slow["coolant_flow"][group.rows] / group.nominal_flow
        heat = group.unknown
        if group.voltage:
            of_each = zip(group.strings, I.tolist(), V.tolist(), IV.tolist(), strict=True)
            heat = group.heat = np.array([s.heat(i, v, iv, dt) for s, i, v, iv in of_each])
        measured = Driven(I2, I, heat, inlet, flow)
        of = None if (some := readings.several) is None else (group.by_cell(some[0]), group.by_cell(some[1]))
        e = group.observed.step(readings, measured, believed, age, of)
        square, inlet = group.observed.plainly(measured)
        heating = square * group.observed.by_warmth()  # with R_e where it is known; identifiers find B themselves
        core, core_sd, surface, centre, centre_sd = e.core, e.core_sd, e.surface, e.centre, e.centre_sd
        if group.watch is not None:
            square_seen, inlet_seen = (I2, measured.inlet) if group.observed.shares else (heating, inlet)
            tick = HeatTick(square_seen, I, inlet_seen, y, age, flow, heat)
            core, core_sd = self._watched(group, t1, tick, (core, core_sd), found)
            if core is not e.core:  # sensor fault, or heat of the cell: the warmer value counts
                known = np.isfinite(e.core_sd)
                more = np.where(known, core_sd, 0.0) ** 2 - np.where(known, e.core_sd, 0.0) ** 2
                # the band also contains the cooler value
                cooler = np.fmax(e.core - core, 0.0)
                centre, centre_sd = centre + np.maximum(core - e.core, 0.0), np.sqrt(centre_sd**2 + more + cooler**2)
        felt = y > centre + ABOVE_K
        if felt.any():  # an accepted reading is the temperature of a point of the cell
            centre = np.where(felt, y, centre)
        cold = group.floor.below(Step(core, e.core_sd, surface, inlet, I, heating, dt))
        own = group.quality(readings)
        quality = group.doubtful(own, cold)
        core_sd, centre_sd = (group.widened(sd, x - surface) for sd, x in ((core_sd, core), (centre_sd, centre)))
        usable = core_sd <= AVAILABLE_SD_K
        if (burnt := group.burnt(own)) is not None:
            usable &= ~burnt
        if not usable.all():
            newest.withhold(group.put, usable, core, centre, centre_sd)
            core, core_sd, surface, centre, centre_sd = (
                np.where(usable, x, np.nan) for x in (core, core_sd, surface, centre, centre_sd)
            )
            quality = np.where(usable, quality, NOT_AVAILABLE)
        unknown = ~usable & (own == GOOD)
        if unknown.any() or group.contradicted.unknown_s.any():
            group.put(newest.contradicted, group.contradicted.take(unknown, group.observed.own(e), dt))
        for row, values in (
            (newest.core, core),
            (newest.core_sd, core_sd),
            (newest.surface, surface),
            (newest.quality, quality),
            (newest.centre, centre),
            (newest.centre_sd, centre_sd),
        ):
            group.put(row, values)
        cells = [readings.cells[i] for i in group.members] if readings.cells else ()
        soc, since = readings.slow["soc"][group.rows], dt + self._gap_s
        heard = GroupTick(t1, since, square, heat, inlet, flow, I, soc, group.learnt(believed, t1), age, cells)
        jobs += [(group.members[j], job) for j, job in group.backlog.add(heard)]
        group.errors = e.errors
        return e.errors.mean_square()

    def _watched(
        self,
        group: Group,
        t1: int,
        tick: HeatTick,
        cores: tuple[Floats, Floats],
        found: list[tuple[int, Finding]],
    ) -> tuple[Floats, Floats]:
        """Give a tick to the watch over heat, and use its cores if it has accepted a fault: they are then better."""
        assert group.watch is not None  # noqa: S101 - who calls has looked
        watch = group.watch
        new = watch.add(t1, tick)
        if new is not None:
            found += [(group.members[j], f) for j, f in new]
            for s, v in zip(group.strings, watch.verdicts, strict=True):
                s.health.heat = v.findings
                v.burning = s.burning
            _disbelieve(group, t1, new)
            # holders of the last arrays keep them unchanged
            heats = self.newest.heat.copy(), self.newest.heat_sd.copy()
            group.put(heats[0], watch.told.heat)
            group.put(heats[1], watch.told.heat_sd)
            self.newest.heat, self.newest.heat_sd = heats
        return watch.cores(*cores)

    def _discharges(self, readings: Readings, t1: int) -> Iterator[tuple[int, Change]]:
        """Check strings with voltages of single cells for self-discharge."""
        for i, s in enumerate(self.strings):
            if s.health.self_discharge is None:
                continue
            pairs = readings.cells[i] if readings.cells else None
            current = float(readings.means[0, i])
            volts = None if pairs is None else pairs.V
            for change in s.health.discharges(t1, current, current * self._dt / 3600.0, volts):
                yield i, change

    def errors(self) -> tuple[Floats, Floats]:
        """Return errors of readings (N,) at the newest tick and their expected sd, K; NaN without a reading."""
        value, sd = np.full((2, len(self.newest.core)), nan)
        for group in self.groups:
            if group.errors is not None:
                group.put(value, group.errors.on_cells(group.errors.value))
                group.put(sd, group.errors.on_cells(group.errors.sd))
        return value, sd

    def _adopt(self, group: Group, j: int) -> None:
        """Give the observer the present numbers of the identifier."""
        s = group.strings[j]
        observer = group.observed.observer
        cells = s.cells.numbers() if s.cells is not None and not s.identifier.doubts() else None
        if cells is not None:
            observer.set_parameters(j, cells.values, cells.names, cells.common, cells.own)
        else:
            own = None if s.kept is None else s.kept.own  # the common part scales all cells; their differences stay
            known = s.identifier.posterior().for_observer(s.plan.model)
            observer.set_parameters(j, *known, own)
        group.reveal(j)
        s.estimates = s.known()

    def accept(self, string: int, job_result: object, now: int) -> list[Event]:
        """Apply the result of a string's job."""
        s = self.strings[string]
        group, j = self.place(string)
        group.backlog.catch_up(j)  # the waiting ticks belong to the parameters that were known until now
        if isinstance(job_result, HealthResult):
            return [_told(change, s.plan.name, now) for change in s.health.accept(job_result, now)]
        if isinstance(job_result, CellResult) and s.cells is not None:
            return self._accept_cells(string, s.cells, job_result, now)
        before = s.doubts
        s.identifier.accept(job_result)
        self._adopt(group, j)
        events: list[Event] = [Parameters(now, s.plan.name, (*s.estimates, *s.effects), s.constant)]
        return [*events, *_commissioned(s, now), *_proven(s, bool(before), now)]

    def _accept_cells(self, string: int, cells: CellIdentifier, result: CellResult, now: int) -> list[Event]:
        s = self.strings[string]
        told = cells.warning
        cells.accept(result)
        self._adopt(*self.place(string))
        events: list[Event] = [Parameters(now, s.plan.name, s.estimates, s.constant)]
        events.append(Notice(now, Level.INFO, "cells", sentence(result.fit), s.plan.name))
        if cells.warning and cells.warning != told:
            events.append(Notice(now, Level.WARNING, "skew", cells.warning, s.plan.name))
        if result.over and result.fit.doubt <= HOPELESS and cells.numbers() is not None:
            base = baseline_of(s.plan.model)
            at = result.fit.layout.at("R_e")
            ln = None if base is None else base.mean[at] - base.mean[at].mean()
            found = s.health.fitted(np.log(result.fit.R_e), result.fit.rel_sd, ln)
            events += [_told(change, s.plan.name, now) for change in found]
        return events

    def pass_time(self, gap_s: float | None, *, unseen: bool = False) -> None:
        """Carry all strings over a time without frames (None: of unknown length); `unseen`: current may have flowed."""
        self._gap_s = RESTED_S if gap_s is None else gap_s
        self.forecasts.forget()
        for group in self.groups:
            group.floor.forget()
            if gap_s is None:
                group.observed.observer.propagate_unknown()
            else:
                group.observed.observer.propagate(gap_s, unseen=unseen)
            if group.watch is not None:
                group.watch.pass_time(gap_s, unseen=unseen)
        for s in self.strings:
            s.mismatch.resume()
            if s.health.self_discharge is not None:
                s.health.self_discharge.pass_time(gap_s)
            if s.voltage is not None:
                s.voltage.reset()

    def snapshot(self) -> dict[str, Any]:
        """State by string and by group of equal length, JSON-able."""
        strings = {
            s.plan.name: {
                "plan": fingerprint(s.plan),
                "identifier": s.identifier.snapshot(),
                "health": s.health.snapshot(),
                "cells": None if s.cells is None else s.cells.snapshot(),
            }
            for s in self.strings
        }
        observers = [
            {
                "strings": self._names(g),
                "state": g.observed.observer.snapshot(),
                "heat": None if g.watch is None else g.watch.snapshot(),
            }
            for g in self.groups
        ]
        return {"strings": strings, "observers": observers, "forecasts": self.forecasts.snapshot()}

    def restore(self, state: Mapping[str, Any]) -> list[str]:
        """Restore a stored state as far as it belongs to this plan.

        Returns
        -------
        list of str
            One sentence for each part that was left out, with the reason.
        """
        same = set()
        for s in self.strings:
            stored = state["strings"].get(s.plan.name)
            if stored is None or stored["plan"] != fingerprint(s.plan):
                continue
            s.identifier.restore(stored["identifier"])
            check_parameters(s.plan.name, s.identifier.posterior())
            if "health" in stored:  # states of older versions have no health
                s.health.restore(stored["health"])
            if s.cells is not None and stored.get("cells") is not None:
                s.cells.restore(stored["cells"])
            s.estimates = s.known()
            same.add(s.plan.name)
        self.forecasts.restore(state.get("forecasts"), same)
        observers = {tuple(o["strings"]): o["state"] for o in state["observers"]}
        heats = {tuple(o["strings"]): o.get("heat") for o in state["observers"]}  # states of older versions have none
        cold: set[str] = set()
        for g in self.groups:
            names = self._names(g)
            if tuple(names) in observers and same.issuperset(names) and _taken_up(g, observers[tuple(names)]):
                seen = g.observed.observer
                for name, P, numbers in zip(names, seen.covariances, seen.parameters, strict=True):
                    check_numbers(name, numbers)
                    check_covariance(name, "temperatures", P)
                check_temperatures(names, g.observed.observer.estimate())
                g.resume(heats[tuple(names)])
                continue
            cold.update(names)
            for j, name in enumerate(names):
                if name in same and self.strings[g.members[j]].identifier.learns:
                    self._adopt(g, j)
        return [
            f"{s.plan.name}: "
            + ("temperatures start anew" if s.plan.name in same else "new or changed, starts from its model file")
            for s in self.strings
            if s.plan.name in cold
        ]

    def place(self, string: int) -> tuple[Group, int]:
        """Return a string's group, and its place there."""
        group = next(g for g in self.groups if string in g.members)
        return group, group.members.index(string)

    def _names(self, group: Group) -> list[str]:
        return [s.plan.name for s in group.strings]


def _taken_up(group: Group, state: Mapping[str, Any]) -> bool:
    """Restore an observer from its stored state; return False for a state of another form: it then starts anew."""
    try:
        group.observed.observer.restore(state)
    except OtherStatesError:
        return False
    return True


def _found(f: Finding, string: str, now: int) -> Notice:
    """Make the notice of a finding of the watch over heat that is new or has ended."""
    return Notice(now, Level.WARNING if f.level else Level.NOTICE, f.code, f.text, string, f.cell)


def _told(change: Change, string: str, now: int) -> Notice:
    """Make the notice of a flag whose level has changed."""
    level = Level.WARNING if change.level else Level.NOTICE
    return Notice(now, level, change.code, change.text, string, change.cell)


def _proven(s: StringEstimator, doubted: bool, now: int) -> list[Event]:
    """Make the notice that a string's cores are no longer proven, or are proven again."""
    if bool(s.doubts) == doubted:
        return []
    if s.doubts:
        return [Notice(now, Level.WARNING, "unproven", unproven(s.doubts), s.plan.name)]
    return [
        Notice(now, Level.NOTICE, "unproven", "the model explains the surfaces: cores are proven again", s.plan.name)
    ]


def _commissioned(s: StringEstimator, now: int) -> list[Event]:
    """Give the identified numbers to the health as its baseline as soon as they are known."""
    R_e = next(e for e in s.estimates if e.name == "R_e")
    p = s.identifier.posterior()
    if not s.health.offer(p.names, p.mean, p.cov, R_e.value, R_e.status == IDENTIFIED):
        return []
    s.health.history.note(now, "commissioned from the first drives")
    text = "commissioned: from now on growth of R_e is followed against the parameters identified so far"
    return [Notice(now, Level.INFO, "ageing", text, s.plan.name)]


def fingerprint(plan: StringPlan) -> str:
    """Digest of what a stored state must agree with: the model file and the method."""
    m = plan.model
    priors = {k: (np.asarray(p.value).tolist(), p.rel_sd) for k, p in sorted(m.priors.items())}
    text = repr((m.cells, m.sensors, m.condition, m.coolant, m.flow, priors, plan.identify))
    if m.commissioning is not None:
        text += repr((m.commissioning.names, m.commissioning.rel_sd.tolist(), m.commissioning.electrical.tolist()))
    for e in m.effects:
        text += repr((e.key, sorted(e.values.items()), sorted(e.sd.items())))
    return sha256(text.encode()).hexdigest()[:16]


def _disbelieve(group: Group, now_ns: int, found: list[tuple[int, Finding]]) -> None:
    """Take readings back from the windows: of wrong thermocouples since their fault, of cells that heat altogether."""
    for j, f in found:
        s, heats = group.strings[j], f.code == "unexplained_heat"
        if not f.level or f.cell is None or not (heats or f.code == "thermocouple"):
            continue
        if group.does_without(j, s.wrong + s.heating):
            group.backlog.catch_up(j)
            # weak heat is found late, and its beginning is not known
            s.disbelieve(f.cell - 1, ALL_S if heats else (now_ns - f.since_ns) * 1e-9 + BEFORE_S)
