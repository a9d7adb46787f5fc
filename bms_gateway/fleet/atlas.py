"""The residual atlas: errors by regime and cell, laid side by side over all vehicles.

An error that every vehicle makes at the same place and in the same regime is an error of the model: it lacks an effect.
An error that one vehicle alone makes at one cell is a defect of that cell. One vehicle with errors at all cells has a
defect of something that the cells share: its current sensor or its coolant. The atlas uses the median over the vehicles
and the median of their distances from it, so that a few bad vehicles neither create an effect nor hide one.

The atlas compares the observer's innovations. The observer corrects itself at each reading, so innovations are small:
hundredths of a kelvin where a core is off by kelvins. But there are thousands of them a day. No two healthy cells are
alike, so each cell has an error at all times. The error in a regime is therefore the difference from the error of the
rest of the time: by how much more a cell reads in the regime than otherwise.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from bms_gateway.fleet.day import Row
from bms_gateway.fleet.residual import LEVEL, PLACES
from bms_gateway.thermal import Floats

FEWEST_VEHICLES = 4
"""With three vehicles, one that differs cannot be told from two that differ."""
FLOOR_K = 0.01
"""Mean errors below this are ignored: a tenth of a reading's noise."""
COMMON_SD = 4.0
ALIKE = 0.8
"""Share of the vehicles whose errors must have the same sign for an error to be common."""
OUTLIER_SD = 6.0
"""So many sd are far beyond chance among thousands of vehicles with a hundred places each, scatter of healthy packs
included."""
LEAST_OTHER = 0.05
"""Share of the time outside a regime, below which there is nothing to compare it with."""
SHARED = 0.5
"""Other cells of a vehicle share the worst cell's error if theirs has the same sign and at least this share of it."""
TO_SD = 1.4826  # from the median distance to a standard deviation, of a Gaussian
OF_MEDIAN = 1.2533  # standard error of a median over that of a mean

ALONG = ("all", LEVEL)
"""Regimes that are no part of the time, so there is no other time to compare them with."""

Place = tuple[str, int, str]
"""String, cell, regime."""


@dataclass(frozen=True, slots=True)
class Position:
    """One cell in one regime over all vehicles.

    Attributes
    ----------
    string, cell, regime
    vehicles : int
        With enough readings there.
    median_K, median_sd_K : float
        Of the vehicles' mean errors, and how well it is known. In `all` an error is reading less prediction, in `level`
        what windows found constant; in other regimes, its mean there less its mean at other times.
    spread_K : float
        Standard deviation of one vehicle about it.
    alike : float
        Share of the vehicles that err to the side of the median.
    outlier : str
        The vehicle furthest from the median.
    outlier_K, outlier_sd : float
        Its mean error, and its distance from the median in standard deviations.
    """

    string: str
    cell: int
    regime: str
    vehicles: int
    median_K: float
    median_sd_K: float
    spread_K: float
    alike: float
    outlier: str
    outlier_K: float
    outlier_sd: float

    @property
    def common(self) -> bool:
        """Whether the error is common to the vehicles."""
        clear = abs(self.median_K) > max(FLOOR_K, COMMON_SD * self.median_sd_K)
        return self.vehicles >= FEWEST_VEHICLES and clear and self.alike >= ALIKE


@dataclass(frozen=True, slots=True)
class Finding:
    """A finding of the atlas.

    Attributes
    ----------
    kind : str
        `effect`: the model lacks an effect; `cell`: one cell has a defect; `vehicle`: something that the cells of a
        vehicle share has a defect.
    string : str
    cell : int or None
        Cell with the greatest error, 1-based; None for a whole vehicle.
    cells : tuple of int
        Cells that have the error.
    regime : str
        Regime with the greatest error.
    regimes : tuple of str
    vehicle : str or None
    log : str
        A log that shows it.
    error_K, sd_K : float
    sentence : str
    """

    kind: str
    string: str
    cell: int | None
    cells: tuple[int, ...]
    regime: str
    regimes: tuple[str, ...]
    vehicle: str | None
    log: str
    error_K: float
    sd_K: float
    sentence: str


@dataclass(frozen=True, slots=True)
class Atlas:
    """Positions in the order string, cell, regime; findings, effects first."""

    positions: tuple[Position, ...]
    findings: tuple[Finding, ...]


