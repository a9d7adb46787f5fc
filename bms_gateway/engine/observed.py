"""The observer of a group of strings: its inputs, and its outputs for the identifiers."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

import numpy as np

from bms_gateway.engine.forecast_result import LooksAhead
from bms_gateway.engine.plan import StringPlan
from bms_gateway.engine.readings import Assigned, Readings
from bms_gateway.engine.string_estimator import StringEstimator
from bms_gateway.health.heat.heat_watch import Share
from bms_gateway.identify import Estimate as Parameter
from bms_gateway.identify.contract import FIXED_OFFLINE
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.observe.contract import Observer
from bms_gateway.observe.estimate import Estimate
from bms_gateway.observe.measured import SOC_UNKNOWN
from bms_gateway.observe.outlook import Outlook
from bms_gateway.thermal import Disturbance, Floats, StringModel
from bms_gateway.thermal.warmth import WARMTH_SD

if TYPE_CHECKING:
    from bms_gateway.health.heat.effect_share import EffectShare
    from bms_gateway.observe.effect_observer import EffectObserver


COOLING_OVER_HEAT: Final = 2.0
"""Ratio of the cells' scatter in cooling to that in heat, where only the range of their surfaces is read. Cooling
differs from place to place by tens of per cent, the heat of matched cells by a few."""


class Driven(NamedTuple):
    """Inputs of S strings over one tick.

    Attributes
    ----------
    square, current : ndarray (S,), A², A
        Mean square and mean of the current.
    heat : ndarray (S,), W
        Heat of one cell from the voltage; NaN if unknown.
    inlet : ndarray (S,), °C
    flow : ndarray (S,) or None
        Flow over nominal flow.
    """

    square: Floats
    current: Floats
    heat: Floats
    inlet: Floats
    flow: Floats | None


class Observed(Protocol):
    """An observer with the methods by which the engine drives it."""

    @property
    def observer(self) -> Observer:
        """The observer, for its states, its parameters and gaps."""
        ...

    @property
    def shares(self) -> Sequence[Share]:
        """Effects to subtract from each string's readings for the watch over heat; none if its balances hold."""
        ...

    def step(self, readings: Readings, driven: Driven, y: Floats, age: Floats, of: Assigned | None) -> Estimate:
        """Advance one tick with the surfaces y (S, n), °C, of these strings, which are `age` (S, n) s old.

        `readings` holds the readings of all strings. `of` marks the surfaces (S, n) that are the greatest, least or
        mean of several cells.
        """
        ...

    def own(self, e: Estimate) -> Floats:
        """`Surprise.own` (S, n), K/s, of the step that gave `e`, by cell; NaN for cells without a sensor."""
        ...

    def plainly(self, driven: Driven) -> tuple[Floats, Floats]:
        """Mean square current, A², and inlet, °C (S,), with which two plain nodes give the result of the last step."""
        ...

    def by_warmth(self) -> Floats | float:
        """R_e (S,) of the cores in these two nodes over R_e where it is known (`thermal.warmth`)."""
        ...

    def looks_ahead(self) -> LooksAhead:
        """Make the outlook that forecasts from the observer's state."""
        ...


@dataclass(frozen=True, slots=True)
class PlainStrings:
    """S strings with two nodes per cell, stacked."""

    observer: AdaptiveObserver
    by_voltage: bool

    def step(self, readings: Readings, driven: Driven, y: Floats, age: Floats, of: Assigned | None) -> Estimate:  # noqa: ARG002 — the protocol
        """Use the tick."""
        if of is not None:
            self.observer.surprise.assign(*of)
        heat = driven.heat[:, None] * self.observer.share if self.by_voltage else None  # cells share it by their R_e
        self.observer.reversible.flow(driven.current)
        return self.observer.step(driven.square, heat, driven.inlet, y, age, driven.flow)

    def own(self, e: Estimate) -> Floats:
        """Return those of the sensors at their cells."""
        return e.errors.on_cells(self.observer.surprise.own)

    @property
    def shares(self) -> Sequence[Share]:
        """Return none."""
        return ()

    def plainly(self, driven: Driven) -> tuple[Floats, Floats]:
        """Return the square of the current and the inlet."""
        return driven.square, driven.inlet

    def by_warmth(self) -> Floats | float:
        """Return that of the mean core."""
        return self.observer.by_warmth()

    def looks_ahead(self) -> LooksAhead:
        """Forecast with two nodes per cell."""
        return Outlook()


