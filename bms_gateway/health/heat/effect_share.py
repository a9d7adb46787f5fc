"""What the effects of a string's model do to its thermocouples: taken off the readings, the watch sees plain cells.

Two observers run free beside each other from the same start with the same inputs, one with the effects and one without;
neither hears a reading. What they would read differs by what the effects do. The watch's balances are those of two
nodes a cell, so this is the whole difference, but for what a fault itself does to an effect.
"""

from dataclasses import replace
from math import nan

import numpy as np

from bms_gateway.observe.effect_observer import EffectObserver
from bms_gateway.observe.measured import Measured
from bms_gateway.thermal import Floats, StringModel


class EffectShare:
    """Of one string with effects.

    Parameters
    ----------
    model : StringModel
    dt : float, s
        Step of the watch, over which what drives the string is taken together.
    soc : float
        State of charge from which counting starts.
    """

    def __init__(self, model: StringModel, dt: float, soc: float) -> None:
        self._models, self._dt, self._soc = (model, replace(model, effects=())), dt, soc
        self._nothing = np.full(model.cells, nan)
        self._ticks: list[Measured] = []
        self._runs: tuple[EffectObserver, ...] = ()
        self._last = np.zeros(model.cells)

    def add(self, m: Measured) -> None:
        """Take in what drove the string over a tick."""
        self._ticks.append(m)

    def pause(self) -> None:
        """Begin anew after a time without frames."""
        self._ticks, self._runs = [], ()

    def begin(self, level: float) -> None:
        """Begin with all temperatures at `level`, °C."""
        self._runs = tuple(EffectObserver(m, self._dt, soc=self._soc) for m in self._models)
        for run in self._runs:
            run.step(Measured(0.0, 0.0, 0.0, level), self._nothing, self._nothing)
        self._last = np.zeros(len(self._nothing))

    def mean(self) -> Floats:
        """Let the ticks so far be a step; how much more (n,), K, thermocouples read with the effects, on its mean."""
        if not self._runs or not self._ticks:
            self._ticks = []
            return np.zeros(len(self._nothing))
        rows = np.array([[m.I, m.I2, m.I_abs, m.inlet, m.flow, m.soc, m.V, m.IV] for m in self._ticks])
        self._ticks = []
        there = np.isfinite(rows)
        means = np.where(there, rows, 0.0).sum(axis=0) / np.where(there.any(axis=0), there.sum(axis=0), nan)
        means[3] = rows[-1, 3]  # the inlet is that of the step's end
        step = Measured(*means.tolist())
        for run in self._runs:
            run.step(step, self._nothing, self._nothing)
        with_effects, without = (run.read for run in self._runs)
        before, self._last = self._last, with_effects - without
        return (before + self._last) / 2.0
