"""Heat that varies in the core of one cell independently of the current.

The unknown current between rows heats all cells of a string at once, and only where the current steps. A loose joint, a
switching resistor, or the sun on some cells heats one place, at any time. Both cause slow errors of the surfaces, and
steps of the current imitate a part of any such error. The readings distinguish them.
"""

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from bms_gateway.diagnosis.coarse_rows import (
    MATTERS,
    SHOWN,
    NumbersAndSteps,
    left_open,
    less_steps,
    numbers_and_steps,
    shows_steps,
    since,
)
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.residuals import log_density, noise_floor, structured, within
from bms_gateway.diagnosis.search import Search
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import Floats
from bms_gateway.thermal.trajectory import reference

INSTANTS = 150
"""Evenly spaced instants of a record at which the core of the cell may become warmer or colder."""
SIZES_K = np.geomspace(0.003, 3.0, 13)
"""Tried standard deviations of such a change, K."""
NEAREST = 5
"""Number of thermocouples used for a cell: the nearest ones."""
WANDERS = 25.0
"""Least log-evidence for such heat. Of 21 simulated cells and strings whose current steps between its rows, none was
above 16; of nine with one place heated by 0.1 W and more, seven were above 90, two at 7 and 42."""


def more_than_rows(fit: MapFit, records: Sequence[Record]) -> bool:
    """Whether a fit has errors that heat in one cell explains, and steps of the current between its rows do not."""
    if structured(less_steps(fit, records)):
        return True
    return heat_in_one_cell(fit, records, stacked(fit.problem)[4] | within(fit)) > WANDERS


def rows_may_matter(fit: MapFit, records: Sequence[Record]) -> bool:
    """Whether what the current does between its rows could be seen in the readings."""
    most, used = left_open(fit, [r.sampling.doubt for r in records]), stacked(fit.problem)[4]
    return most >= MATTERS * noise_floor(fit, ~used)


def rows_are_open(found: Search, records: Sequence[Record]) -> bool:
    """Whether steps of the current between its rows explain the records better than the effects of a search."""
    if not rows_may_matter(found.baseline, records):
        return False
    used = stacked(found.baseline.problem)[4]
    fits = (found.baseline, found.final) if found.chosen else (found.baseline,)
    held = within(found.baseline)
    odds = [f.log_evidence + log_density(f, held) for f in fits]
    return max(o + shows_steps(f, records, used | held) for o, f in zip(odds, fits, strict=True)) > odds[-1] + SHOWN


def heat_in_one_cell(fit: MapFit, records: Sequence[Record], counted: NDArray[np.bool_]) -> float:
    r"""Log-evidence for varying heat in one cell, beyond what numbers and steps of the current explain.

    The core of the cell changes by :math:`w_j \sim N(0, s^2)` at each of some instants, and the surfaces respond as in
    the string of the fit, with the columns H. With r the residual, X the columns of numbers and steps, Λ their
    precision and b their gradient, the log-evidence is

    .. math::
        \tfrac12 s^2 g^T (1 + s^2 G)^{-1} g - \tfrac12 \ln\det(1 + s^2 G), \qquad
        G = H^T H - H^T X Λ^{-1} X^T H, \quad g = H^T r - H^T X Λ^{-1} b

    Parameters
    ----------
    fit : MapFit
    records : sequence of Record
        Records from which those of the fit were made.
    counted : ndarray of bool (M,)
        Readings that count.

    Returns
    -------
    float
        Of the cell and the size that explain most.
    """
    explained = numbers_and_steps(fit, records, counted)
    cells, sigma = fit.problem.model.cells, stacked(fit.problem)[1]
    G, g = np.zeros((cells, INSTANTS, INSTANTS)), np.zeros((cells, INSTANTS))
    shared = np.zeros((cells, len(explained.pull), INSTANTS))
    answers = [_answers(fit, i) for i in range(len(records))]
    first = np.cumsum([0, *(len(m.y) for m in fit.problem.records)])
    for part in explained.parts():
        m = fit.problem.records[part.record]
        at_s = (np.arange(INSTANTS) + 0.5) * m.drive.N * m.drive.dt / INSTANTS
        lag = since(m, part.readings - first[part.record], at_s)
        weight = counted[part.readings] / sigma[part.readings]
        asked = [cell for cell in range(cells) if part.cell in _nearest([c for _, c in m.channels], cell + 1)]
        grid = m.drive.dt * np.arange(len(answers[part.record]))
        for cell in asked:
            answer = answers[part.record][:, part.cell - 1, cell]
            H = np.interp(lag, grid, answer, left=0.0, right=0.0) * weight[:, None]
            G[cell] += H.T @ H
            g[cell] += H.T @ fit.r[part.readings]
            shared[cell, part.at] += part.columns.T @ H
    return max(_log_evidence(*x) for x in _beside(explained, G, g, shared))


def _answers(fit: MapFit, i: int) -> Floats:
    """Responses (rows, n surfaces, n cores) of the surfaces if one core of record `i` is 1 K warmer at the start."""
    m, n = fit.problem.records[i], fit.problem.model.cells
    system, _ = fit.problem.system(i, fit.theta, fit.nu, m)
    X = fit.prediction.X[i]
    warmer = np.zeros((X.shape[1], n))
    warmer[2 * np.arange(n), np.arange(n)] = 1.0
    still = np.zeros((max(map(len, m.spans)), *warmer.shape))
    return reference(system, X.mean(axis=0)).run(warmer, still)[:, 1 : 2 * n : 2]


def _nearest(measured: Sequence[int], cell: int) -> list[int]:
    return sorted(measured, key=lambda c: abs(c - cell))[:NEAREST]


def _beside(explained: NumbersAndSteps, G: Floats, g: Floats, shared: Floats) -> list[tuple[Floats, Floats]]:
    """Remove from the columns of each cell the part that numbers and steps explain."""
    scale = 1.0 / np.sqrt(np.diag(explained.precision))
    factor = scipy.linalg.cholesky(explained.precision * np.outer(scale, scale), lower=True)

    def solved(b: Floats) -> Floats:
        return np.asarray(scipy.linalg.solve_triangular(factor, (scale * b.T).T, lower=True))

    pull, found = solved(explained.pull), []
    for own, score, cross in zip(G, g, shared, strict=True):
        taken = solved(cross)
        found.append((own - taken.T @ taken, score - taken.T @ pull))
    return found


def _log_evidence(G: Floats, g: Floats) -> float:
    w, V = np.linalg.eigh(G)
    w, score = np.maximum(w, 0.0), (V.T @ g) ** 2
    return max(0.5 * float(np.sum(s**2 * score / (1.0 + s**2 * w) - np.log1p(s**2 * w))) for s in SIZES_K)