@dataclass(frozen=True, slots=True)
class StringWithEffects:
    """One string with its effects: number `number` of the plan."""

    observer: "EffectObserver"
    string: StringEstimator
    number: int
    share: "EffectShare | None"

    @classmethod
    def of(cls, s: StringEstimator, number: int, dt: float, disturbance: Disturbance) -> "StringWithEffects":
        """Build the observer of a string, and give the string the numbers of its effects."""
        # importing the catalogue doubles the time of a start
        from bms_gateway.health.heat.effect_share import EffectShare
        from bms_gateway.identify.window_effects import heat_only
        from bms_gateway.observe.effect_observer import EffectObserver

        model, soc = s.plan.model, s.wire.constants.get("soc", SOC_UNKNOWN)
        observer = EffectObserver(model, dt, disturbance, soc=soc, several=s.plan.of_several)
        numbers = observer.effect_numbers
        s.effects = tuple(Parameter(x.name, x.value, x.sd, x.unit, FIXED_OFFLINE) for x in numbers)
        share = EffectShare(model, dt, soc) if model.sensors and not heat_only(model) else None
        return cls(observer, s, number, share)

    def step(self, readings: Readings, driven: Driven, y: Floats, age: Floats, of: Assigned | None) -> Estimate:  # noqa: ARG002 — the protocol
        """Use the tick."""
        m = self.string.measured(readings[self.number])
        if self.share is not None:
            self.share.add(m)
        if of is not None:
            self.observer.surprise.assign(*of)
        return self.observer.step(m, y[0], age[0])

    def own(self, e: Estimate) -> Floats:
        """Return those of the sensors at their cells; the errors of this observer are by cell already."""
        found = np.full(e.core.shape, np.nan)
        found[:, np.array(self.string.plan.model.sensors, np.intp) - 1] = self.observer.surprise.own
        return found

    @property
    def shares(self) -> Sequence[Share]:
        """Return the share of its effects, if they do more than heat the cores."""
        return () if self.share is None else (self.share,)

    def plainly(self, driven: Driven) -> tuple[Floats, Floats]:
        """Return the equivalents of its effects."""
        effective, shift = self.observer.effective
        return np.where(np.isnan(driven.square), np.nan, effective), driven.inlet + shift

    def by_warmth(self) -> Floats | float:
        """Return 1: `plainly` includes what its effects do."""
        return 1.0

    def looks_ahead(self) -> LooksAhead:
        """Forecast with the full physics."""
        from bms_gateway.observe.outlook_effects import EffectOutlook  # with the catalogue

        return EffectOutlook()


def kind_of(plan: StringPlan) -> tuple[int, bool, bool]:
    """Kind of a plain string; strings of the same kind can be stacked."""
    return plan.model.cells, plan.of_several, plan.spread_read


def plain_strings(
    strings: Sequence[StringEstimator], members: Sequence[int], dt: float, disturbance: Disturbance
) -> PlainStrings:
    """Stack the strings numbered `members`, with the stored numbers of their cells."""
    mine = [strings[i] for i in members]
    several = any(s.plan.of_several for s in mine)
    if any(s.plan.spread_read for s in mine):
        disturbance = replace(disturbance, cooling_cell=COOLING_OVER_HEAT * disturbance.heat_cell)
    models = [_never_learnt(s.plan.model) if s.plan.of_several else s.plan.model for s in mine]
    observer = AdaptiveObserver(models, dt, disturbance, several=several)
    observer.consider_warmth(WARMTH_SD)
    for j, s in enumerate(mine):
        if s.kept is not None:
            observer.set_parameters(j, s.kept.values, s.kept.names, s.kept.common, s.kept.own)
    return PlainStrings(observer, any(s.voltage is not None for s in mine))


def _never_learnt(model: StringModel) -> StringModel:
    """Widen the uncertainty of R_e and R_c to that of their upper sides, if no fit will determine them.

    The observer's band is linear in logarithms. Two sd s of a logarithm are a factor exp(2s), so the number is larger
    by exp(2s) − 1: 2.3 and not 1.2 for s = 0.6. If windows reduce s, the difference soon vanishes.
    """
    if model.posterior is not None:
        return model
    wide = {
        name: replace(p, rel_sd=(math.exp(2.0 * p.rel_sd) - 1.0) / 2.0)
        for name, p in model.priors.items()
        if name in ("R_e", "R_c")
    }
    return replace(model, priors={**model.priors, **wide})
