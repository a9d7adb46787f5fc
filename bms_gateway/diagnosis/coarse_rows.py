"""Uncertainty of the surfaces from rows of the current that are far apart.

Between two rows the current may step at any instant. The heat after the step is then unknown. Its effect on the
surfaces lasts for minutes and is equal at all sensors. It looks like some effects of the catalogue that do not exist.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_inputs import MINUTE_S
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats

ROWS_S, DOUBT = 1.5, 0.03
"""Distance of rows, above the usual second of a logger, and unknown share of a minute's heat, above which unknown heat
was mistaken for a missing effect."""
HOPELESS = 0.2
"""Unknown share of a minute's heat above which no effect is named: the fit itself is then wrong, and even strong
effects were given wrong names."""
DRAWS = 8
STEPS = 150
"""Number of steps of the current whose instants are examined: those with the most heat."""
MATTERS = 0.1
"""Share of the noise below which the unknown heat cannot be mistaken for an effect."""
SHOWN = 10.0
"""Least log-evidence with which the readings show that the current stepped between its rows."""


def doubt(r: Record) -> float:
    """Relative sd of a minute's heat where the current jumps between rows too far apart; 0 elsewhere."""
    return r.sampling.doubt if r.sampling.seconds > ROWS_S and r.sampling.doubt > DOUBT else 0.0


def shows_steps(fit: MapFit, records: Sequence[Record], counted: NDArray[np.bool_]) -> float:
    r"""Log-evidence for steps of the current between its rows: improvement of the explanation of the readings.

    A step :math:`\Delta I^2` between rows d apart leaves the heat :math:`R_e \Delta I^2 d / \sqrt{12}` unknown (one
    standard deviation), and the surfaces respond to it as to any heat in the core. With these responses as columns H,
    in units of the noise, the residual r has the covariance :math:`1 + H H^T` instead of 1.

    Parameters
    ----------
    fit : MapFit
    records : sequence of Record
        Records from which those of the fit were made.
    counted : ndarray of bool (M,)
        Readings that count. Results must be compared on the same readings.

    Returns
    -------
    float
        Log-evidence; 0 if every row of the current is valid for its own time.
    """
    gained, first = 0.0, 0
    y, sigma, *_ = stacked(fit.problem)
    residual = np.where(counted, (y - fit.y) / sigma, 0.0)
    for i, (record, m) in enumerate(zip(records, fit.problem.records, strict=True)):
        own = slice(first, first + len(m.y))
        first = own.stop
        steps = _steps(record)
        inner, b = np.eye(len(steps)), np.zeros(len(steps))
        for mine, answers in _answers(fit, i, record, steps) if len(steps) else ():
            H = answers * (counted[own] / sigma[own])[mine, None]
            inner += H.T @ H
            b += H.T @ residual[own][mine]
        gained += 0.5 * float(b @ np.linalg.solve(inner, b) - np.linalg.slogdet(inner)[1])
    return gained


def less_steps(fit: MapFit, records: Sequence[Record]) -> MapFit:
    """Return a fit with the residual that remains if the steps of the current are placed by the readings.

    The fitted readings place the steps, and the numbers of the fit adjust. The part explained by steps and numbers is
    removed from all readings.
    """
    used, r = stacked(fit.problem)[4], fit.r.copy()
    numbers = numbers_and_steps(fit, records, used)
    moved = numbers.moved()
    for part in numbers.parts():
        r[part.readings] -= part.columns @ moved[part.at]
    return replace(fit, r=r)


@dataclass(frozen=True, slots=True)
class Part:
    """Readings of one channel, and the numbers and steps on which they depend.

    Attributes
    ----------
    record, cell : int
        Record from 0, and cell from 1.
    readings : ndarray of int (K,)
        Indices among the readings of the fit.
    at : ndarray of int (p,)
        Indices of the numbers and steps on which they depend.
    columns : ndarray (K, p)
        Derivatives, in units of the noise.
    """

    record: int
    cell: int
    readings: NDArray[np.intp]
    at: NDArray[np.intp]
    columns: Floats


@dataclass(frozen=True, slots=True)
class NumbersAndSteps:
    """All numbers of a fit and all examined steps of the current: precision and gradient of the readings.

    Attributes
    ----------
    fit : MapFit
    records : sequence of Record
    steps : sequence of ndarray of int
        Of each record.
    precision : ndarray (K, K)
    pull : ndarray (K,)
    """

    fit: MapFit
    records: Sequence[Record]
    steps: Sequence[NDArray[np.intp]]
    precision: Floats
    pull: Floats

    def moved(self) -> Floats:
        """Change (K,) of numbers and steps by the readings."""
        return np.asarray(np.linalg.solve(self.precision, self.pull))

    def parts(self) -> Iterator[Part]:
        """Yield the readings, channel by channel."""
        problem, own = self.fit.problem, len(self.fit.theta) + len(self.fit.nu)
        sigma = stacked(problem)[1]
        edges = np.cumsum([own, *map(len, self.steps)])
        reading = place = 0
        for i, (record, m, at) in enumerate(zip(self.records, problem.records, problem.places, strict=True)):
            found = _answers(self.fit, i, record, self.steps[i]) if len(self.steps[i]) else _channels(m)
            for (_, cell), (mine, answers) in zip(m.channels, found, strict=True):
                k = at.place[mine] + place
                X = np.concatenate([self.fit.J[k], self.fit.linear.J[k], answers], axis=1)
                numbers = np.r_[:own, edges[i] : edges[i + 1]]
                yield Part(i, cell, reading + mine, numbers, X / sigma[reading + mine, None])
            reading, place = reading + len(m.y), place + len(at.first)


