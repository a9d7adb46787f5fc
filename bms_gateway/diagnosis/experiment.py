r"""The next drive, or the place of one more sensor, by which two explanations of a record can be distinguished.

Both explanations are simulated over each test of a library, with their fitted numbers. The part of the difference that
a refit could remove is subtracted: with d the difference of the predictions and J the columns of all numbers that the
wrong explanation may adjust,

.. math:: χ^2 = d^T W d - d^T W J (J^T W J + Λ)^{-1} J^T W d, \qquad \text{expected log-odds} = χ^2/2

where Λ is the precision of its numbers from the present records: the posterior for numbers that stay the same, the
prior for those that each record has for itself (start, cooling, sensor offsets). The smaller of both directions counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.candidates import Candidate
from bms_gateway.diagnosis.core_band import tempered
from bms_gateway.diagnosis.feasible import Plan, limits_of, plans
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.diagnosis.search import Search
from bms_gateway.diagnosis.weighing import Trial
from bms_gateway.identify.coordinates import OWN, Channel, Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats
from bms_gateway.thermal.drive import Span, every_second

ENOUGH_ODDS = 3.0
"""Least expected log-odds with which a test decides."""
CLEAR = 0.95
"""Probability of the first effect above which no test is needed."""
NEAR = 3.0
"""Log-odds within which the effect may sit on another cell."""
MOST_PAIRS = 3
MOST_BYTES = 200_000_000
"""Least share of the columns that is kept for further use."""
WORK = 12_000
"""Most cells times intervals of a test; beyond it, intervals are joined in pairs …"""
COARSEST_S = 16.0
"""… up to this length."""
START_SD = 1.0
"""K: the start of each cell is read from its own sensor, for any explanation of this reading."""


@dataclass(frozen=True, slots=True)
class Ranked:
    """One test: the plan, and its expected log-odds."""

    plan: Plan
    log_odds: float


@dataclass(frozen=True, slots=True)
class Sensor:
    """One more surface sensor: its cell, and the expected log-odds of the best test with it."""

    cell: int
    log_odds: float
    plan: Plan


@dataclass(frozen=True, slots=True)
class Parting:
    """How two explanations can be told apart.

    Attributes
    ----------
    one, other : str
        Keys of the effects.
    tests : tuple of Ranked
        The best first.
    sensor : Sensor or None
        A further sensor, if no test decides with the present ones and a further one would help.
    sentence : str
    """

    one: str
    other: str
    tests: tuple[Ranked, ...]
    sensor: Sensor | None
    sentence: str

    @property
    def decides(self) -> bool:
        """Whether a test with the sensors at hand can be expected to decide."""
        return bool(self.tests) and self.tests[0].log_odds >= ENOUGH_ODDS


@dataclass(frozen=True, slots=True)
class Experiment:
    """What to do next: each pair with its tests, and one sentence."""

    partings: tuple[Parting, ...]
    sentence: str


def next_experiment(found: Search, *, uncertain: bool = False) -> Experiment | None:
    """Find the test that distinguishes a search's tied explanations.

    Parameters
    ----------
    found : Search
    uncertain : bool
        Whether the verdict is uncertain: the two best explanations are then compared although nothing is tied.

    Returns
    -------
    Experiment
        None if no explanations must be told apart.
    """
    pairs = _pairs(found, uncertain)
    if not pairs:
        return None
    problem = found.baseline.problem
    library = plans(limits_of(problem.records[0], problem.model), problem.model)
    forecasts = _Forecasts([t for pair in pairs for t in pair], library)
    odds = np.empty((len(pairs), len(library)))
    for j in range(len(library)):
        for i, (a, b) in enumerate(pairs):
            odds[i, j] = _between(forecasts.of(a, j), forecasts.of(b, j), problem.model.sensors)
    sensors = _further_sensors(pairs, library, forecasts, odds)
    partings = tuple(
        _part(a.candidate, b.candidate, library, o, sensors.get(i))
        for i, ((a, b), o) in enumerate(zip(pairs, odds, strict=True))
    )
    return Experiment(partings, partings[0].sentence)


def _further_sensors(
    pairs: Sequence[tuple[Trial, Trial]], library: Sequence[Plan], forecasts: "_Forecasts", odds: Floats
) -> dict[int, Sensor]:
    """Find the best place of one more sensor for each pair that no test distinguishes."""
    model = pairs[0][0].fit.problem.model
    further = sorted(set(range(1, model.cells + 1)) - set(model.sensors))
    best: dict[int, Sensor] = {}
    for j, plan in enumerate(library if further else ()):
        for i in np.flatnonzero(odds.max(axis=1) < ENOUGH_ODDS).tolist():
            a, b = (forecasts.of(t, j) for t in pairs[i])
            for k in further:
                found = _between(a, b, tuple(sorted((*model.sensors, k))))
                if i not in best or (found, -k) > (best[i].log_odds, -best[i].cell):
                    best[i] = Sensor(k, found, plan)
    return best


def _pairs(found: Search, uncertain: bool) -> list[tuple[Trial, Trial]]:
    pairs: list[tuple[Trial, Trial]] = []
    for chosen in found.chosen:
        trials = next((r for r in found.rounds if any(t.candidate.key == chosen.candidate.key for t in r)), None)
        if trials is None:
            continue
        mine = next(t for t in trials if t.candidate.key == chosen.candidate.key)
        others = [next((t for t in trials if t.candidate.name == name), None) for name in chosen.tied]
        others += [
            t
            for t in trials
            if t.candidate.name == mine.candidate.name
            and t.candidate.cell != mine.candidate.cell
            and t.log_odds > mine.log_odds - NEAR
        ]
        pairs += [(mine, t) for t in others if t is not None]
    if not pairs and found.rounds:
        trials = found.rounds[-1] if not found.chosen else found.rounds[0]
        second = next((t for t in trials[1:] if t.candidate.name != trials[0].candidate.name), None)
        doubtful = uncertain or found.orphan or (bool(found.chosen) and trials[0].share < CLEAR)
        if second is not None and doubtful:
            pairs = [(trials[0], second)]
    return [p for p in pairs if _forecastable(p[0]) and _forecastable(p[1])][:MOST_PAIRS]


def _forecastable(t: Trial) -> bool:
    """Whether a plan contains all inputs of the effect; no plan contains the voltage."""
    return "voltage" not in t.candidate.effect.signals


def _part(one: Candidate, other: Candidate, library: Sequence[Plan], odds: Floats, sensor: Sensor | None) -> Parting:
    tests = [Ranked(p, x) for p, x in zip(library, odds.tolist(), strict=True)]
    tests.sort(key=lambda t: -t.log_odds)
    best = tests[0]
    names = f"{_spoken(one)} from {_spoken(other)}"
    if best.log_odds >= ENOUGH_ODDS:
        text = f"To tell {names}: {best.plan.instruction} ({best.plan.minutes:.0f} min)."
        return Parting(one.key, other.key, tuple(tests), None, text)
    if sensor is not None and sensor.log_odds >= ENOUGH_ODDS:
        text = f"No test tells {names} with these sensors: add one on cell {sensor.cell}, then "
        text += f"{sensor.plan.instruction} ({sensor.plan.minutes:.0f} min)."
    else:
        sensor = None
        text = f"No test and no further surface sensor tells {names}."
    return Parting(one.key, other.key, tuple(tests), sensor, text)


def _spoken(c: Candidate) -> str:
    if c.cell is None:
        return c.name
    return f"{c.name} ({'after ' if c.effect.place == 'gap' else ''}cell {c.cell})"


class _Known:
    """One hypothesis from the present records: its fit, inflation of the residual, tempered covariance."""

    def __init__(self, fit: MapFit) -> None:
        self.fit = fit
        self.inflation = structure(fit).inflation
        self.covariance = tempered(fit, self.inflation)


class _Forecasts:
    """Predictions of explanations for the tests of a library; those of a long string are computed where they are used.

    A test of a string of sixty has columns of a hundred megabytes.
    """

    def __init__(self, trials: Sequence[Trial], library: Sequence[Plan]) -> None:
        self._known = {t.candidate.key: _Known(t.fit) for t in trials}
        self._library = library
        self._made: dict[tuple[str, int], _Forecast] = {}
        self._held = 0

    def of(self, t: Trial, test: int) -> "_Forecast":
        """Prediction of one explanation for one test."""
        key = t.candidate.key, test
        if key not in self._made:
            if self._held > MOST_BYTES:
                self._made, self._held = {k: f for k, f in self._made.items() if k[1] == test}, 0
                self._held = sum(f.J.nbytes for f in self._made.values())
            self._made[key] = _Forecast(self._known[t.candidate.key], self._library[test])
            self._held += self._made[key].J.nbytes
        return self._made[key]


class _Forecast:
    """Prediction of one fit for one test, at sensors on all cells, with the columns of all adjustable numbers."""

    def __init__(self, known: _Known, plan: Plan) -> None:
        fit = known.fit
        model, m = fit.problem.model, fit.problem.records[0]
        record = planned(m, plan, model.cells)
        theta, _ = _carried(known, Problem(model, [record]))
        # starts come from readings: those of sensors on soaked cells, according to this fit
        soaked = record.start[0]
        state = Problem(model, [record]).numbers(0, theta)[1][0]
        record = replace(record, start=(2.0 * soaked - state[1 : 2 * model.cells : 2],))
        self.problem = Problem(model, [record])
        theta, self._precision = _carried(known, self.problem)
        shared = {c.name: float(v) for c, v in zip(fit.problem.nuisances, fit.nu, strict=True) if c.record is None}
        nu = np.array([shared.get(c.name, 0.0) for c in self.problem.nuisances])
        prediction = self.problem.predict(theta)
        J = self.problem.jacobian(theta, prediction, self.problem.coordinates, refinements=0)
        Jn = self.problem.jacobian(theta, prediction, self.problem.nuisances, refinements=0)
        self.y = prediction.y + Jn @ nu
        self.J = np.concatenate([J, Jn], axis=1)
        self.inflation = known.inflation
        self.cell = np.array([k for _, k in record.channels])[record.channel]
        # a plan is read once per interval, the record's sensors at their own rate
        pace = len(m.y) / (m.drive.N * m.drive.dt * len(m.channels))
        sigma = {k: s for (_, k), s in zip(m.channels, np.sqrt(m.sigma0**2 + m.step**2 / 12.0), strict=True)}
        usual = float(np.median(list(sigma.values())))
        of_cell = np.array([sigma.get(k, usual) for k in range(1, model.cells + 1)])
        self.weight = np.sqrt(record.drive.dt * pace) / of_cell[self.cell - 1]

    def left(self, y: Floats, rows: NDArray[np.bool_]) -> float:
        """Squared distance to readings `y` after this fit has adjusted its numbers, in units of the noise."""
        w = self.weight[rows]
        d, J = (y - self.y)[rows] * w, self.J[rows] * w[:, None]
        b = J.T @ d
        return float(d @ d - b @ np.linalg.solve(J.T @ J + self._precision, b))


def _between(a: _Forecast, b: _Forecast, sensors: Sequence[int]) -> float:
    rows = np.isin(a.cell, sensors)
    chi2 = min(a.left(b.y, rows), b.left(a.y, rows))
    return max(0.5 * chi2 / min(a.inflation, b.inflation), 0.0)


def planned(m: Measured, plan: Plan, cells: int) -> Measured:
    """Make the record of a plan: readings on all cells at each instant, with a uniform temperature at the start."""
    u = plan.drive
    while cells * u.N > WORK and 2.0 * u.dt <= COARSEST_S:
        u = every_second(u, (Span(0, u.N),))[0]
    N = u.N
    channels: list[Channel] = [("surface", k) for k in range(1, cells + 1)]
    return replace(
        m,
        drive=u,
        spans=(Span(0, N),),
        channels=tuple(channels),
        channel=np.repeat(np.arange(cells), N),
        row=np.tile(np.arange(1, N + 1), cells),
        share=np.zeros(N * cells),
        y=np.zeros(N * cells),
        used=np.ones(N * cells, np.bool_),
        sigma0=np.full(cells, float(np.median(m.sigma0))),
        step=np.full(cells, float(np.median(m.step))),
        start=(np.full(cells, float(u.T_in[0])),),
        start_sd=(np.full(cells, START_SD),),
        source=plan.name,
    )


def _carried(known: _Known, new: Problem) -> tuple[Floats, Floats]:
    """Coordinates (P,) that a fit keeps in a new record, and the precision (P + Q, P + Q) of all of its numbers."""
    fit, old = known.fit, known.fit.problem
    before = [*old.coordinates, *old.nuisances]
    at = {c.name: i for i, c in enumerate(before) if c.record is None and c.name not in OWN}
    after = [*new.coordinates, *new.nuisances]
    kept = [i for i, c in enumerate(after) if c.record is None and c.name in at]
    source = [at[after[i].name] for i in kept]
    precision = np.diag([1.0 / c.sd**2 for c in after])
    precision[np.ix_(kept, kept)] = np.linalg.inv(known.covariance[np.ix_(source, source)])
    values = {c.name.partition("@")[0]: float(z) for c, z in zip(old.coordinates, fit.theta, strict=True)}
    begin = {c.name: c.begin for c in new.coordinates if c.record is not None}
    return np.array([begin.get(c.name, values.get(c.name, c.begin)) for c in new.coordinates]), precision
