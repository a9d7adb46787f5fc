"""Errors of a model at each sensor: size, structured part, place, time and regime."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.regimes import (
    FEATURES,
    Regime,
    instants_of,
    interval_of,
    regimes,
    seconds_of,
    stretches,
    string_features,
    surfaces,
)
from bms_gateway.diagnosis.residuals import (
    HELD_RATIO,
    LAGS,
    LEAST_STRUCTURE,
    LEAST_Z,
    Structure,
    least_structure,
    structure,
    structure_of,
)
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import Floats

BLOCKS = 24
"""Number of blocks of time per record over which the excess is divided."""
MOST_EXCESS = 0.5
"""Least share of the excess in the blocks that are reported."""
APART_S = 1e4
"""Time between records, so that no time stretch contains two of them."""
CHANCE_Z = 3.0


@dataclass(frozen=True, slots=True)
class Level:
    """Distance of readings from a model.

    Attributes
    ----------
    readings : int
    rmse_K : float
        NaN without a reading.
    floor_K : float
        Error that noise and rounding alone would cause: of fitted and held-out readings together, so that a record has
        one noise.
    """

    readings: int
    rmse_K: float
    floor_K: float

    @property
    def ratio(self) -> float:
        """Error over noise floor: 1 for a perfect model."""
        return self.rmse_K / self.floor_K


@dataclass(frozen=True, slots=True)
class Worst:
    """The largest error of a sensor, mean of about half a minute: record, time in s since its start, error in K."""

    record: int
    time_s: float
    error_K: float


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of time with much of the excess error.

    Attributes
    ----------
    record : int
    first_s, last_s : float, s since the record began
    share : float
        Of the mean square above the noise, over all sensors and records.
    rmse_K : float
    """

    record: int
    first_s: float
    last_s: float
    share: float
    rmse_K: float


@dataclass(frozen=True, slots=True)
class Series:
    """One sensor over one record, for a plot.

    Attributes
    ----------
    record, cell : int
        Cell from 1.
    time_s : ndarray (K,), s since the record began
    measured, model : ndarray (K,), °C
    held : ndarray of bool (K,)
        Readings that were never fitted.
    """

    record: int
    cell: int
    time_s: Floats
    measured: Floats
    model: Floats
    held: NDArray[np.bool_]

    @property
    def residual(self) -> Floats:
        """Reading minus model, K."""
        return self.measured - self.model


@dataclass(frozen=True, slots=True)
class Sensor:
    """One cell's sensor against a model, over all records.

    Attributes
    ----------
    cell : int
    trained, held : Level
    structured_K, z : float
        Error that is correlated over some samples, and its distance from chance in sd.
    share : float
        Of the mean square above the noise, over all sensors.
    worst : Worst
    regimes : tuple of Regime
        `always` first, then the one that explains most.
    least_structure : float
        Structured error, in units of the noise, above which the model fails here.
    """

    cell: int
    trained: Level
    held: Level
    structured_K: float
    z: float
    share: float
    worst: Worst
    regimes: tuple[Regime, ...]
    least_structure: float = LEAST_STRUCTURE

    @property
    def disagrees(self) -> bool:
        """Whether the model fails here."""
        structured = self.z > LEAST_Z and self.structured_K > self.least_structure * self.trained.floor_K
        return structured or self.held.ratio > HELD_RATIO


def levels(error: Floats, sigma: Floats, used: NDArray[np.bool_]) -> tuple[Level, Level]:
    """Errors of the fitted and of the held-out readings among some, with one noise: that of all of them."""
    floor = float(np.sqrt(np.mean(sigma**2)))

    def of(rows: NDArray[np.bool_]) -> Level:
        n = int(rows.sum())
        return Level(n, float(np.sqrt(np.mean(error[rows] ** 2))) if n else float("nan"), floor)

    return of(used), of(~used)


def series(fit: MapFit) -> tuple[Series, ...]:
    """Collect readings and model of each sensor over each record."""
    found, first = [], 0
    for r, m in enumerate(fit.problem.records):
        model = fit.y[first : first + len(m.y)]
        first += len(m.y)
        t = seconds_of(m)
        for j, (_, cell) in enumerate(m.channels):
            mine = m.channel == j
            found.append(Series(r, cell, t[mine], m.y[mine], model[mine], ~m.used[mine]))
    return tuple(found)


