"""Readings of a window as means over a few seconds, and the numbers that the fit of a window finds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.contract import log_prior
from bms_gateway.identify.model_noise import Whitener
from bms_gateway.identify.sensor_noise import slow_rounding
from bms_gateway.identify.window_start import at_readings, lateness
from bms_gateway.thermal import KINDS, Floats, StringModel

MEAN_S = 4.0  # averaging time of readings: half a casing's time constant


@dataclass(frozen=True, slots=True)
class Means:
    """Readings of m thermocouples over K ticks, as G means over `MEAN_S`.

    Attributes
    ----------
    sensed : list of int
        0-based cells with a thermocouple.
    seen : ndarray of bool (K, m)
        Which readings exist.
    late : ndarray (K, m)
        Age of a reading, in ticks.
    first : ndarray of int (G,)
        Tick at which each mean begins.
    count : ndarray (G, m)
        Readings in each mean.
    valid : ndarray of bool (G, m)
        Which means have any.
    y : ndarray (G, m), °C
        NaN where nothing was read.
    dt : float, s
        From mean to mean.
    rounding : float, K
        Slow error by the steps of the readings.
    """

    sensed: list[int]
    seen: NDArray[np.bool_]
    late: Floats
    first: NDArray[np.intp]
    count: Floats
    valid: NDArray[np.bool_]
    y: Floats
    dt: float
    rounding: float

    @classmethod
    def of(cls, surface: Floats, age: Floats, sensed: list[int], dt: float) -> "Means":
        """Average readings (K, n), °C with NaN for none, with their age, s; `dt`: length of a tick, s."""
        read = surface[:, sensed]
        seen = np.isfinite(read)
        first = np.arange(0, len(surface), max(1, round(MEAN_S / dt)))
        count = np.add.reduceat(seen.astype(np.float64), first)
        valid = count > 0.0
        y = np.where(valid, _means(read, seen, first, count), np.nan)
        return cls(
            sensed=sensed,
            seen=seen,
            late=lateness(age, dt, sensed),
            first=first,
            count=count,
            valid=valid,
            y=y,
            dt=dt * float(first[1] if len(first) > 1 else 1.0),
            rounding=_rounding(read, dt),
        )

    def read(self, Y: Floats) -> Floats:
        """Surfaces (K + 1, m, …) at the readings' own times, as means over `MEAN_S` (G, m, …).

        They are means of the model's values at the readings, just as `y` are means of the readings. So only changes
        faster than `MEAN_S` are lost, which are noise, and all filters have fewer steps.
        """
        return _means(at_readings(Y, self.late), self.seen, self.first, self.count)

    def whitener(self, white: float, slow: float, tau: float, constant: float) -> Whitener:
        """Filter of a noise with a white, a slow and a constant part, K; the slow part has the memory `tau`, s.

        Means of fewer readings have more white noise.
        """
        whites = white * np.sqrt(self.count.max() / np.maximum(self.count, 1.0))
        return Whitener.of(self.valid, whites, slow, tau, self.dt, constant)


def _means(x: Floats, seen: NDArray[np.bool_], first: NDArray[np.intp], count: Floats) -> Floats:
    """Means (G, m, …) of values at the readings (K, m, …); 0 without a reading."""
    more = (1,) * (x.ndim - 2)
    total = np.add.reduceat(np.where(seen.reshape(*seen.shape, *more), x, 0.0), first)
    return np.asarray(total / np.maximum(count, 1.0).reshape(*count.shape, *more), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Sought:
    """The p numbers of a string that the fit of a window finds, as logarithms φ, and their prior.

    Attributes
    ----------
    names : tuple of str
    mean : ndarray (p,)
        Of the prior.
    info : ndarray (p,)
        Information of the prior; 0 for fixed numbers.
    free : ndarray of int
        Places of the numbers that are not fixed.
    low, high : ndarray (p,)
        Bounds.
    """

    names: tuple[str, ...]
    mean: Floats
    info: Floats
    free: NDArray[np.intp]
    low: Floats
    high: Floats

    @classmethod
    def of(cls, model: StringModel) -> "Sought":
        """Take them from a model."""
        names, mean, sd = log_prior(model)
        free = np.flatnonzero(sd > 0.0)
        info = np.zeros(len(names))
        info[free] = sd[free] ** -2
        low, high = (np.log([getattr(KINDS[s], side) for s in names]) for side in ("lower", "upper"))
        return cls(names, mean, info, free, low, high)


def _rounding(y: Floats, dt: float) -> float:
    """Greatest slow rounding error of m thermocouples (K, m), K: the bus rounds all of a string equally."""
    t = dt * np.arange(len(y))
    return max(
        (slow_rounding(t[seen], column[seen]) for column, seen in zip(y.T, np.isfinite(y.T), strict=True)), default=0.0
    )
