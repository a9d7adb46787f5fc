"""The present window: ticks of one string, until a window is full or a gap ends it."""

from dataclasses import dataclass, field
from math import nan
from typing import Literal

import numpy as np

from bms_gateway.identify.contract import Tick
from bms_gateway.identify.stretch import Stretch
from bms_gateway.identify.ticks import Ticks
from bms_gateway.identify.window_problem import Window

NO_CURRENT = (0.0, nan, 0.0)
"""Square, heat and current of a first tick without them."""


@dataclass(slots=True)
class WindowNow(Stretch):
    """The present window.

    Attributes
    ----------
    of_ticks : tuple of list of float
        Mean square current, A², heat, W, and current, A, of the ticks; heat is NaN where it is I²R_e.
    joined : bool
        Whether it begins where a fitted window ended.
    looked : bool
        Whether it was already fitted before it was full.
    """

    of_ticks: tuple[list[float], ...] = field(default_factory=lambda: ([], [], []))
    joined: bool = False
    looked: bool = False

    @property
    def heat(self) -> list[float]:
        """Heat of one cell in each tick, W; NaN where it is I²R_e."""
        return self.of_ticks[1]

    def append(self, tick: Tick) -> Literal["taken", "waits", "lost"]:
        """Include one tick, see `Stretch.add`: it needs a current or a heat."""
        square, heat = tick.mean_square_current, tick.heat
        # plain numbers, many times a second: comparing them with themselves tells NaN far faster than numpy does
        known = square == square or heat == heat
        return self.add(tick, (square, heat, tick.current) if known else None, NO_CURRENT)

    def extend(self, ticks: Ticks) -> None:
        """Include complete regular ticks; the same as adding them one by one."""
        self.take(ticks, ticks.square, ticks.heat, ticks.current)

    def window(self) -> tuple[Window, float]:
        """Return it for a fit, and the share of its ticks whose heat does not come from the current."""
        square, heat, current = (np.array(column) for column in self.of_ticks)
        measured = np.isfinite(heat)
        window = Window(
            np.where(measured, 0.0, np.nan_to_num(square)),
            np.where(measured, heat, 0.0),
            np.nan_to_num(current),
            np.array(self.inlet),
            *self.readings.whole(),
            self.dt,
        )
        return window, float(measured.mean())
