"""Forecast of the load and the inlet of strings: the present values, with the errors that such forecasts had so far.

A current that has been *steady* for twenty seconds is expected to stay constant. For any other current, the mean square
of the last minutes is expected to continue. For each horizon, the errors of such forecasts of load and inlet are
averaged over an hour. So no model of drives is needed, and a vehicle that charges for hours gets a narrow band.
"""

from collections.abc import Mapping, Sequence
from math import exp
from typing import Any, Final

import numpy as np

from bms_gateway.engine.forecast_result import Load10
from bms_gateway.observe.ahead import ENDS, HORIZONS_S, STEP_S
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats

RESTLESS_S = 120.0
"""Time constant of the mean of a load that is not steady. Of 10, 20, 30, 60, 120, 240 and 600 s it gives the best
forecasts for one to ten minutes on eight drives."""
STEADY = 0.2
"""Largest relative difference of the squared current within two steps for which the current counts as steady."""
LEAST_A2 = 1.0
"""A²: a smaller squared current counts as steady whatever its noise."""
MEMORY_S = 3600.0
PRIOR_STEPS = 12.0
"""Weight of the assumed errors against the observed ones: two minutes of observed errors weigh as much."""
PRIOR_LOAD = 1.0
"""Assumed relative error of a forecast load before any error was observed; it is 0.5 to 1.2 on drives."""
PRIOR_INLET_K = 0.5
"""Assumed change of the inlet in ten minutes, K."""
HEAT_S = 600.0
"""Time constant of the mean heat from voltages per square of the current."""
MOST: Final = 1e15
"""A⁴: more than the square of any mean square current."""
LEAST_KNOWN = 0.5
"""Least share of a step's seconds that must be known."""