def sensors(fit: MapFit) -> tuple[Sensor, ...]:
    """List one sensor per sensed cell, with the readings of all records together."""
    problem = fit.problem
    _, sigma, _, _, used = stacked(problem)
    sizes = [len(m.y) for m in problem.records]
    record = np.repeat(np.arange(len(sizes)), sizes)
    t = np.concatenate([seconds_of(m) for m in problem.records])
    cell = np.concatenate([np.array([k for _, k in m.channels])[m.channel] for m in problem.records])
    error = stacked(problem)[0] - fit.y
    features = _features(fit)
    peak = max(float(m.drive.I_abs.max()) for m in problem.records)
    inflation = structure(fit).inflation
    dt = problem.records[0].drive.dt
    excess = {k: _excess(error[cell == k], sigma[cell == k]) for k in sorted(set(cell.tolist()))}
    total = max(sum(excess.values()), 1e-12)
    found = []
    for k, own in excess.items():
        mine = cell == k
        runs = [fit.r[mine & used & (record == r)] for r in range(len(sizes))]
        long = [r for r in runs if len(r) > max(LAGS)]
        s = structure_of(long) if long else Structure(0.0, 0.0, 1.0)
        # a coarse step is an interval to a fit: the sizes of r and of the error differ
        r = fit.r[mine & used]
        in_K = float(np.sqrt(np.mean(error[mine & used] ** 2) / max(np.mean(r**2), 1e-12))) if len(r) else 0.0
        offset = record[mine] * (APART_S + float(t.max()))
        found.append(
            Sensor(
                k,
                *levels(error[mine], sigma[mine], used[mine]),
                s.size * in_K,
                float(s.z),
                own / total,
                _worst(error[mine], t[mine], record[mine], s.inflation),
                regimes(
                    error[mine],
                    sigma[mine],
                    {name: x[mine] for name, x in features.items()},
                    stretches(t[mine] + offset, inflation, dt),
                    peak,
                ),
                least_structure(fit),
            )
        )
    return tuple(found)


def _excess(error: Floats, sigma: Floats) -> float:
    return max(float(np.sum(error**2) - np.sum(sigma**2)), 0.0)


def _features(fit: MapFit) -> dict[str, Floats]:
    """Features (M,) at the readings of all records: those that every record has, the same for every model."""
    parts: list[dict[str, Floats]] = []
    for m in fit.problem.records:
        at = interval_of(m)
        part = {name: x[at] for name, x in string_features(m.drive).items()}
        parts.append(part | {"surface": surfaces(m)})
    return {name: np.concatenate([p[name] for p in parts]) for name in FEATURES if all(name in p for p in parts)}


def _worst(error: Floats, t: Floats, record: NDArray[np.intp], inflation: float) -> Worst:
    """Largest error of a moving mean, so that noise alone does not choose it."""
    width = min(max(int(min(inflation, 30.0)), 5), len(error))
    calm = np.convolve(error, np.full(width, 1.0 / width), "same")
    inside = np.ones(len(error), np.bool_)
    edge = width // 2
    for r in np.unique(record):
        rows = np.flatnonzero(record == r)
        inside[rows[:edge]] = False
        inside[rows[len(rows) - edge :]] = False
    k = int(np.argmax(np.where(inside, np.abs(calm), -1.0)))
    return Worst(int(record[k]), float(t[k]), float(calm[k]))


def blocks(fit: MapFit) -> tuple[Block, ...]:
    """Blocks of time with most of the excess error; neighbouring blocks are joined."""
    found: list[Block] = []
    y, sigma, _, _, _ = stacked(fit.problem)
    square, white = (y - fit.y) ** 2, sigma**2
    first = 0
    for r, m in enumerate(fit.problem.records):
        part = slice(first, first + len(m.y))
        first += len(m.y)
        t = seconds_of(m)
        ends = instants_of(m)
        edges = np.linspace(ends[0], ends[-1], BLOCKS + 1)
        at = np.clip(np.searchsorted(edges, t, "right") - 1, 0, BLOCKS - 1)
        n = np.maximum(np.bincount(at, minlength=BLOCKS), 1)
        total, floor = np.bincount(at, square[part], BLOCKS), np.bincount(at, white[part], BLOCKS)
        # the mean square of n white readings scatters by √(2/n): less than three times this is noise
        above = np.where(total - floor > 3.0 * np.sqrt(2.0 / n) * floor, total - floor, 0.0)
        found += [
            Block(r, float(edges[b]), float(edges[b + 1]), float(above[b]), float(np.sqrt(total[b] / n[b])))
            for b in range(BLOCKS)
        ]
    whole = sum(b.share for b in found)
    if whole == 0.0:
        return ()
    chosen: list[Block] = []
    carried = 0.0
    for b in sorted(found, key=lambda b: -b.share):
        if carried >= MOST_EXCESS * whole:
            break
        chosen.append(b)
        carried += b.share
    chosen.sort(key=lambda b: (b.record, b.first_s))
    merged: list[Block] = []
    for b in (replace(b, share=b.share / whole) for b in chosen):
        last = merged[-1] if merged else None
        if last is not None and last.record == b.record and abs(last.last_s - b.first_s) < 1e-6:
            both = float(np.sqrt((last.rmse_K**2 + b.rmse_K**2) / 2.0))
            merged[-1] = Block(b.record, last.first_s, b.last_s, last.share + b.share, both)
        else:
            merged.append(b)
    return tuple(merged)


def nearest(found: Sequence[Sensor], cells: int) -> list[float]:
    """Significant structured error of the sensor next to each cell, K."""
    at = np.array([s.cell for s in found])
    size = [s.structured_K if s.z > CHANCE_Z else 0.0 for s in found]
    return [size[int(np.argmin(np.abs(at - k)))] for k in range(1, cells + 1)]
