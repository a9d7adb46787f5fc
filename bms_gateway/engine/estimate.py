"""All strings' estimators side by side: observers stacked by string length, an identifier and the health of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.events import Estimated, Event, Job, Level, Notice, Parameters
from bms_gateway.engine.inputs import Reading, Wire, identifies_cells
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.plausible import check_covariance, check_parameters, check_temperatures
from bms_gateway.frames.quality import Quality
from bms_gateway.health import Ageing, Change, HealthResult, Mismatch, StringHealth
from bms_gateway.identify import (
    Estimate,
    FixedIdentifier,
    Identifier,
    Tick,
    VoltageHeat,
    VoltageTracker,
    build,
    string_parameters,
)
from bms_gateway.identify.cell_kept import baseline_of, numbers_kept
from bms_gateway.identify.cell_live import CellIdentifier, CellResult
from bms_gateway.identify.cell_resistance import CellNumbers
from bms_gateway.identify.cells_in_words import sentence
from bms_gateway.identify.contract import FIXED_AT_COMMISSIONING, FIXED_OFFLINE, IDENTIFIED, LEARNING
from bms_gateway.observe import AdaptiveObserver, Measured
from bms_gateway.observe import Estimate as States
from bms_gateway.observe.measured import SOC_UNKNOWN
from bms_gateway.observe.unseen import RESTED_S
from bms_gateway.thermal import KINDS, Disturbance, Floats

if TYPE_CHECKING:
    from bms_gateway.observe.effects import EffectObserver

# of numpy's own type, which it compares much faster than members of an enumeration
GOOD, STALE, NOT_AVAILABLE, ESTIMATED, NEVER = (
    np.uint8(q) for q in (Quality.GOOD, Quality.STALE, Quality.NOT_AVAILABLE, Quality.ESTIMATED, Quality.NEVER)
)
AVAILABLE_SD_K = 12.0
"""A core known no better than this is sent as not available: no decision can be built on it, and the DBC ends there."""


ADOPT_NS = 60_000_000_000  # the recursive method moves with every tick; the observer's matrices need not
GOOD_SD = 0.1  # relative; an electrical resistance known worse than this is still being learnt
CELL_V = (2.0, 4.6)  # V: lithium-ion, empty to full; a string's voltage shared out is not below
CAPACITY_AH = 8.0  # where the model file does not say; the voltage's slope needs its order of magnitude only


FLAG_NAMES = {
    "ageing": ("", "R_e_watch", "R_e_warning", "R_e_alarm"),
    "cooling": ("", "cooling_warning", "cooling_alarm"),
    "thermocouple": ("", "thermocouple_warning", "thermocouple_alarm"),
    "current": ("", "current_suspected", "current_confirmed"),
    "mismatch": ("", "mismatch_suspected", "mismatch_confirmed"),
}
"""Names of raised flags by their word and level."""


@dataclass(slots=True)
class StringEstimator:
    """What belongs to one string alone; the observer is shared by its group.

    Attributes
    ----------
    core, core_sd, surface : ndarray (n,)
        Newest estimate, °C, K, °C; NaN where not available.
    quality : ndarray of uint8 (n,)
    innovation, innovation_sd : ndarray (n,)
        Of the newest tick, K; NaN for cells without a reading.
    estimates : tuple of Estimate
        Parameters of the string.
    effects : tuple of Estimate
        Numbers of its model's effects, `key.parameter`.
    health : StringHealth
        With `ageing` and `mismatch`, which are what is asked for most.
    kept : CellNumbers or None
        What a commissioning run left in its model.
    """

    plan: StringPlan
    wire: Wire
    identifier: Identifier
    voltage: VoltageTracker | None
    core: Floats
    core_sd: Floats
    surface: Floats
    quality: NDArray[np.uint8]
    health: StringHealth
    ageing: Ageing = field(init=False)
    mismatch: Mismatch = field(init=False)
    innovation: Floats = field(init=False)
    innovation_sd: Floats = field(init=False)
    estimates: tuple[Estimate, ...] = ()
    effects: tuple[Estimate, ...] = ()
    electrical: VoltageHeat | None = None
    cells: CellIdentifier | None = None
    kept: CellNumbers | None = None

    def __post_init__(self) -> None:
        self.ageing, self.mismatch = self.health.ageing, self.health.mismatch
        self.innovation = self.innovation_sd = np.full(self.plan.model.cells, np.nan)

    @classmethod
    def of(cls, plan: StringPlan, wire: Wire, whole: Plan) -> "StringEstimator":
        """Build from the plan, knowing nothing yet."""
        identifier = build(plan.identify, plan.model)
        n = plan.model.cells
        nothing = np.full(n, np.nan)
        cells = CellIdentifier(plan.model, whole.disturbance, whole.cells) if _hears_cells(plan, wire) else None
        own = cls(
            plan,
            wire,
            identifier,
            # a model with effects says itself where the heat comes from
            VoltageTracker(plan.model.capacity_Ah or CAPACITY_AH, n)
            if wire.voltage >= 0 and not plan.model.effects
            else None,
            nothing,
            nothing,
            nothing,
            np.full(n, NEVER),
            health_of(plan, identifier),
            cells=cells,
            kept=numbers_kept(plan.model),
        )
        own.estimates = own.known()
        return own

    @property
    def flags(self) -> tuple[str, ...]:
        """Raised flags by name, as in the summary of an analysis."""
        raised = (
            FLAG_NAMES[c.code][c.level] + (f":{c.cell}" if c.cell is not None else "") for c in self.health.conditions()
        )
        return tuple(raised)

    def resistance(self) -> float:
        """Electrical resistance of a mean cell, Ω, where its voltage tells it well; else NaN."""
        if self.electrical is None:
            return nan
        R, sd = self.electrical.resistance, self.electrical.resistance_sd
        return R / self.plan.model.cells if R > 0.0 and sd < GOOD_SD * R else nan

    def heat(self, reading: Reading, dt: float) -> float:
        """Mean heat of one cell from current and voltage, W; NaN while the open-circuit voltage is not known."""
        if self.voltage is None:
            return nan
        m = reading.means
        self.electrical = self.voltage.update(m.I, m.V, m.IV, dt)
        return self.electrical.heat / self.plan.model.cells

    def known(self) -> tuple[Estimate, ...]:
        """Parameters as the identifiers have them; R_e from the voltage where that makes the heat."""
        common = self.identifier.estimates()
        found = common + ((self.cells.estimates() if self.cells is not None else ()) or self._as_kept(common))
        if self.electrical is None or self.electrical.heat != self.electrical.heat:
            return found
        n = self.plan.model.cells
        R, sd = self.electrical.resistance / n, self.electrical.resistance_sd / n
        sound = self.resistance() == R
        electrical = Estimate("R_e", R, sd, KINDS["R_e"].unit, IDENTIFIED if sound else LEARNING)
        return tuple(electrical if e.name == "R_e" else e for e in found)

    def _as_kept(self, common: tuple[Estimate, ...]) -> tuple[Estimate, ...]:
        """R_e of each cell as told apart at commissioning: all go with what is common to them."""
        if self.kept is None:
            return ()
        now, R = next(e for e in common if e.name == "R_e"), np.asarray(self.kept.values["R_e"])
        value = now.value * R / np.exp(np.mean(np.log(R)))
        sd = value * np.hypot(now.sd / now.value, np.sqrt(self.kept.own[:, 0, 0]))
        unit = KINDS["R_e"].unit
        each = enumerate(zip(value.tolist(), sd.tolist(), strict=True), start=1)
        return tuple(Estimate(f"R_e_{k}", x, spread, unit, FIXED_AT_COMMISSIONING) for k, (x, spread) in each)

    def flow_ratio(self, reading: Reading) -> float:
        """Coolant flow over the model's nominal flow; NaN where either is unknown."""
        nominal = self.plan.model.flow
        return reading.flow / nominal if nominal else float("nan")

    def measured(self, reading: Reading) -> Measured:
        """Gather what the observer of a string with effects takes in at a tick."""
        m, n = reading.means, self.plan.model.cells
        if n > 1 and m.V / n < CELL_V[0] <= m.V <= CELL_V[1]:
            n = 1  # the mean of the cells' voltages, as offline
        return Measured(m.I, m.I2, m.I_abs, reading.inlet, self.flow_ratio(reading), reading.soc, m.V / n, m.IV / n)


