"""Uncertainty of the surfaces from rows of the current that are far apart.

Between two rows the current may step at any instant. The heat after the step is then unknown, and its effect on the
surfaces lasts for minutes and is alike at all sensors. It looks like some effects of the catalogue, which did not cause
it.
"""

from collections.abc import Sequence
from dataclasses import replace

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
was taken for a missing effect."""
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
    r"""Compute how much better the readings are explained if each step of the current may lie between its rows.

    A step :math:`\Delta I^2` between rows d apart leaves the heat :math:`R_e \Delta I^2 d / \sqrt{12}` unknown (one
    standard deviation), and the surfaces answer to it as to any heat in the core. With these answers as columns H,
    in units of the noise, the residual r has the covariance :math:`1 + H H^T` in place of 1.

    Parameters
    ----------
    fit : MapFit
    records : sequence of Record
        Records from which those of the fit were made.
    counted : ndarray of bool (M,)
        Readings that count. What is compared with the result must be judged by the same readings.

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
        if record.sampling.doubt == 0.0 or record.drive.dt > ROWS_S * record.sampling.seconds:
            continue
        H = _answers(fit, i, record) * (counted[own] / sigma[own])[:, None]
        inner = np.eye(H.shape[1]) + H.T @ H
        b = H.T @ residual[own]
        gained += 0.5 * float(b @ np.linalg.solve(inner, b) - np.linalg.slogdet(inner)[1])
    return gained


def _answers(fit: MapFit, i: int, record: Record) -> Floats:
    """Responses (M, K) of the readings of record `i` to the unknown heat of each of K steps, K."""
    problem, m, u = fit.problem, fit.problem.records[i], fit.problem.records[i].drive
    # one response, to 1 A² more for a second, is used for all steps, because the string is nearly linear
    size = float(np.max(u.I2))
    bumped = replace(m, drive=replace(u, I2=u.I2 + size * (np.arange(u.N) == m.spans[0].first)))
    ms = [bumped if r == i else x for r, x in enumerate(problem.records)]
    moved = Problem(problem.model, ms, problem.beliefs).predict(fit.theta, fit.prediction.X, fit.nu).X[i]
    rows, n = len(m.spans[0]) + 1, problem.model.cells
    answer = (moved - fit.prediction.X[i])[:rows, 1 : 2 * n : 2] / (size * u.dt)
    span = np.searchsorted(np.cumsum([len(s) + 1 for s in m.spans]), m.row, side="right")
    read_s = (m.row + m.share - span) * u.dt
    own = record.drive
    step = np.abs(np.diff(own.I2))
    k = np.sort(np.argsort(-step)[:STEPS])
    at_s = (k + 1.0) * own.dt
    begins = np.array([s.first for s in m.spans]) * u.dt
    of = np.searchsorted(begins, at_s, side="right") - 1
    lag = read_s[:, None] - at_s
    found = np.zeros(lag.shape)
    for channel, (_, cell) in enumerate(m.channels):
        mine = m.channel == channel
        found[mine] = np.interp(lag[mine], np.arange(rows) * u.dt, answer[:, cell - 1], left=0.0, right=0.0)
    found[span[:, None] != of] = 0.0
    return np.asarray(found * step[k] * record.sampling.seconds / np.sqrt(12.0))


def left_open(fit: MapFit, doubts: Sequence[float]) -> float:
    """Compute how far readings may be from a right model because the current between its rows is unknown.

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
