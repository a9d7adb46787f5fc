"""Health of one string: the results of its windows, compared with commissioning, one flag for each cause."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, log, nan
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.health.ageing import Ageing, History
from bms_gateway.health.causes import Cooling, CurrentWatch, Drift, current_shape
from bms_gateway.health.cell_growth import CellGrowth
from bms_gateway.health.collect import WINDOW_S, Collector
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.mismatch import Mismatch
from bms_gateway.health.self_discharge import Leak, SelfDischarge
from bms_gateway.health.trend import B_PRIOR, SHAPE_SD, UNKNOWN, G, J, L, Prior, Trend
from bms_gateway.health.window_fit import FIRST_OFFSET, DriveWindow, Observed, at_mean_charge, fit_window
from bms_gateway.identify import Tick
from bms_gateway.thermal import Floats, StringModel, StringParameters

GROWN = 0.3
"""ln: prior sd of the growth of R_e since the commissioning in the model file. In its life a cell usually grows by a
third and may double. The windows then determine the growth."""
SHARP = 0.05  # ln: a commissioned R_e at 25 °C with a smaller sd is a baseline
ELSEWHERE = 0.25  # ln: sd of a fitted R_e of unknown temperature: 10 K change R_e of a lithium-ion cell by this
LEAST_RISE = 1.0  # K: windows whose heat warms the surface by less are not fitted
IDENTIFIED_WINDOWS = 3  # windows in which the identifier must know R_e before its numbers become the commissioned ones


@dataclass(frozen=True, slots=True)
class HealthJob:
    """The fit of one window, with everything that the fit needs."""

    parameters: StringParameters
    window: DriveWindow
    sensed: tuple[int, ...]
    guess: Floats
    B: float
    shape: str
    electrical: float
    doubtful: bool = False

    def run(self) -> "HealthResult":
        """Fit; the same job gives the same result to the last bit."""
        seen = fit_window(self.parameters, self.window, self.sensed, self.guess, self.B)
        ratio = nan
        if self.electrical > 0.0:  # both at the window's own temperature
            R_e = float(np.exp(np.mean(np.log(self.parameters.R_e))))
            ratio = log(R_e / self.electrical) + float(seen.mean[0]) + seen.B * seen.warmth
        share = len(self.window.square) * self.window.dt / WINDOW_S
        return HealthResult(seen, share, self.shape, ratio, self._without() if self.doubtful else {})

    def _without(self) -> dict[int, Observed]:
        """Fit the window without each of the thermocouples, if another one has readings."""
        found = {}
        for k, cell in enumerate(self.sensed):
            surface = self.window.surface.copy()
            surface[:, cell] = np.nan
            if np.isfinite(surface).any():
                others, guess = tuple(c for c in self.sensed if c != cell), np.delete(self.guess, FIRST_OFFSET + k)
                window = replace(self.window, surface=surface)
                found[k] = fit_window(self.parameters, window, others, guess, self.B)
        return found


@dataclass(frozen=True, slots=True)
class HealthResult:
    """Result of a job; `ratio` is ln(thermal over electrical resistance), NaN without voltage.

    `without` has the results without the k-th thermocouple, by k; it is empty where no thermocouple was in doubt.
    """

    seen: Observed
    share: float
    shape: str
    ratio: float
    without: dict[int, Observed] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Change:
    """A flag whose level has changed: its word, its new level, its sentence, its cell, and numbers for machines."""

    code: str
    level: int
    text: str
    cell: int | None = None
    facts: Mapping[str, float] = field(default_factory=dict, compare=False)


class StringHealth:
    """Health of one string.

    Parameters
    ----------
    model : StringModel
    thermal : bool
        Whether windows are fitted: their model has two nodes per cell and heat in proportion to the current's square.
    known : bool
        Whether the model's numbers are the commissioned ones: they were fitted, or no identifier runs.
    mismatch : Mismatch, optional
        The mismatch of this string, one of many that are judged together.
    """

    def __init__(
        self, model: StringModel, *, thermal: bool = True, known: bool = False, mismatch: Mismatch | None = None
    ) -> None:
        self.model = model
        self.ageing, self.cooling, self.drift = Ageing(), Cooling(), Drift(model.sensors)
        self.current, self.mismatch, self.history = CurrentWatch(), mismatch or Mismatch(), History()
        self.cells: CellGrowth | None = None
        self.heat: Sequence[Finding] = ()
        self.self_discharge: SelfDischarge | None = None
        self.collector = Collector()
        self.trend: Trend | None = None
        self.flow_known = False
        self.thermal = thermal and bool(model.sensors)
        self._frozen: dict[str, float] = {}
        self._pending = False
        self._identified = 0
        if known and self.thermal:
            self._freeze({}, self._filed())

    @property
    def commissioned(self) -> bool:
        """Whether there is a baseline, or windows are making one."""
        return self.trend is not None

    def _filed(self) -> Prior:
        """Give the prior of the commissioned numbers by the model file."""
        m = self.model
        R_e, B, B_sd = m.priors["R_e"].rel_sd, *B_PRIOR
        effect = next((e for e in m.effects if e.name == "resistance_temperature"), None)
        if effect is not None:  # the current of the windows already includes this effect
            B, B_sd = 0.0, max(float(effect.sd.get("B", 0.0)), 100.0)
        level = float(np.hypot(R_e, 0.0 if effect is not None else ELSEWHERE))
        shape = tuple(max(0.02, m.priors[s].rel_sd) for s in ("R_c", "C_c", "C_s"))
        sharp = m.before is not None and level <= SHARP
        return Prior(level if m.before is not None else UNKNOWN, GROWN if sharp else 0.0, B, B_sd, shape)

    def _freeze(self, numbers: Mapping[str, float], prior: Prior) -> None:
        """Set the commissioned numbers, given as ln of their ratio to the model's, and start the trend."""
        self._frozen = dict(numbers)
        self.trend = Trend(len(self.model.sensors), prior)

    def offer(self, names: tuple[str, ...], mean: Floats, cov: Floats, R_e: float, identified: bool) -> bool:
        """Take the identifier's numbers; commission the string after R_e has been identified in some windows.

        Returns
        -------
        bool
            Whether the string has just been commissioned.
        """
        if self.commissioned or not self.thermal:
            return False
        self._identified = self._identified + 1 if identified else 0
        if self._identified < IDENTIFIED_WINDOWS:
            return False
        typical = {s: float(np.mean(np.log(self.model.priors[s].value))) for s in names}
        numbers = {s: float(x) - typical[s] for s, x in zip(names, mean, strict=True)}
        numbers["R_e"] = log(R_e) - typical["R_e"]
        sd = dict(zip(names, np.sqrt(np.diag(cov)).tolist(), strict=True))
        shape = tuple(max(SHAPE_SD, sd[s]) for s in ("R_c", "C_c", "C_s"))
        self._freeze(numbers, Prior(shape_sd=shape))
        return True

    @property
    def baseline(self) -> float:
        """Commissioned R_e at 25 °C, mean of the cells, Ω; NaN before commissioning."""
        if self.trend is None:
            return nan
        return float(np.exp(np.mean(np.log(self.parameters.R_e)) + self.trend.x[L]))

    @property
    def parameters(self) -> StringParameters:
        """Commissioned numbers of the string."""
        return self.model.parameters({s: self.model.priors[s].value * np.exp(x) for s, x in self._frozen.items()})

    def add(self, tick: Tick, current: float, soc: float, flow: float, electrical: float) -> HealthJob | None:
        """Include one tick; return a job if a window has ended.

        Parameters
        ----------
        tick : Tick
        current, soc, flow : float
            Mean A; 0…1; over nominal. NaN where unknown.
        electrical : float
            Resistance of a mean cell from its voltage, Ω; NaN where there is no voltage.
        """
        if self.trend is None:
            return None
        self.flow_known = self.flow_known or flow > 0.0
        drive = self.collector.add(tick, current, soc, flow)
        if drive is None or self._pending:
            return None
        p = self.parameters
        if float(np.mean(p.R_u) * np.mean(p.R_e) * drive.window.square.mean()) < LEAST_RISE:
            return None
        self._pending = True
        return self.job(drive.window, drive.current, electrical)

    def job(self, w: DriveWindow, current: Floats, electrical: float = nan) -> HealthJob:
        """Make the job of one window, which begins at the numbers that the trend expects now.

        Parameters
        ----------
        w : DriveWindow
        current : ndarray (K·j,)
            A, of each tick or of j equal parts of it.
        electrical : float
            As of `add`.
        """
        assert self.trend is not None  # noqa: S101 - there are no windows before there is a baseline
        guess, capacity = self.trend.expected(w.flow, w.soc), self.model.capacity_Ah
        if capacity is not None:
            w = at_mean_charge(w, current, capacity, self.trend.charge_slope)
        sensed = tuple(k - 1 for k in self.model.sensors)
        shape, doubtful = current_shape(current), self.trend.doubtful
        return HealthJob(self.parameters, w, sensed, guess, self.trend.exponent, shape, electrical, doubtful)

    def accept(self, result: HealthResult, now: int) -> list[Change]:
        """Take a job's result; return the flags whose level it has changed."""
        assert self.trend is not None  # noqa: S101 - a job came from it
        self._pending = False
        moved = []
        doubted = self.current.doubted(result.shape if self.trend.surprising(result.seen) else "")
        if not doubted:
            ln_R_e, sd = self.trend.resistance(result.seen)
            self.current.listen(result.ratio + ln_R_e - float(result.seen.mean[0]), sd)
            kind = self.trend.update(result.seen, result.share, believe=self.current.believed, without=result.without)
            self.drift.took(kind, self.trend.left_out)
        if self.current.update(self.trend):
            moved.append(Change("current", self.current.flag.level, self.current.sentence()))
        if doubted:  # the current of such a window is wrong: nothing else of it is used
            return moved
        if self.cooling.update(self.trend):
            moved.append(Change("cooling", self.cooling.flag.level, self.cooling.sentence(self.flow_known)))
        if self.drift.update(self.trend):
            moved.append(Change("thermocouple", self.drift.flag.level, self.drift.sentence(), self.drift.worst or None))
        growth, sd = self._growth()
        if self.ageing.update(growth, sd, judge=not self.trend.restless):
            moved.append(Change("ageing", self.ageing.flag.level, self.ageing.sentence(doubt=self.doubt)))
        if self.ageing.commissioned:
            self.history.add((now, self.baseline * (1.0 + growth), growth, sd, self.cooling.growth))
            moved += self._judge_cells()
        return moved

    def _growth(self) -> tuple[float, float]:
        """Growth of R_e and its sd; a jump counts as growth if the voltage shows it too."""
        assert self.trend is not None  # noqa: S101
        real = self.current.heard and not self.current.wrong_scale
        at = [G, J] if real else [G]
        mean = float(self.trend.x[at].sum())
        sd = float(np.sqrt(max(self.trend.P[np.ix_(at, at)].sum(), 0.0)))
        return exp(mean) - 1.0, exp(mean) * sd

    @property
    def doubt(self) -> str:
        """Another cause that would look like growth."""
        if self.current.heard:
            return " (the voltage does not contradict the current so far; a scale some per cent off takes long to show)"
        return " (a current sensor that has come to read low looks the same: no voltage is heard that could tell)"

    def fitted(self, ln_R_e: Floats, sd: Floats, base: Floats | None) -> list[Change]:
        """Take a fit of single cells, ln R_e (n,) and sd; `base`: ln of the commissioned R_e over their mean."""
        if self.cells is None:
            self.cells = CellGrowth(len(ln_R_e), base)
        self.cells.fitted(ln_R_e, sd)
        return self._judge_cells()

    def _judge_cells(self) -> list[Change]:
        if self.cells is None or not self.ageing.commissioned:
            return []
        found = self.cells.update(self.ageing.growth, self.ageing.growth_sd)
        of = [(k, self.cells.ageing[k]) for k in found]
        return [Change("ageing", a.flag.level, a.sentence(f" of cell {k + 1}", self.doubt), k + 1) for k, a in of]

    def conditions(self) -> Iterator[Change]:
        """Every raised flag, the most severe cause first; of two with the same word and cell, the more severe one."""
        found: dict[tuple[str, int | None], Change] = {}
        for c in (*self._of_heat(), *self._slow()):
            other = found.get((c.code, c.cell))
            if other is None or c.level > other.level:
                found[c.code, c.cell] = c
        yield from found.values()

    def _of_heat(self) -> Iterator[Change]:
        """List the findings of the watch over heat: these faults develop within minutes and need no commissioning."""
        for f in self.heat:
            facts = {"heat_W": f.heat, "heat_sd_W": f.heat_sd} if f.heat == f.heat else {}
            yield Change(f.code, f.level, f.text, f.cell, facts)

        for leak in self.self_discharge.leaks.values() if self.self_discharge is not None else ():
            yield _of_leak(leak, leak.level)

    def _slow(self) -> Iterator[Change]:
        if level := self.current.flag.level:
            yield Change("current", level, self.current.sentence())
        if level := self.ageing.flag.level:
            yield Change("ageing", level, self.ageing.sentence(doubt=self.doubt))
        for k, a in enumerate(self.cells.ageing if self.cells is not None else ()):
            if a.flag.level:
                yield Change("ageing", a.flag.level, a.sentence(f" of cell {k + 1}", self.doubt), k + 1)
        if level := self.cooling.flag.level:
            yield Change("cooling", level, self.cooling.sentence(self.flow_known))
        if level := self.drift.flag.level:
            yield Change("thermocouple", level, self.drift.sentence(), self.drift.worst or None)
        if level := self.mismatch.flag.level:
            yield Change("mismatch", level, self.mismatch.sentence())

    def discharges(self, now_ns: int, current: float, charge_Ah: float, V: Floats | None) -> list[Change]:
        """Take a tick's current, A, charge, Ah, and voltages of the cells (n,), V; return the changes."""
        if self.self_discharge is None:
            return []
        found = self.self_discharge.take(now_ns, current, charge_Ah, V)
        return [_of_leak(leak, leak.level if raised else 0) for leak, raised in found]

    def reset(self, cell: int | None, reason: str, now: int) -> str:
        """Find a new baseline: cells were replaced. Return a sentence; it is empty if this reset was done before.

        Parameters
        ----------
        cell : int or None
            1-based; None for the whole string.
        reason : str
        now : int
            ns; time and reason together identify the reset.
        """
        if (now, self._note(cell, reason)) in self.history.events:
            return ""
        if cell is None:
            if self.trend is not None:
                self.trend.reset()
            self.ageing.reset()
            self.cells = None
        elif self.cells is not None:
            self.cells.reset(cell - 1)
        self.history.note(now, self._note(cell, reason))
        if cell is not None and self.cells is None:
            return f"{self._note(cell, reason)}: noted; the cells of this string are not told apart on the road"
        return f"{self._note(cell, reason)}: made anew by the next drives"

    @staticmethod
    def _note(cell: int | None, reason: str) -> str:
        return f"baseline{'' if cell is None else f' of cell {cell}'} of R_e reset: {reason}"

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values; the unfinished window is not stored."""
        return {
            "frozen": self._frozen,
            "identified": self._identified,
            "trend": None if self.trend is None else self.trend.snapshot(),
            "ageing": self.ageing.snapshot(),
            "cooling": self.cooling.flag.level,
            "drift": self.drift.flag.level,
            "contact": self.drift.contact(),
            "current": self.current.snapshot(),
            "mismatch": self.mismatch.flag.level,
            "cells": None if self.cells is None else self.cells.snapshot(),
            "flow_known": self.flow_known,
            "history": self.history.snapshot(),
            "self_discharge": None if self.self_discharge is None else self.self_discharge.snapshot(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up a stored state.

        Raises
        ------
        StateError
            It is another string's, or damaged.
        """
        frozen = {str(s): float(x) for s, x in state["frozen"].items()}
        if not set(frozen) <= set(self.model.priors) or not np.isfinite(list(frozen.values())).all():
            raise StateError("health: the stored state is of another string; starting anew")
        self._identified = int(state["identified"])
        if state["trend"] is not None:
            self._freeze(frozen, Prior())
            assert self.trend is not None  # noqa: S101 - just made
            self.trend.restore(state["trend"])
            self.cooling.restore(self.trend, state["cooling"])
            self.drift.restore(self.trend, state["drift"], state.get("contact"))
        self.ageing.restore(state["ageing"])
        self.current.restore(state["current"])
        if self.self_discharge is not None and state.get("self_discharge") is not None:
            self.self_discharge.restore(state["self_discharge"])
        if state["cells"] is not None:
            self.cells = CellGrowth(self.model.cells)
            self.cells.restore(state["cells"])
        self.flow_known = bool(state["flow_known"])
        self.history.restore(state["history"])


def _of_leak(leak: Leak, level: int) -> Change:
    """Report a cell that discharges itself, or (level 0) that no longer does."""
    facts = {"current_A": leak.current, "current_sd_A": leak.current_sd} if leak.current == leak.current else {}
    text = leak.text if level else f"cell {leak.cell} does not discharge itself any more"
    return Change("self_discharge", level, text, leak.cell, facts)