@dataclass(slots=True)
class Group:
    """Strings with equal numbers of cells and the observer that stacks them, or one string with effects and its own."""

    members: list[int]
    observer: "AdaptiveObserver | EffectObserver"


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
            self._groups.append(Group(members, observer))
            for j, i in enumerate(members):
                kept = self.strings[i].kept
                if kept is not None:
                    observer.set_parameters(j, kept.values, kept.names, kept.common, kept.own)
        for i, s in enumerate(self.strings):
            if s.plan.model.effects:
                own = _with_effects(s, self._dt, plan.disturbance)
                numbers = own.effect_numbers
                s.effects = tuple(Estimate(x.name, x.value, x.sd, x.unit, FIXED_OFFLINE) for x in numbers)
                self._groups.append(Group([i], own))

    def step(self, readings: Sequence[Reading], t1: int) -> TickResult:
        """Advance all strings by one tick that ends at `t1`, ns."""
        results = [TickResult() for _ in self.strings]
        if not self._introduced:
            self._introduced = True
            for s, result in zip(self.strings, results, strict=True):
                result.events.append(Parameters(t1, s.plan.name, (*s.estimates, *s.effects)))
        for group in self._groups:
            self._step_group(group, [readings[i] for i in group.members], t1, [results[i] for i in group.members])
        self._gap_s = 0.0
        # told in the order of the plan, however the strings were grouped
        return TickResult([e for r in results for e in r.events], [j for r in results for j in r.jobs])

    def _step_group(self, group: Group, readings: list[Reading], t1: int, results: list[TickResult]) -> None:
        strings = [self.strings[i] for i in group.members]
        heat = np.array([s.heat(r, self._dt) for s, r in zip(strings, readings, strict=True)])
        n = strings[0].plan.model.cells
        e = self._observe(group.observer, strings, readings, heat)
        usable = e.core_sd <= AVAILABLE_SD_K
        core, core_sd = np.where(usable, e.core, np.nan), np.where(usable, e.core_sd, np.nan)
        surface = np.where(usable, e.surface, np.nan)
        quality = np.where(usable, _quality(readings, n), NOT_AVAILABLE)
        normalised = e.innovation / e.innovation_sd
        for j, (i, s, r, result) in enumerate(zip(group.members, strings, readings, results, strict=True)):
            s.core, s.core_sd, s.surface, s.quality = core[j], core_sd[j], surface[j], quality[j]
            s.innovation, s.innovation_sd = e.innovation[j], e.innovation_sd[j]
            name = s.plan.name
            result.events.append(Estimated(t1, name, s.core, s.core_sd, s.surface, s.quality))
            if s.mismatch.update(normalised[j], self._dt):
                level = Level.WARNING if s.mismatch.flag.level else Level.NOTICE
                result.events.append(Notice(t1, level, "mismatch", s.mismatch.sentence(), name))
            I2, inlet = r.means.I2, r.inlet
            if not isinstance(group.observer, AdaptiveObserver):
                effective, shift = group.observer.effective
                I2, inlet = (effective if np.isfinite(I2) else I2), inlet + shift
            tick = Tick(t1, self._dt + self._gap_s, I2, float(heat[j]), inlet, r.y, r.age)
            if s.cells is not None:
                of_cells = s.cells.add(tick, r.cells, r.means.I, s.flow_ratio(r), s.identifier.posterior)
                if of_cells is not None:
                    result.jobs.append((i, of_cells))
            flow, electrical = s.flow_ratio(r), s.resistance()
            health = s.health.add(tick, r.means.I, r.soc, flow, electrical)
            if health is not None:
                result.jobs.append((i, health))
            job = s.identifier.add(tick)
            if job is not None:
                result.jobs.append((i, job))
            elif s.plan.identify == "rls" and not s.plan.model.effects and t1 % ADOPT_NS == 0:
                self._adopt(group, j)
                result.events.append(Parameters(t1, s.plan.name, (*s.estimates, *s.effects)))
                result.events += _commissioned(s, t1)

    @staticmethod
    def _observe(
        observer: "AdaptiveObserver | EffectObserver",
        strings: Sequence[StringEstimator],
        readings: Sequence[Reading],
        heat: Floats,
    ) -> States:
        if not isinstance(observer, AdaptiveObserver):
            return observer.step(strings[0].measured(readings[0]), readings[0].y, readings[0].age)
        n = strings[0].plan.model.cells
        return observer.step(
            np.array([r.means.I2 for r in readings]),
            heat[:, None] * observer.share,
            np.array([r.inlet for r in readings]),
            np.concatenate([r.y for r in readings]).reshape(-1, n),
            np.concatenate([r.age for r in readings]).reshape(-1, n),
            np.array([s.flow_ratio(r) for s, r in zip(strings, readings, strict=True)]),
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


def health_of(plan: StringPlan, identifier: Identifier | None = None) -> StringHealth:
    """Build the health of a string, knowing nothing yet but its model."""
    method = build(plan.identify, plan.model) if identifier is None else identifier
    return StringHealth(
        plan.model,
        thermal=not plan.model.effects or not isinstance(method, FixedIdentifier),
        known=plan.model.before is not None or plan.identify == "off",
    )


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


def _hears_cells(plan: StringPlan, wire: Wire) -> bool:
    """Whether enough cells' voltages may come to tell the cells apart; whether they do is seen on the way."""
    return identifies_cells(plan) and 2 * int((wire.cell_voltage >= 0).sum()) >= plan.model.cells


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


def _quality(readings: Sequence[Reading], cells: int) -> NDArray[np.uint8]:
    """Quality (S, n) of strings' estimates: the own sensor's, and nowhere better than that of the current."""
    own = np.concatenate([r.quality for r in readings]).reshape(-1, cells)
    own = np.where(own == NEVER, ESTIMATED, own)
    current = np.array([STALE if r.current_quality == NEVER else r.current_quality for r in readings], np.uint8)
    worse = ((own == GOOD) | (own == ESTIMATED)) & (current != GOOD)[:, None]
    return np.where(worse, current[:, None], own)