def numbers_and_steps(fit: MapFit, records: Sequence[Record], counted: NDArray[np.bool_]) -> NumbersAndSteps:
    """Place the steps of the current by the readings that count (M,), while the numbers of the fit adjust."""
    sd = np.concatenate([[c.sd for c in fit.problem.coordinates], fit.linear.sd])
    away = np.concatenate([fit.theta - [c.prior for c in fit.problem.coordinates], fit.nu])
    steps = [_steps(r) for r in records]
    count = sum(map(len, steps))
    precision = np.diag(np.concatenate([sd**-2.0, np.ones(count)]))
    found = NumbersAndSteps(fit, records, steps, precision, np.concatenate([-away / sd**2, np.zeros(count)]))
    for part in found.parts():
        X = part.columns * counted[part.readings, None]
        found.precision[np.ix_(part.at, part.at)] += X.T @ X
        found.pull[part.at] += X.T @ fit.r[part.readings]
    return found


def _steps(record: Record) -> NDArray[np.intp]:
    """Return the examined steps of the current; none if each row is valid for its own time."""
    if record.sampling.doubt == 0.0 or record.drive.dt > ROWS_S * record.sampling.seconds:
        return np.zeros(0, np.intp)
    return np.sort(np.argsort(-np.abs(np.diff(record.drive.I2)))[:STEPS])


def _channels(m: Measured) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """Yield the readings of each channel, which no step changes."""
    for channel in range(len(m.channels)):
        mine = np.flatnonzero(m.channel == channel)
        yield mine, np.zeros((len(mine), 0))


def _answers(fit: MapFit, i: int, record: Record, steps: NDArray[np.intp]) -> Iterator[tuple[NDArray[np.intp], Floats]]:
    """Yield the readings (M,) of each channel of record `i`, and their responses (M, K), K, to unknown heat of steps.

    The steps (K,) are intervals of the record after which the current changes.
    """
    problem, m, u = fit.problem, fit.problem.records[i], fit.problem.records[i].drive
    # one response, to 1 A² more for a second, is used for all steps, because the string is nearly linear
    size = float(np.max(u.I2))
    bumped = replace(m, drive=replace(u, I2=u.I2 + size * (np.arange(u.N) == m.spans[0].first)))
    ms = [bumped if r == i else x for r, x in enumerate(problem.records)]
    moved = Problem(problem.model, ms, problem.beliefs).predict(fit.theta, fit.prediction.X, fit.nu).X[i]
    rows, n = len(m.spans[0]) + 1, problem.model.cells
    answer = (moved - fit.prediction.X[i])[:rows, 1 : 2 * n : 2] / (size * u.dt)
    step = np.abs(np.diff(record.drive.I2))[steps] * record.sampling.seconds / np.sqrt(12.0)
    at_s = np.asarray((steps + 1.0) * record.drive.dt, np.float64)
    for channel, (_, cell) in enumerate(m.channels):
        mine = np.flatnonzero(m.channel == channel)
        found = np.interp(since(m, mine, at_s), np.arange(rows) * u.dt, answer[:, cell - 1], left=0.0, right=0.0)
        yield mine, found * step


def since(m: Measured, readings: NDArray[np.intp], at_s: Floats) -> Floats:
    """Time (K, J), s, from instants (J,) to readings (K,); negative also for an instant of another span."""
    span = np.searchsorted(np.cumsum([len(s) + 1 for s in m.spans]), m.row[readings], side="right")
    begins = np.array([s.first for s in m.spans]) * m.drive.dt
    of = np.searchsorted(begins, at_s, side="right") - 1
    lag = ((m.row + m.share)[readings] - span)[:, None] * m.drive.dt - at_s
    return np.where(span[:, None] == of, lag, -np.inf)


def left_open(fit: MapFit, doubts: Sequence[float]) -> float:
    """Error of the readings of a right model because the current between its rows is unknown.

    Parameters
    ----------
    fit : MapFit
    doubts : sequence of float
        Doubts of its records, from `doubt`.

    Returns
    -------
    float, K
        Root mean square over all readings.
    """
    if not any(doubts):
        return 0.0
    rng = np.random.default_rng(0)
    problem = fit.problem
    as_it_is = problem.predict(fit.theta, fit.prediction.X, fit.nu).y
    moved = 0.0
    for _ in range(DRAWS):
        drawn = [_drawn(m, d, rng) for m, d in zip(problem.records, doubts, strict=True)]
        other = Problem(problem.model, drawn, problem.beliefs).predict(fit.theta, fit.prediction.X, fit.nu)
        moved += float(np.mean((other.y - as_it_is) ** 2)) / DRAWS
    return float(np.sqrt(moved))


def _drawn(m: Measured, doubt: float, rng: np.random.Generator) -> Measured:
    """Draw a record whose heat is wrong in each minute by a random part of its uncertainty."""
    u = m.drive
    minute = (np.arange(u.N) * u.dt // MINUTE_S).astype(int)
    off = rng.standard_normal(minute[-1] + 1)[minute]
    return replace(m, drive=replace(u, I2=np.maximum(u.I2 + doubt * float(np.mean(u.I2)) * off, 0.0)))
