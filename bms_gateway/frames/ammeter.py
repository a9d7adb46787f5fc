"""Checks of the current sensor by the voltage of the same string.

The current makes the heat, and its sensor has no peers for comparison. But the terminal voltage follows every step of
the true current at once: V = OCV − R·I. This shows two faults that no range check finds:

* A current that *stands* at one value while the voltage moves. The sensor is stuck, saturates below the end of its
  signal, or clips one direction of the current at zero. Relaxation after a load moves the voltage too, but in one
  direction only, and by less than the load did. So a move counts if the voltage moves in both directions, or further in
  one direction than the steps before can explain. The value is then refused at all times, until readings on both sides
  of it show that it is not an end of the sensor's range.
* A current that rises *with* the voltage. It has the wrong sign.

The checks use means over a tick, so frames of current and voltage need not be synchronous. Values that no battery
voltage has are left out: a sample whose bytes come from two measurements, and steps like those of contactors.
"""

from math import nan, sqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["UNUSUAL", "Ammeter", "mean_voltage"]

MOVED = 0.002
"""Share of the voltage that counts as a move: the response of any cell to a quarter of its one-hour current."""
MOVED_STEPS = 2.5
"""The same in steps of the voltage's resolution: the last digit may flicker."""
UNUSUAL = 0.45
"""Share by which a voltage may leave its usual level; a larger change comes from open contactors or wrong bits."""
STANDS = 4
"""Moves in each direction until the current is refused: some ten seconds of driving."""
BEYOND = 8
"""Moves in one direction, beyond what relaxation explains, until the current is refused."""
RELAXES = 0.5
"""Share of a voltage step with the load that may follow within the seconds after it."""
RECENT = 0.9
"""Share of an earlier voltage step that is still relaxing, per tick with a step."""
MOST = 12
"""Greatest count of moves: more would prove nothing, and a repaired sensor would be refused for too long."""
FORGIVE = 0.01
"""Subtracted from the count at each tick in which the current moves with the voltage, as it should."""
RELEASED = 0.25
"""Share of the count that refuses a value; below this share the value is accepted again."""
MEMORY = 60
"""Ticks with moves over which the sign is judged."""
ENOUGH = 10
REVERSED, RIGHT = 0.7, 0.3
"""Correlation of the steps of voltage and current above which the sign is wrong, and below which it is right again."""


def mean_voltage(V: NDArray[np.float64]) -> float:
    """Mean of the samples (k,) of a tick without those that are far from their median; NaN of none.

    Examples
    --------
    >>> mean_voltage(np.array([513.2, 513.0, 17.9, 513.1]))
    513.1
    """
    if not len(V):
        return nan
    if float(V.max() - V.min()) > UNUSUAL * abs(float(V.mean())):
        middle = float(np.median(V))
        V = V[np.abs(V - middle) <= UNUSUAL * abs(middle)]
    return float(V.mean()) if len(V) else nan


