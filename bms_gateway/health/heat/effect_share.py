"""Influence of a model's effects on its thermocouples: subtracted from readings, so that the watch sees plain cells.

Two strings are simulated without readings, from the same start with the same inputs: one with the effects, one without.
The difference of their thermocouples is the influence of the effects. The watch's balances have two nodes per cell, so
this is the whole difference, except the influence of a fault on an effect. Both are simulated tick by tick, because a
thermocouple's mean over a step depends on the time of the current in it.
"""

from collections.abc import Sequence
from dataclasses import fields, replace
from math import nan

import numpy as np

from bms_gateway.observe.effect_inputs import Inputs
from bms_gateway.observe.measured import SOC_UNKNOWN, Measured
from bms_gateway.observe.tangent import drive_of
from bms_gateway.thermal import Disturbance, Floats, StringModel
from bms_gateway.thermal.physics import Physics
from bms_gateway.thermal.recursion import Recursion
from bms_gateway.thermal.system import System
from bms_gateway.thermal.trajectory import readings, reference, simulate

STRAYED_K, STRAYED_FLOW = 3.0, 0.03
"""The Jacobian is renewed when a temperature, or ln(flow), is further than this from where it was taken. It does not
change the result, only the number of sweeps."""
NAMES = tuple(f.name for f in fields(Measured))


class FreeRun:
    """A simulated string that uses no reading.

    Parameters
    ----------
    model : StringModel
    level : float, °C
        All temperatures at the start.
    """

    def __init__(self, model: StringModel, level: float) -> None:
        self._physics = Physics(model)
        self._v = self._physics.numbers()
        T = np.full(model.cells, level)
        self._X, self._carry = self._physics.start(T, T, self._v), dict[str, Floats]()
        self._at, self._flow = self._X, nan
        self._recursion: Recursion | None = None
        self._next: tuple[Floats, dict[str, Floats]] = self._X, self._carry

    def read(self, rows: Floats, dt: float) -> Floats:
        """Temperatures of thermocouples (N + 1, n), °C, before and after each of N ticks (N, 9); then call `go_on`."""
        u = drive_of(rows, dt)
        memory, carry = self._physics.memory(u, self._v, self._carry or None)
        system = System(self._physics, u, self._v, memory)
        X, settled = simulate(system, (self._X,), self._near(system), pieces=False)
        if not settled:
            X, _ = simulate(system, (self._X,), reference(system, self._X))
        self._next = X[-1], carry
        return readings(system, X)

    def go_on(self) -> None:
        """Continue from the end of the last `read`."""
        self._X, self._carry = self._next

    def _near(self, system: System) -> Recursion:
        """Return the recursion about a point near the state."""
        flow = float(np.log(np.mean(system.u.flow)))
        old = self._recursion
        near = np.abs(self._X - self._at).max() <= STRAYED_K and abs(flow - self._flow) <= STRAYED_FLOW
        if old is None or not near:
            self._at, self._flow = self._X, flow
            self._recursion = old = reference(system, self._X)
        return old


class EffectShare:
    """Influence of the effects of one string.

    Parameters
    ----------
    model : StringModel
    dt : float, s
        Tick.
    soc : float
        State of charge from which counting starts.
    """

    def __init__(self, model: StringModel, dt: float, soc: float = SOC_UNKNOWN) -> None:
        self._models, self._dt, self._soc = (model, replace(model, effects=())), dt, soc
        self._ticks: list[Measured] = []
        self._runs: tuple[FreeRun, ...] = ()
        self._inputs = self._begin_inputs()
        self._last = np.zeros(model.cells)
        self._before: Floats | None = None

    def _begin_inputs(self) -> Inputs:
        return Inputs(self._soc, self._models[0].capacity_Ah, self._dt, Disturbance().correlation)

    def add(self, m: Measured) -> None:
        """Include the inputs of a tick."""
        self._ticks.append(m)

    def pause(self) -> None:
        """Start again after a time without frames."""
        self._ticks, self._runs, self._before = [], (), None

    def begin(self, level: float) -> None:
        """Start with all temperatures at `level`, °C."""
        self._runs = tuple(FreeRun(m, level) for m in self._models)
        self._inputs = self._begin_inputs()
        self._inputs.begin(level)
        self._last, self._before = np.zeros_like(self._last), None

    def course(self, ticks: int) -> Floats:
        """End a step at the present tick; return the effects' influence (2 ticks + 1, n), K, on the thermocouples.

        It is given at the ends of as many even parts of the previous step, from its start on, and of this step.
        """
        before, now = self._before, self._now(ticks)
        if before is None:
            before = np.tile(now[0], (ticks + 1, 1))
        self._before = now if self._runs else None
        return np.concatenate((before[:-1], now))

    def _now(self, ticks: int) -> Floats:
        heard, self._ticks = self._ticks, []
        if not self._runs or not heard:
            return np.tile(self._last * bool(self._runs), (ticks + 1, 1))
        rows = np.stack([self._inputs.take(m) for m in _completed(heard)])
        with_effects, without = (run.read(rows, self._dt) for run in self._runs)
        more = with_effects - without
        if not np.isfinite(more).all():  # an effect lacks an input
            return np.tile(self._last, (ticks + 1, 1))
        for run in self._runs:
            run.go_on()
        self._last = more[-1]
        where = np.linspace(0.0, len(heard), ticks + 1)
        k = np.minimum(where.astype(np.int64), len(heard) - 1)
        share = (where - k)[:, None]
        return np.asarray((1.0 - share) * more[k] + share * more[k + 1], dtype=np.float64)


def _completed(ticks: Sequence[Measured]) -> list[Measured]:
    """Ticks (one or more) of a step with unknown values, except the inlet, replaced by the mean of the other ticks."""
    table = np.array([[getattr(m, k) for k in NAMES] for m in ticks], dtype=np.float64)
    there = np.isfinite(table)
    if there.all():
        return list(ticks)
    means = np.where(there, table, 0.0).sum(axis=0) / np.where(there.any(axis=0), there.sum(axis=0), nan)
    means[NAMES.index("inlet")] = nan
    return [Measured(*row) for row in np.where(there, table, means).tolist()]