class Load:
    """Forecasts of the load of S strings.

    Attributes
    ----------
    square, current : ndarray (S,)
        Forecast mean square of the current, A², and mean current, A; NaN before anything is known.
    steady : ndarray of bool (S,)
        Whether the current is steady.
    heat_per_square : ndarray (S,), W/A²
        Heat of a mean cell from its voltage over the squared current; NaN if unknown.
    """

    def __init__(self, strings: int) -> None:
        self.square, self.current, self.heat_per_square = np.full((3, strings), np.nan)
        self.steady = np.zeros(strings, np.bool_)
        self.inlet = np.full(strings, np.nan)
        self._slow, self._mean = np.full((2, strings), np.nan)
        # last step: least, greatest and mean squared current, mean current
        self._before = np.full((4, strings), np.nan)
        self._heat = np.zeros((2, strings))
        H = len(ENDS)
        self._error, self._strayed, self._weight = np.zeros((H, strings)), np.zeros((H, strings)), np.zeros(H)
        self._past: list[tuple[Floats, Floats, Floats]] = []  # forecasts, inlets and squared currents of the last steps

    def forget(self) -> None:
        """Start again after a time without frames; the errors of earlier forecasts are kept."""
        self._past.clear()
        self._before[:] = np.nan
        self._slow[:], self._mean[:] = np.nan, np.nan

    def take(self, means: Floats, inlet: Floats, heat: Sequence[Floats] = ()) -> Load10:
        """Include a step.

        Parameters
        ----------
        means : ndarray (T, 5, S)
            Means of its ticks, as `Readings.means`.
        inlet : ndarray (S,), °C
            Newest inlet; NaN if unknown.
        heat : sequence of ndarray (S,), W
            Heat of a mean cell from its voltage, for each tick; NaN if unknown. Empty if no string has a voltage.
        """
        I, square = means[:, 0], means[:, 1]  # noqa: E741
        known = np.isfinite(square)
        whole = known.all(axis=0)
        count = known.sum(axis=0)
        enough = count >= LEAST_KNOWN * len(square)
        divisor = np.where(enough, count, np.nan)
        now = np.where(known, square, 0.0).sum(axis=0) / divisor
        current = np.where(known, I, 0.0).sum(axis=0) / divisor
        share = 1.0 - exp(-STEP_S / RESTLESS_S)
        self._slow = _followed(self._slow, now, share)
        self._mean = _followed(self._mean, current, share)
        low, high = np.where(whole, square.min(axis=0), np.nan), np.where(whole, square.max(axis=0), np.nan)
        least, most = np.minimum(low, self._before[0]), np.maximum(high, self._before[1])
        self.steady = (most - least <= STEADY * most) | (most <= LEAST_A2)
        self.square = np.where(self.steady, (now + self._before[2]) / 2.0, self._slow)
        self.current = np.where(self.steady, (current + self._before[3]) / 2.0, self._mean)
        self._before = np.stack((low, high, now, current))
        self.inlet = np.where(np.isfinite(inlet), inlet, self.inlet)
        if heat:
            self._by_voltage(square, np.stack(heat))
        self._learn(now)
        return Load10(current, now, inlet)

    def _by_voltage(self, square: Floats, heat: Floats) -> None:
        both = np.isfinite(square) & np.isfinite(heat)
        fresh = np.stack((np.where(both, heat, 0.0).sum(axis=0), np.where(both, square, 0.0).sum(axis=0)))
        self._heat = self._heat * exp(-STEP_S / HEAT_S) + fresh
        made, squares = self._heat
        self.heat_per_square = np.divide(made, squares, out=np.full(len(made), np.nan), where=squares > LEAST_A2)

    def _learn(self, now: Floats) -> None:
        """Compare the earlier forecasts with the present values."""
        self._past.append((self.square, self.inlet, now))
        if len(self._past) > ENDS[-1] + 1:
            del self._past[0]
        for h, steps in enumerate(ENDS):
            if len(self._past) <= steps:
                break
            guessed, inlet, _ = self._past[-steps - 1]
            came = np.stack([p[2] for p in self._past[-steps:]]).mean(axis=0)
            self._weight[h] += 1.0
            share = max(1.0 / (self._weight[h] + PRIOR_STEPS), STEP_S / MEMORY_S)
            self._error[h] += share * np.nan_to_num(np.square(came - guessed) - self._error[h])
            self._strayed[h] += share * np.nan_to_num(np.square(self.inlet - inlet) - self._strayed[h])

    def square_sd(self) -> Floats:
        """Return the expected errors (H, S) of the forecast loads, A²; those of usual drives at the start."""
        left = PRIOR_STEPS / (self._weight + PRIOR_STEPS)
        first = np.square(PRIOR_LOAD * np.nan_to_num(self.square))
        return np.asarray(np.sqrt(self._error + left[:, None] * first), dtype=np.float64)

    def inlet_sd(self) -> Floats:
        """Return the expected change (H, S) of the inlets from now on, K."""
        left = PRIOR_STEPS / (self._weight + PRIOR_STEPS)
        first = PRIOR_INLET_K**2 * np.array(HORIZONS_S) / HORIZONS_S[-1]
        return np.asarray(np.sqrt(self._strayed + (left * first)[:, None]), dtype=np.float64)

    def snapshot(self) -> dict[str, Any]:
        """Return the errors of forecasts, and the heat from voltages, as lists of numbers."""
        return {name: plain(getattr(self, f"_{name}")) for name in _KEPT}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a snapshot of the same number of strings.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not such a snapshot.
        """
        taken = {name: like(state[name], getattr(self, f"_{name}")) for name in _KEPT}
        if not all((np.isfinite(a) & (np.abs(a) < MOST)).all() for a in taken.values()):
            raise ValueError("load: holds what is no error of a guess")
        for name, value in taken.items():
            setattr(self, f"_{name}", value)


_KEPT = ("error", "strayed", "weight", "heat")


def _followed(mean: Floats, now: Floats, share: float) -> Floats:
    """Update a running mean; it begins with the first value, and an unknown value leaves it unchanged."""
    mean = np.where(np.isnan(mean), now, mean)
    return np.where(np.isnan(now), mean, mean + share * (now - mean))