@dataclass(slots=True)
class _Column:
    """Vehicles at one place: name, mean error (as of `Position`), its sd; all in the order of the names."""

    names: list[str]
    mean: Floats
    sd: Floats
    spread: float = 0.0

    @property
    def median(self) -> float:
        return float(np.median(self.mean))

    def distance(self) -> Floats:
        """Distance of each vehicle from the others, in standard deviations."""
        return np.asarray((self.mean - self.median) / np.sqrt(self.spread**2 + self.sd**2))


def draw_atlas(rows: Iterable[Row], config: str = "CONFIG", models: Mapping[str, str] | None = None) -> Atlas:
    """Compare the residuals of all rows.

    Parameters
    ----------
    rows : iterable of Row
    config : str
        For the command that a sentence advises.
    models : mapping of string to path, optional
        The same.
    """
    columns, logs = _columns(rows)
    by_regime: dict[tuple[str, str], list[_Column]] = defaultdict(list)
    for (string, _, regime), column in columns.items():
        by_regime[string, regime].append(column)
    for members in by_regime.values():
        # the scatter of few vehicles is badly known: the widest one of a string's cells is used for all its cells
        own = [TO_SD * float(np.median(np.abs(c.mean - c.median))) for c in members]
        for c in members:
            c.spread = max(*own, 0.5 * FLOOR_K)
    positions = tuple(_position(place, columns[place]) for place in sorted(columns, key=_order))
    findings = [*_effects(positions, columns, logs, config, models or {}), *_defects(columns, logs)]
    return Atlas(positions, tuple(findings))


def _order(place: Place) -> tuple[str, int, int]:
    return place[0], place[1], list(PLACES).index(place[2])


def _columns(rows: Iterable[Row]) -> tuple[dict[Place, _Column], dict[str, str]]:
    """Merge the days of each vehicle; keep the log of its longest row."""
    sums: dict[Place, dict[str, list[float]]] = defaultdict(dict)
    longest: dict[str, tuple[float, str]] = {}
    for row in rows:
        if row["error"] is not None:
            continue
        vehicle = row["vehicle"]
        longest[vehicle] = max(longest.get(vehicle, (-1.0, "")), (row["duration_s"], row["log"]))
        for r in row["residuals"]:
            if r["sd_K"] is None:
                continue
            n = float(r["readings"])
            s = sums[row["string"], r["cell"], r["regime"]].setdefault(vehicle, [0.0, 0.0, 0.0])
            s[0], s[1], s[2] = s[0] + n, s[1] + n * r["mean_K"], s[2] + (n * r["sd_K"]) ** 2
    columns = {}
    for (string, cell, regime), of in sums.items():
        whole = sums[string, cell, "all"]
        found = {v: _error(of[v], whole[v], regime) for v in sorted(of.keys() & whole.keys())}
        kept = {v: e for v, e in found.items() if e is not None}
        if kept:
            mean, sd = np.array(list(kept.values())).T
            columns[string, cell, regime] = _Column(list(kept), mean, sd)
    return columns, {v: log for v, (_, log) in longest.items()}


def _error(inside: Sequence[float], whole: Sequence[float], regime: str) -> tuple[float, float] | None:
    """Mean error of one vehicle at one place and its sd; None if there is too little other time for a comparison."""
    n, S, var = inside
    if regime in ALONG:
        return S / n, sqrt(var) / n
    other = whole[0] - n
    if other < LEAST_OTHER * whole[0]:
        return None
    # sd of the mean of the other time: that of the whole time, increased because there are fewer readings
    return S / n - (whole[1] - S) / other, sqrt(var / n**2 + whole[2] / (whole[0] * other))


def _position(place: Place, c: _Column) -> Position:
    string, cell, regime = place
    V, median = len(c.names), c.median
    far = c.distance()
    worst = int(np.argmax(np.abs(far)))
    alike = float(np.mean(np.sign(c.mean) == np.sign(median)))
    # the scatter of few vehicles is badly known, as in Student's t
    median_sd = OF_MEDIAN * c.spread * sqrt((V - 1.0) / (V - 3.0) / V) if V >= FEWEST_VEHICLES else c.spread
    outlier = c.names[worst], float(c.mean[worst]), float(far[worst])
    return Position(string, cell, regime, V, median, median_sd, c.spread, alike, *outlier)


def _common(members: Sequence[Position]) -> list[Position]:
    """Give the cells of a string whose error in one regime is common; all cells if only their mean error is."""
    if len(members) > 1 and all(p.vehicles >= FEWEST_VEHICLES and p.alike >= ALIKE for p in members):
        medians = np.array([p.median_K for p in members])
        mean, sd = medians.mean(), sqrt(sum(p.median_sd_K**2 for p in members)) / len(members)
        if abs(mean) > max(FLOOR_K, COMMON_SD * sd) and bool(np.all(np.sign(medians) == np.sign(mean))):
            return list(members)
    return [p for p in members if p.common]