class Ammeter:
    """Checks one current by one voltage.

    Parameters
    ----------
    resolution : float
        Smallest step of the voltage, V; 0 where it is not known.

    Attributes
    ----------
    reversed : bool
        The current has the wrong sign.

    Examples
    --------
    >>> meter = Ammeter(0.1)
    >>> for V in (400, 404, 398, 403, 397, 404, 398, 403, 397):
    ...     meter.update(np.array([20.0, 20.0]), np.array([V, V + 0.1]))
    >>> meter.stands_at
    (20.0,)
    """

    def __init__(self, resolution: float = 0.0) -> None:
        self._step = MOVED_STEPS * resolution
        self.reversed = False
        self._suspects = _Suspect(), _Suspect()  # the positive and the negative end of the sensor's range
        self._I = self._V = nan
        self._stood = False
        self._II = self._IV = self._VV = 0.0
        self._moves = 0
        self._mean_V = 0.0
        self._step_A = self._run_V = 0.0  # largest recent step; moves of the voltage while the current stands still

    @property
    def stands_at(self) -> tuple[float, ...]:
        """Values that are refused, A."""
        return tuple(s.value for s in self._suspects if s.refused)

    @property
    def together(self) -> float:
        """Correlation of the steps of voltage and current; NaN before there are enough."""
        return self._IV / sqrt(self._II * self._VV) if self._moves >= ENOUGH else nan

    @property
    def volts(self) -> float:
        """Recent mean voltage at steps of both, V, without open contactors; NaN before there are enough."""
        return self._mean_V if self._moves >= ENOUGH else nan

    @property
    def resistance(self) -> float:
        """Resistance from the steps of current and voltage, Ω, for either sign; NaN without such steps."""
        return abs(self._IV) / self._II if abs(self.together) >= REVERSED else nan

    def update(self, I: NDArray[np.float64], V: NDArray[np.float64]) -> None:  # noqa: E741
        """Take the accepted samples of one tick, A (discharge positive) and V; either may be empty."""
        if not len(I):
            self.forget()
            return
        low, high = float(I.min()), float(I.max())
        for suspect in self._suspects:
            suspect.acquit(low, high)
        mean_I = float(I.mean())
        mean_V = mean_voltage(V)
        dI, dV = mean_I - self._I, mean_V - self._V
        stands = low == high
        most = UNUSUAL * max(abs(mean_V), abs(self._V))
        if max(MOVED * abs(mean_V), self._step) < abs(dV) < most:  # false where one is not known
            if stands and self._stood and dI == 0.0:
                self._run_V += dV
                explained = -RELAXES * self._IV * self._step_A  # R = −IV/II; without steps seen, nothing is beyond
                beyond = self._moves >= ENOUGH and explained > 0.0 and abs(self._run_V) * self._II > explained
                self._suspects[low < 0.0].accuse(low, dV, beyond)
            elif dI != 0.0:
                for suspect in self._suspects:
                    suspect.forgive()
                self._follow_sign(dI, dV)
                self._mean_V += (mean_V - self._mean_V) / min(self._moves, MEMORY)
        if dI != 0.0:
            self._run_V = 0.0
            self._step_A = max(abs(dI), RECENT * self._step_A) if dI == dI else 0.0
        self._I, self._V, self._stood = mean_I, mean_V, stands

    def forget(self) -> None:
        """Forget the last sample: a step across a gap has no meaning."""
        self._I = self._V = nan
        self._stood = False

    def _follow_sign(self, dI: float, dV: float) -> None:
        keep = 1.0 - 1.0 / MEMORY
        self._II, self._IV, self._VV = keep * self._II + dI * dI, keep * self._IV + dI * dV, keep * self._VV + dV * dV
        self._moves += 1
        if self._moves >= ENOUGH:
            self.reversed = self.together > (RIGHT if self.reversed else REVERSED)


class _Suspect:
    """A value at which the current stood still while the voltage moved."""

    def __init__(self) -> None:
        self.value = nan
        self.refused = False
        self._up = self._down = self._beyond = 0.0
        self._below = self._above = False  # readings on that side of the value

    def accuse(self, value: float, dV: float, beyond: bool) -> None:
        """Count a move of the voltage while the current stood at `value`, and whether relaxation explains it."""
        if value != self.value:
            if self.refused:
                return  # one refused value at a time: it must be accepted again before another is refused
            self.value, self._up, self._down, self._beyond = value, 0.0, 0.0, 0.0
        # a sensor that stands still again is stuck again, whatever it read before
        self._below = self._above = False
        if dV > 0:
            self._up = min(MOST, self._up + 1.0)
        else:
            self._down = min(MOST, self._down + 1.0)
        self._beyond = min(MOST, self._beyond + beyond)
        self._decide()

    def acquit(self, low: float, high: float) -> None:
        """Accept a refused value again once there were readings above and below it: it is not an end of the range."""
        self._below |= low < self.value
        self._above |= high > self.value
        if self._below and self._above:
            self._up = self._down = self._beyond = 0.0
            self._decide()

    def forgive(self) -> None:
        """Lower the count a little for a current that moves with the voltage."""
        self._up, self._down, self._beyond = (max(0.0, x - FORGIVE) for x in (self._up, self._down, self._beyond))
        self._decide()

    def _decide(self) -> None:
        doubt = max(min(self._up, self._down) / STANDS, self._beyond / BEYOND)
        self.refused = doubt >= 1.0 or (self.refused and doubt >= RELEASED)
