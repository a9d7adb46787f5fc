"""Numbers of a string from whole records by the windows of the live method, so that service and `fit` learn alike.

If a model does not follow the surfaces, a fit of the whole record compensates for the missing effect by wrong
capacities and resistances. A window allows for the effects that every real cell may have (`identify.carried`), and
increases its noise until no number is implausible (`identify.doubt`). So the numbers come from the windows. The fit of
the whole record keeps these numbers and finds the rest: starts, offsets, cells.

Beyond Lin et al., Eq 3-10.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import nan

import numpy as np

from bms_gateway.diagnosis.model_error import Bench, Fit
from bms_gateway.diagnosis.model_error import fit as fit_with_error
from bms_gateway.identify.contract import Posterior, Tick
from bms_gateway.identify.coordinates import Belief, Measured
from bms_gateway.identify.map_fit import TO_THE_END, MapFit
from bms_gateway.identify.problem import Problem
from bms_gateway.identify.window import WindowIdentifier
from bms_gateway.identify.window_effects import heat_only
from bms_gateway.identify.window_readings import GAP_S
from bms_gateway.thermal import Floats, StringModel
from bms_gateway.thermal.drive import Drive, Span

HELD = 0.03
"""sd of a number in the fit of the rest, as a share of its sd from the windows: the fit keeps the number."""
LEAST_SHARE = 0.5
"""Least sd of a number of a model with effects from windows, as a share of that from a fit of the whole record: the
heat for the windows was computed with the numbers of this fit."""
MOST_CELLS = 24
"""Largest string for this method: a window needs the response to each cell's differences, which takes ten seconds of
CPU for 60 cells, four times as long as the rest."""
NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Found:
    """Numbers common to several records, found by windows.

    Attributes
    ----------
    at : ndarray (k,) of int
        Their places among the coordinates of a problem.
    mean : ndarray (k,)
        In these coordinates.
    covariance : ndarray (k, k)
    """

    at: np.ndarray
    mean: Floats
    covariance: Floats


def learned(model: StringModel, records: Sequence[Measured], fit: MapFit | None = None) -> Posterior | None:
    """Learn from records as the service does if the same records are on the bus.

    Parameters
    ----------
    model : StringModel
    records : sequence of Measured
        Held-out readings are not used.
    fit : MapFit, optional
        Fit of a model with effects to these records: gives the effects' influence on current and inlet.

    Returns
    -------
    Posterior or None
        None if nothing is learnt from any window (too short, too cold, or rows too far apart), for strings of more
        than `MOST_CELLS`, and for a model whose effects change more than the heat in the cores and the inputs.
    """
    if model.cells > MOST_CELLS or (model.effects and not heat_only(model)):
        return None
    if fit is not None and model.effects:
        records = [replace(m, drive=_as_plain(fit, i, m)) for i, m in enumerate(records)]
    learner, found = WindowIdentifier(model), []
    for i, m in enumerate(records):
        if i:
            learner.cool_anew()
        for tick in _ticks(m, model.cells):
            if (job := learner.add(tick)) is not None:
                found.append(job.run())
                learner.accept(found[-1])
        if (job := learner.finish()) is not None:
            found.append(job.run())
            learner.accept(found[-1])
    return learner.posterior().as_constants([r.warmth for r in found]) if learner.windows else None


def untaught(model: StringModel) -> Posterior:
    """Return the priors of the numbers in the form of `learned`."""
    return WindowIdentifier(model).posterior()


def keeping(bench: Bench, fit: Fit, known: Posterior, whole_sd: Floats | None = None) -> Fit:
    """Give a fit the numbers from windows, and fit the rest.

    Parameters
    ----------
    bench : Bench
    fit : Fit
        Of the bench's records.
    known : Posterior
        From `learned` for the same records. Each of several records keeps its own cooling.
    whole_sd : ndarray (P,), optional
        sd of the coordinates from the fit of the whole record, if the windows have used that fit.

    Returns
    -------
    Fit
        The marginal posterior of these numbers is `known`, widened by `whole_sd` (`LEAST_SHARE`).
    """
    old = fit.map.problem
    found = _in_coordinates(old, known)
    if whole_sd is not None:
        found = _no_narrower(found, whole_sd[found.at])
    held = {
        old.coordinates[i].name: Belief(float(x), float(HELD * np.sqrt(v)))
        for i, x, v in zip(found.at, found.mean, np.diag(found.covariance), strict=True)
    }
    start = fit.map.theta.copy()
    start[found.at] = found.mean
    new = fit_with_error(bench, Problem(old.model, bench.records, {**bench.beliefs, **held}), start, TO_THE_END)
    theta, H = new.map.theta.copy(), new.map.H.copy()
    theta[found.at] = found.mean
    rest = np.setdiff1d(np.arange(len(H)), found.at)
    across = H[np.ix_(rest, found.at)]
    H[np.ix_(found.at, found.at)] = np.linalg.inv(found.covariance) + across.T @ np.linalg.solve(
        H[np.ix_(rest, rest)], across
    )
    return replace(new, map=replace(new.map, problem=old, theta=theta, H=H, tempered=True))


def _in_coordinates(problem: Problem, known: Posterior) -> Found:
    """Take the numbers that all records have in common from a posterior over logarithms."""
    names = [c.name for c in problem.coordinates]
    mine = [i for i, name in enumerate(known.names) if name in names]
    at = np.array([names.index(known.names[i]) for i in mine], np.intp)
    median = [float(np.mean(np.log(problem.model.priors[known.names[i]].value))) for i in mine]
    bounds = [(problem.coordinates[i].lower, problem.coordinates[i].upper) for i in at]
    mean = np.clip(known.mean[mine] - median, *np.transpose(bounds)) if mine else np.zeros(0)
    return Found(at, mean, known.cov[np.ix_(mine, mine)])


def _no_narrower(found: Found, sd: Floats) -> Found:
    """Widen numbers whose sd is below `LEAST_SHARE` of `sd` (k,); correlations are kept."""
    wider = np.maximum(1.0, LEAST_SHARE * sd / np.sqrt(np.diag(found.covariance)))
    return replace(found, covariance=found.covariance * np.outer(wider, wider))


def _as_plain(fit: MapFit, record: int, m: Measured) -> Drive:
    """Drive with which a string without effects has the heat and the inlet of a fit: see `window_effects`."""
    (system, _), X = fit.problem.system(record, fit.theta, fit.nu), fit.prediction.X[record]
    I2, T_in = m.drive.I2.copy(), m.drive.T_in.copy()
    first = 0
    for rows, part in system.parts():
        middle = (X[rows][1:] + X[rows][:-1]) / 2.0
        point = part.physics.point(middle, part.u, part.v, part.memory)
        own = slice(first, first := first + part.u.N)
        I2[own] = np.mean(point.core / part.v.string.R_e, axis=1)
        T_in[own] = np.broadcast_to(point.T_in, (part.u.N, 1))[:, 0]
    return replace(m.drive, I2=I2, T_in=T_in)


def _ticks(m: Measured, cells: int) -> Iterator[Tick]:
    """Yield a record as ticks, one at each instant of its grid, with a gap before each span."""
    u, dt = m.drive, m.drive.dt
    step_ns, time_ns, first_row = round(dt * NS), 0, 0
    for span in m.spans:
        K = len(span)
        surface, age = _read_at_ticks(m, span, first_row, cells)
        T = u.T_in[span.first : span.first + K]
        inlet = np.concatenate([T[:1], (T[1:] + T[:-1]) / 2.0, T[-1:]])
        for k in range(K + 1):
            i = span.first + max(k - 1, 0)
            since = dt if k else 2.0 * max(GAP_S, dt)
            yield Tick(time_ns, since, float(u.I2[i]), nan, float(inlet[k]), surface[k], age[k], float(u.I[i]))
            time_ns += step_ns
        first_row += K + 1


def _read_at_ticks(m: Measured, span: Span, first_row: int, cells: int) -> tuple[Floats, Floats]:
    """Surfaces (K + 1, n) and their ages at the instants of a span; of several readings in an interval the last."""
    K, dt = len(span), m.drive.dt
    surface, age = np.full((K + 1, cells), np.nan), np.zeros((K + 1, cells))
    cell = np.array([k - 1 if kind == "surface" else -1 for kind, k in m.channels])[m.channel]
    mine = np.flatnonzero(m.used & (m.row >= first_row) & (m.row <= first_row + K) & (cell >= 0))
    place = m.row[mine] - first_row + m.share[mine]
    at = np.minimum(np.ceil(place - 1e-9).astype(np.intp), K)
    surface[at, cell[mine]] = m.y[mine]
    age[at, cell[mine]] = np.maximum(at - place, 0.0) * dt
    return surface, age
