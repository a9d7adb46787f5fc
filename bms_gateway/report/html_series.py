"""Long series for a page: few points that hide no excursion, open gaps, and time in a readable unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from bms_gateway.diagnosis.compare import Variant
from bms_gateway.diagnosis.core_band import CoreBand, core_bands, half_width_K
from bms_gateway.diagnosis.grid import bridged
from bms_gateway.diagnosis.misfit import Level, Sensor, levels, nearest, sensors
from bms_gateway.diagnosis.regimes import instants_of, seconds_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import Floats

MOST_POINTS = 4000
"""Points per trace: more than a screen has columns."""
ALL_POINTS = 60_000
"""Points of all traces of readings on a page, three quarters of a megabyte: with a dozen sensors, each gets fewer
points."""
LARGEST_POINTS = 170_000
"""Number of points of all traces together, also of many steps of sixty cells: a report then has less than 2 MB."""
SMOOTH_S = 60.0
"""Averaging time of a shown residual: core and surface exchange heat in tens of seconds."""
HOURS_FROM_S = 3.0 * 3600.0
LEAST_ROWS = 3
"""Number of readings above which the usual time between two is known."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One model as a page shows it.

    Attributes
    ----------
    name : str
        In legends and headings.
    fit : MapFit
    sensors : tuple of Sensor
    cores : tuple of CoreBand, one per record
    proven : bool
        Whether its cores are proven; otherwise their bands are hatched.
    """

    name: str
    fit: MapFit
    sensors: tuple[Sensor, ...]
    cores: tuple[CoreBand, ...]
    proven: bool = True

    @classmethod
    def of(cls, name: str, v: Variant, proven: bool = True) -> "Shown":
        """Return a variant of a comparison under a name."""
        return cls(name, v.fit, v.sensors, v.cores, proven)

    @property
    def levels(self) -> tuple[Level, Level]:
        """Errors of all sensors together: fitted readings, held-out readings."""
        y, sigma, _, _, used = stacked(self.fit.problem)
        return levels(y - self.fit.y, sigma, used)

    @property
    def worst_core(self) -> tuple[float, int]:
        """Widest 95 % half width of a core, K, and its cell."""
        half = half_width_K(self.cores)
        return float(half.max()), int(np.argmax(half)) + 1


def shown(name: str, fit: MapFit, cores: Sequence[CoreBand] = (), proven: bool = True) -> Shown:
    """Return a fit in the form for a page; with its cores, if they are already computed."""
    found = sensors(fit)
    return Shown(name, fit, found, tuple(cores) or core_bands(fit, nearest(found, fit.problem.model.cells)), proven)


@dataclass(frozen=True, slots=True)
class Trace:
    """One thermocouple of one record, with the models.

    Attributes
    ----------
    record, cell : int
        Cell from 1.
    time_s : ndarray (K,), s since the record began
    measured : ndarray (K,), °C
    models : tuple of ndarray (K,), °C
        Before and, if there is one, after.
    sigma_K : float
        Noise and rounding of one reading.
    breaks_s : tuple of float
        Starts of stretches with their own start, and long times without readings: lines are interrupted there.
    """

    record: int
    cell: int
    time_s: Floats
    measured: Floats
    models: tuple[Floats, ...]
    sigma_K: float
    breaks_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Clock:
    """Unit of a time axis: seconds per unit, and its name."""

    seconds: float
    unit: str

    def __call__(self, t: Floats) -> list[float]:
        """Convert times to the unit of the axis, to a twentieth of a second or better."""
        return [round(x, 4) for x in (np.asarray(t) / self.seconds).tolist()]

    def around(self, first: float, last: float) -> list[float]:
        """Return the ends of an axis, in its unit, that contain both times, s, in spite of rounding."""
        return [floor(1e4 * first / self.seconds) / 1e4, ceil(1e4 * last / self.seconds) / 1e4]


def clock(longest_s: float) -> Clock:
    """Choose minutes or hours."""
    return Clock(60.0, "min") if longest_s < HOURS_FROM_S else Clock(3600.0, "h")


def traces_of(fits: Sequence[MapFit]) -> list[Trace]:
    """Return readings with the models of several fits of the same records."""
    found, first = [], 0
    _, sigma, _, _, _ = stacked(fits[0].problem)
    for r, m in enumerate(fits[0].problem.records):
        part = slice(first, first + len(m.y))
        first += len(m.y)
        t, starts = seconds_of(m), breaks_of(m)
        for j, (_, cell) in enumerate(m.channels):
            mine = m.channel == j
            if not mine.any():
                continue
            models = tuple(f.y[part][mine] for f in fits)
            breaks = tuple(sorted((*starts, *missing_in(t[mine]))))
            found.append(Trace(r, cell, t[mine], m.y[mine], models, float(sigma[part][mine][0]), breaks))
    return found


def held_out(m: Measured) -> list[tuple[float, float]]:
    """Find stretches of time, s since the record began, whose readings were never fitted."""
    order = np.argsort(seconds_of(m), kind="stable")
    t, held = seconds_of(m)[order], ~m.used[order]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], held.astype(np.int8), [0]])))
    return [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def envelope(t: Floats, y: Floats, most: int) -> tuple[Floats, Floats]:
    """Thin a series to at most `most` points without hiding an excursion.

    Parameters
    ----------
    t, y : ndarray (K,)
        Without NaN.
    most : int
        At least 2.

    Returns
    -------
    t, y : ndarray (≤ most,)
        The series itself if it is short, else least and greatest value of each of `most`/2 stretches of equal length,
        at their times.
    """
    n = len(y)
    if n <= most:
        return t, y
    size = -(-n // (most // 2))
    stretches = np.pad(y, (0, -n % size), mode="edge").reshape(-1, size)
    first = size * np.arange(len(stretches))
    ends = np.stack([first + stretches.argmin(axis=1), first + stretches.argmax(axis=1)], axis=1)
    rows = np.minimum(np.sort(ends, axis=1).ravel(), n - 1)
    return t[rows], y[rows]


def smooth(t: Floats, y: Floats, breaks_s: Sequence[float]) -> tuple[Floats, Floats]:
    """Average a series over stretches of time, at their mean times."""
    segment = np.searchsorted(np.asarray(breaks_s), t, side="right")
    at = np.floor(t / SMOOTH_S).astype(np.int64) + segment * (int(t.max() / SMOOTH_S) + 2)
    _, index, count = np.unique(at, return_inverse=True, return_counts=True)
    return np.bincount(index, t) / count, np.bincount(index, y) / count


def broken(t: Floats, y: Floats, breaks_s: Sequence[float]) -> tuple[Floats, Floats]:
    """Interrupt a line at each gap, by a point without a value."""
    at = np.searchsorted(t, np.asarray(breaks_s))
    inside = (at > 0) & (at < len(t))
    return np.insert(t, at[inside], np.asarray(breaks_s)[inside]), np.insert(y, at[inside], np.nan)


def missing_in(t: Floats, *, held: bool = False) -> tuple[float, ...]:
    """Return the middle, s, of each time without readings that is too long for a straight line.

    Of values that are `held`, it is the time up to which the last one may be held.

    Examples
    --------
    >>> missing_in(np.concatenate([np.arange(0.0, 400.0), np.arange(700.0, 900.0)]))
    (549.5,)
    >>> missing_in(np.concatenate([np.arange(0.0, 400.0), np.arange(400.0, 900.0, 60.0)]))  # rows of a rest
    ()
    """
    if len(t) < LEAST_ROWS:
        return ()
    longest, apart = bridged(t)
    wide = np.flatnonzero(np.diff(t) > apart)
    if held:
        return tuple((t[wide] + longest).tolist())
    return tuple(float(x) for x in (t[wide] + t[wide + 1]) / 2.0)


def points_each(traces: int) -> int:
    """Return the number of points that a trace of a page may have.

    Examples
    --------
    >>> points_each(10), points_each(420), points_each(660)
    (4000, 400, 257)
    """
    fair = int(np.clip(ALL_POINTS // max(traces, 1), 400, MOST_POINTS))
    return max(min(fair, LARGEST_POINTS // max(traces, 1)), 100)


def extent(m: Measured) -> tuple[float, float]:
    """Return first and last time of a record, s since it began, with the interval that its last rows only begin."""
    t = instants_of(m)
    return float(t[0]), float(t[-1] + m.drive.dt)


def breaks_of(m: Measured) -> tuple[float, ...]:
    """Return the beginnings of stretches with their own start, s since the record began."""
    t = instants_of(m)
    first = np.cumsum([len(s) + 1 for s in m.spans])[:-1]
    return tuple(float(x) for x in t[first])