def _effects(
    positions: Sequence[Position],
    columns: Mapping[Place, _Column],
    logs: Mapping[str, str],
    config: str,
    models: Mapping[str, str],
) -> list[Finding]:
    """Make at most one finding per string: several common errors usually have one cause."""
    found = []
    for string in dict.fromkeys(p.string for p in positions):
        of_string = [p for p in positions if p.string == string]
        common = [p for r in PLACES for p in _common([p for p in of_string if p.regime == r])]
        if not common:
            continue
        most = max(common, key=lambda p: abs(p.median_K))
        cells = tuple(dict.fromkeys(p.cell for p in common))
        regimes = tuple(r for r in PLACES if any(p.regime == r for p in common))
        column = columns[string, most.cell, most.regime]
        typical = column.names[int(np.argmin(np.abs(column.mean - most.median_K)))]
        others = [f"cell {k}" for k in cells if k != most.cell]
        others += [PLACES[r] for r in regimes if r not in (most.regime, *ALONG)]
        also = f"; also {', '.join(others)}" if others else ""
        alike = round(most.alike * most.vehicles)
        log = logs[typical]
        sentence = (
            f"{alike} of {most.vehicles} vehicles make the same error: {string}, cell {most.cell} reads "
            f"{_off(most.median_K, most.median_sd_K, most.regime)}{also}. "
            f"The model lacks an effect: run bms-gateway diagnose {log} --config {config} --string {string} "
            f"--model {models.get(string, 'MODEL')}, or on a table that bms-gateway export wrote in a vehicle"
        )
        found.append(
            Finding(
                "effect", string, most.cell, cells, most.regime, regimes, None, log, most.median_K, most.median_sd_K,
                sentence,
            )
        )  # fmt: skip
    return found


def _defects(columns: Mapping[Place, _Column], logs: Mapping[str, str]) -> list[Finding]:
    """One finding per vehicle and string: at its worst place."""
    marked: dict[tuple[str, str], list[tuple[float, Place, float, float, float]]] = defaultdict(list)
    for place, c in columns.items():
        if len(c.names) < FEWEST_VEHICLES:
            continue
        far = c.distance()
        for i in np.flatnonzero((np.abs(far) > OUTLIER_SD) & (np.abs(c.mean - c.median) > FLOOR_K)).tolist():
            sd = float(np.hypot(c.spread, c.sd[i]))
            marked[c.names[i], place[0]].append((float(far[i]), place, float(c.mean[i]), c.median, sd))
    found = []
    for (vehicle, string), places in sorted(marked.items()):
        worst, (_, cell, regime), error, median, sd = max(places, key=lambda p: (abs(p[0]), p[1]))
        beside = [
            columns[string, k, regime].distance()[columns[string, k, regime].names.index(vehicle)]
            for (s, k, r), c in sorted(columns.items())
            if s == string and r == regime and k != cell and vehicle in c.names
        ]
        shared = len(beside) > 0 and all(d * worst > 0.0 and abs(d) > SHARED * abs(worst) for d in beside)
        n = len(columns[string, cell, regime].names) - 1
        regimes = tuple(r for r in PLACES if any(p[1][2] == r for p in places))
        what = "all measured cells read" if shared else f"cell {cell} alone reads"
        cause = (
            "What its cells share is wrong: its current sensor, its coolant or its inlet sensor"
            if shared
            else "A defect of this cell: its resistance, its cooling or its thermocouple"
        )
        beside_others = f"where {n} other vehicles have {median:+.3f} K"
        sentence = f"{vehicle}, {string}: {what} {_off(error, sd, regime)}, {beside_others}. {cause}"
        cells = tuple(sorted({p[1][1] for p in places})) if shared else (cell,)
        found.append(
            Finding(
                "vehicle" if shared else "cell", string, None if shared else cell, cells, regime, regimes, vehicle,
                logs[vehicle], error, sd, sentence,
            )
        )  # fmt: skip
    return found


def _off(error: float, sd: float, regime: str) -> str:
    how_much = f"{abs(error):.3f} ± {sd:.3f} K"
    if regime in ALONG:
        of = "what its windows explain" if regime == LEVEL else "its prediction"
        return f"{how_much} {'above' if error > 0.0 else 'below'} {of}"
    way = "higher" if error > 0.0 else "lower"
    return f"{how_much} {way} {PLACES[regime]} than at other times, beside its prediction"
