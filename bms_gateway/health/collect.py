"""Collects the ticks of a drive into windows. A gap, a lost current or a changed flow ends a window early."""

from dataclasses import dataclass
from math import isfinite, log, nan

import numpy as np

from bms_gateway.health.window_fit import DriveWindow
from bms_gateway.identify import Tick, Ticks
from bms_gateway.identify.ticks import before_full
from bms_gateway.identify.window_readings import GAP_S, HOLD_CURRENT_S, HOLD_INLET_S, Gathered
from bms_gateway.thermal import Floats

WINDOW_S, SHORTEST_S = 1200.0, 600.0  # two slow time constants of a cell, and one
FLOW_MOVED = 0.15  # ln: a larger change of the flow ends the window, because a window is fitted with one flow


@dataclass(frozen=True, slots=True)
class Drive:
    """One window, and the mean current of its ticks (K,), A."""

    window: DriveWindow
    current: Floats


class Collector:
    """Ticks of one string."""

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self._square: list[float] = []
        self._current: list[float] = []
        self._inlet: list[float] = []
        self._readings = Gathered()
        self._soc = (0.0, 0)
        self._flow = (0.0, 0)
        self._held = (0.0, 0.0)
        self._dt = 1.0

    def add(self, tick: Tick, current: float, soc: float, flow: float) -> Drive | None:
        """Take in one tick.

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
        if tick.dt > GAP_S or (self._square and (abs(tick.dt - self._dt) > 1e-6 or self._moved(flow))):
            drive = self._close()
        blind, still = self._held
        blind = 0.0 if isfinite(tick.mean_square_current) else blind + tick.dt
        still = 0.0 if isfinite(tick.inlet) else still + tick.dt
        if blind > HOLD_CURRENT_S or still > HOLD_INLET_S:
            return drive or self._close()
        if not self._inlet:
            if blind == still == 0.0:
                self._inlet = [tick.inlet]  # the instant from which the window runs
            return drive
        self._held, self._dt = (blind, still), tick.dt
        self._square.append(self._last(self._square) if blind else tick.mean_square_current)
        self._current.append(self._last(self._current) if blind else current)
        self._inlet.append(self._inlet[-1] if still else tick.inlet)
        self._readings.add(tick.surface, tick.age)
        if isfinite(soc):
            self._soc = self._soc[0] + soc, self._soc[1] + 1
        if flow > 0.0:
            self._flow = self._flow[0] + log(flow), self._flow[1] + 1
        return self._close() if len(self._square) * tick.dt >= WINDOW_S - 1e-6 else drive

    def patience(self, dt: float) -> int:
        """Tell how many regular ticks `take` may add before `add` must be called: none of them ends a window."""
        if not self._inlet or (self._square and abs(self._dt - dt) > 1e-6):
            return 0
        return before_full(WINDOW_S, len(self._square), dt)

    def take(self, ticks: Ticks) -> None:
        """Add regular ticks of unknown flow, at most `patience` of them; the result is that of `add` for each tick."""
        self._held, self._dt = (0.0, 0.0), ticks.dt
        self._square += ticks.square.tolist()
        self._current += ticks.current.tolist()
        self._inlet += ticks.inlet.tolist()
        self._readings.take(ticks.surface, ticks.age)
        total, count = self._soc
        for soc in ticks.soc[np.isfinite(ticks.soc)].tolist():  # in the order in which `add` would sum them
            total, count = total + soc, count + 1
        self._soc = total, count

    def _moved(self, flow: float) -> bool:
        total, count = self._flow
        return count > 0 and flow > 0.0 and abs(log(flow) - total / count) > FLOW_MOVED

    @staticmethod
    def _last(values: list[float]) -> float:
        return values[-1] if values else 0.0

    def _close(self) -> Drive | None:
        """End the window; None if the window is too short or has no reading."""
        seconds, drive = len(self._square) * self._dt, None
        surface, age = self._readings.whole()
        if seconds >= SHORTEST_S and np.isfinite(surface).any():
            window = DriveWindow(
                np.array(self._square),
                np.array(self._inlet),
                surface,
                age,
                self._dt,
                self._soc[0] / self._soc[1] if self._soc[1] else nan,
                float(np.exp(self._flow[0] / self._flow[1])) if self._flow[1] else nan,
            )
            drive = Drive(window, np.array(self._current))
        self._clear()
        return drive
