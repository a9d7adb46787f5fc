"""Collects the ticks of a drive into windows. A gap, a lost current or a changed flow ends a window early."""

from dataclasses import dataclass
from math import isfinite, log, nan

import numpy as np

from bms_gateway.health.window_fit import DriveWindow
from bms_gateway.identify import Tick, Ticks
from bms_gateway.identify.stretch import Stretch
from bms_gateway.identify.ticks import before_full
from bms_gateway.identify.window_readings import GAP_S
from bms_gateway.thermal import Floats

WINDOW_S, SHORTEST_S = 1200.0, 600.0  # two slow time constants of a cell, and one
FLOW_MOVED = 0.15  # ln: a larger change of the flow ends the window, because a window is fitted with one flow


@dataclass(frozen=True, slots=True)
class Drive:
    """One window, and the mean current of its ticks (K,), A."""

    window: DriveWindow
    current: Floats


class Collector:
    """Ticks of one string.

    Attributes
    ----------
    ticks : Stretch
        The present window: mean square current, A², and current, A.
    """

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self.ticks = Stretch(([], []))
        self._soc = (0.0, 0)
        self._flow = (0.0, 0)

    def add(self, tick: Tick, current: float, soc: float, flow: float) -> Drive | None:
        """Include one tick.

        Parameters
        ----------
        tick : Tick
        current : float
            Mean, A.
        soc, flow : float
            Charge, 0…1, and flow over nominal; NaN where unknown.

        Returns
        -------
        Drive or None
            The window that this tick ends or completes.
        """
        drive = None
        if tick.dt > GAP_S or self.ticks.steps_otherwise(tick.dt) or (len(self.ticks) and self._moved(flow)):
            drive = self._close()
        square = tick.mean_square_current
        taken = self.ticks.add(tick, (square, current) if isfinite(square) else None, (0.0, 0.0))
        if taken == "lost":
            return drive or self._close()
        if taken == "waits":
            return drive
        if isfinite(soc):
            self._soc = self._soc[0] + soc, self._soc[1] + 1
        if flow > 0.0:
            self._flow = self._flow[0] + log(flow), self._flow[1] + 1
        return self._close() if self.ticks.length_s >= WINDOW_S - 1e-6 else drive

    def patience(self, dt: float) -> int:
        """Count the regular ticks that `take` may add before `add` must be called: none of them ends a window."""
        if not self.ticks.inlet or self.ticks.steps_otherwise(dt):
            return 0
        return before_full(WINDOW_S, len(self.ticks), dt)

    def take(self, ticks: Ticks) -> None:
        """Add regular ticks of unknown flow, at most `patience` of them; the result is that of `add` for each tick."""
        self.ticks.take(ticks, ticks.square, ticks.current)
        total, count = self._soc
        for soc in ticks.soc[np.isfinite(ticks.soc)].tolist():  # in the order in which `add` would sum them
            total, count = total + soc, count + 1
        self._soc = total, count

    def _moved(self, flow: float) -> bool:
        total, count = self._flow
        return count > 0 and flow > 0.0 and abs(log(flow) - total / count) > FLOW_MOVED

    def _close(self) -> Drive | None:
        """End the window; None if the window is too short or has no reading."""
        ticks, drive = self.ticks, None
        surface, age = ticks.readings.whole()
        square, current = (np.array(column) for column in ticks.of_ticks)
        if ticks.length_s >= SHORTEST_S and np.isfinite(surface).any():
            window = DriveWindow(
                square,
                np.array(ticks.inlet),
                surface,
                age,
                ticks.dt,
                self._soc[0] / self._soc[1] if self._soc[1] else nan,
                float(np.exp(self._flow[0] / self._flow[1])) if self._flow[1] else nan,
            )
            drive = Drive(window, current)
        self._clear()
        return drive
