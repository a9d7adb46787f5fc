"""Consecutive ticks of one string, as every fit collects them; short gaps are filled with the last value.

The window of a string (`window_now.py`), R_e of its cells (`cell_live.py`) and its health (`health/collect.py`) have
one each and decide how long it may become.
"""

from dataclasses import dataclass, field
from math import ceil, isfinite
from typing import Literal

from bms_gateway.identify.contract import Tick
from bms_gateway.identify.ticks import Ticks
from bms_gateway.identify.window_readings import Gathered
from bms_gateway.thermal import Floats

HOLD_CURRENT_S, HOLD_INLET_S = 10.0, 60.0
"""Time for which the last value replaces a missing one: a lost current cannot hide a drive; the inlet moves slowly."""


@dataclass(slots=True)
class Stretch:
    """Consecutive ticks of n cells.

    An inlet that was missing is interpolated when it comes back. A stretch that ends because a value stayed missing
    ends where all values were last known.

    Attributes
    ----------
    of_ticks : tuple of list of float
        Columns with values of each tick, chosen by the caller: heat, current and the like.
    inlet : list of float, °C
        At the instants, one more than ticks; empty before the first.
    readings : Gathered
        Of each tick.
    dt : float, s
        Length of its ticks; 0 before the first.
    held : (float, float), s
        Time for which the values of the ticks and the inlet have been missing.

    Examples
    --------
    >>> import numpy as np
    >>> from math import nan
    >>> stretch, none = Stretch(([],)), np.zeros(0)
    >>> for current, inlet in (2.0, 20.0), (2.0, 20.0), (3.0, nan), (None, 22.0):
    ...     known = None if current is None else (current,)
    ...     _ = stretch.add(Tick(0, 1.0, nan, nan, inlet, none, none), known, (0.0,))
    >>> stretch.of_ticks, stretch.inlet
    (([2.0, 3.0, 3.0],), [20.0, 20.0, 21.0, 22.0])
    """

    of_ticks: tuple[list[float], ...]
    inlet: list[float] = field(default_factory=list)
    readings: Gathered = field(default_factory=Gathered)
    dt: float = 0.0
    held: tuple[float, float] = (0.0, 0.0)

    def __len__(self) -> int:
        """Count the ticks."""
        return len(self.of_ticks[0])

    @property
    def length_s(self) -> float:
        """Length, s."""
        return len(self) * self.dt

    def steps_otherwise(self, dt: float) -> bool:
        """Whether ticks of `dt` seconds differ in length from the earlier ones."""
        return len(self) > 0 and abs(dt - self.dt) > 1e-6

    def add(
        self, tick: Tick, values: tuple[float, ...] | None, before_any: tuple[float, ...]
    ) -> Literal["taken", "waits", "lost"]:
        """Take in one tick.

        Parameters
        ----------
        tick : Tick
            Its inlet may be NaN: not known.
        values : tuple of float or None
            One per column; None if they are not known.
        before_any : tuple of float
            Replaces values that are not known in the first tick.

        Returns
        -------
        {"taken", "waits", "lost"}
            "waits": there is no first tick with known values and inlet yet. "lost": values or inlet were missing for
            longer than the last one may replace them; the stretch has been cut to the known part, and is over.
        """
        inlet = tick.inlet
        blind = self.held[0] + tick.dt if values is None else 0.0
        still = 0.0 if isfinite(inlet) else self.held[1] + tick.dt
        if blind > HOLD_CURRENT_S or still > HOLD_INLET_S:
            self._cut(max(self.held))
            return "lost"
        if not self.inlet:
            if blind == still == 0.0:
                self.inlet = [inlet]  # the instant at which the stretch begins
            return "waits"
        if values is None:
            values = tuple(column[-1] for column in self.of_ticks) if len(self) else before_any
        if not still:
            self._join(tick.dt, inlet)
        self.held, self.dt = (blind, still), tick.dt
        for column, value in zip(self.of_ticks, values, strict=True):
            column.append(value)
        self.readings.add(tick.surface, tick.age)
        self.inlet.append(self.inlet[-1] if still else inlet)
        return "taken"

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Remove the readings of a cell (0-based) in the last seconds: its thermocouple was wrong."""
        if len(self):
            self.readings.drop(cell, ceil(seconds / self.dt))

    def take(self, ticks: Ticks, *columns: Floats) -> None:
        """Include complete regular ticks with their values (K,); the same as adding them one by one."""
        self._join(ticks.dt, float(ticks.inlet[0]))
        self.held, self.dt = (0.0, 0.0), ticks.dt
        for column, values in zip(self.of_ticks, columns, strict=True):
            column += values.tolist()
        self.inlet += ticks.inlet.tolist()
        self.readings.take(ticks.surface, ticks.age)

    def _join(self, dt: float, inlet: float) -> None:
        """Interpolate the inlet over the ticks in which it was held."""
        held = min(round(self.held[1] / dt), len(self.inlet) - 1)
        for k in range(held):
            self.inlet[k - held] += (inlet - self.inlet[-1 - held]) * (k + 1) / (held + 1)

    def _cut(self, seconds: float) -> None:
        """Remove the last seconds: the values held there never became known."""
        left = max(0, len(self) - round(seconds / self.dt)) if len(self) else 0
        for column in self.of_ticks:
            del column[left:]
        del self.inlet[left + 1 :]
        self.readings.cut(left)
