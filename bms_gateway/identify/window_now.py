"""The window under way: ticks of one string, until they are as long as a window or a gap ends them."""

from dataclasses import dataclass, field
from math import nan
from typing import Literal

import numpy as np

from bms_gateway.identify.contract import Tick
from bms_gateway.identify.ticks import Ticks
from bms_gateway.identify.window_problem import Window
from bms_gateway.identify.window_readings import HOLD_CURRENT_S, HOLD_INLET_S, Gathered


@dataclass(slots=True)
class WindowNow:
    """The window under way.

    Attributes
    ----------
    inlet : list of float, °C
        At the instants, one more than ticks; empty before the first.
    joined : bool
        It begins where a fitted window ended.
    dt : float, s
        Length of its ticks; 0 before the first.
    square, heat, current : list of float, A², W, A
        Of the ticks; NaN where not known.
    readings : Gathered
    held : (float, float), s
        Since when there was no current, and no inlet.
    looked : bool
        It was fitted once already before it was full.
    """

    inlet: list[float] = field(default_factory=list)
    joined: bool = False
    dt: float = 0.0
    square: list[float] = field(default_factory=list)
    heat: list[float] = field(default_factory=list)
    current: list[float] = field(default_factory=list)
    readings: Gathered = field(default_factory=Gathered)
    held: tuple[float, float] = (0.0, 0.0)
    looked: bool = False

    @property
    def length_s(self) -> float:
        """How long it is, s."""
        return len(self.square) * self.dt

    def steps_otherwise(self, dt: float) -> bool:
        """Whether ticks of `dt` seconds are of another length than those before."""
        return bool(self.square) and abs(dt - self.dt) > 1e-6

    def add(self, tick: Tick) -> Literal["taken", "waits", "lost"]:
        """Take in one tick.

        Returns
        -------
        {"taken", "waits", "lost"}
            It waits for a first tick that has current and inlet. It is lost where one of the two was missing for longer
            than the last value may stand for it.
        """
        blind, still = self.held
        # plain numbers, many times a second: comparing them with themselves tells NaN far faster than numpy does
        square, heat, inlet = tick.mean_square_current, tick.heat, tick.inlet
        no_heat, no_inlet = square != square and heat != heat, inlet != inlet
        blind = blind + tick.dt if no_heat else 0.0
        still = still + tick.dt if no_inlet else 0.0
        if blind > HOLD_CURRENT_S or still > HOLD_INLET_S:
            return "lost"
        if not self.inlet:
            if not (no_heat or no_inlet):
                self.inlet = [inlet]  # the first tick gives the instant from which the window runs
            return "waits"
        if no_heat:
            square, heat = (self.square[-1], self.heat[-1]) if self.square else (0.0, nan)
        self.held, self.dt = (blind, still), tick.dt
        self.square.append(square)
        self.heat.append(heat)
        self.current.append(tick.current)
        self.readings.add(tick.surface, tick.age)
        self.inlet.append(self.inlet[-1] if no_inlet else inlet)
        return "taken"

    def take(self, ticks: Ticks) -> None:
        """Take in regular ticks that lack nothing; the same as adding them one by one."""
        self.held, self.dt = (0.0, 0.0), ticks.dt
        self.square += ticks.square.tolist()
        self.heat += ticks.heat.tolist()
        self.current += ticks.current.tolist()
        self.inlet += ticks.inlet.tolist()
        self.readings.take(ticks.surface, ticks.age)

    def window(self) -> tuple[Window, float]:
        """Give it for a fit, and the share of its ticks whose heat was measured otherwise than by the current."""
        square, heat = np.array(self.square), np.array(self.heat)
        measured = np.isfinite(heat)
        window = Window(
            np.where(measured, 0.0, np.nan_to_num(square)),
            np.where(measured, heat, 0.0),
            np.nan_to_num(np.array(self.current)),
            np.array(self.inlet),
            *self.readings.whole(),
            self.dt,
        )
        return window, float(measured.mean())
