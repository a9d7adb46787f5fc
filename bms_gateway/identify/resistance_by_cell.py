r"""R_e of each cell of a string from one or a few surfaces, and from the cells' voltages if the bus has them.

The paper does not say how the parameters of several cells can be found from few sensors. Two sensors determine two
combinations of the R_e,k; differences between unread cells keep their prior, unless voltages determine them
(`cell_prior`). All other unknowns are marginalised and not estimated: per-cell R_u, R_c, C_c, the string's C_s, R_cc,
C_f, the sensors' offsets, the temperatures at the start, and three slow disturbances.

With f(θ) the undisturbed response and S the covariance of readings about it (`disturbed`), one step is

.. math::
    \theta \leftarrow \theta + (J^T S^{-1} J + \Lambda)^{-1} [J^T S^{-1} (y - f) + \Lambda(\bar\theta - \theta)]

This is Fisher scoring on the marginal likelihood. The derivatives of ln det S and of S inside the quadratic form cancel
in expectation, and both are omitted. Omitting only the first would favour numbers that make disturbances cheap (10 to
30 % of R_e, as in a joint fit of numbers and disturbances). The level of the cells' own disturbances is chosen by the
marginal likelihood itself, including ln det S.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.cell_prior import Baseline, CellPrior, CellSettings, Layout, cell_prior
from bms_gateway.identify.disturbed import Blocks, disturbed, whiten
from bms_gateway.identify.doubt import noise_factor, sound_sd
from bms_gateway.identify.quadratic import Quadratic
from bms_gateway.identify.response import Inputs, surfaces
from bms_gateway.thermal import Disturbance, Floats, Start, StringModel

PROBE = 1e-4
"""Step of ln θ for slopes: far above rounding, far below curvature."""
STEPS = 12
HALVINGS = 20
SETTLED = 0.02
"""A step below this many posterior sd (norm over all numbers) is the last."""
LEVELS = (1.0, 1.6, 2.5, 4.0, 6.3)
"""Factors on the cells' own disturbances that are tried in turn until the likelihood falls."""
UNLIKE_SD = 3.0
"""Prior sd by which a cell's number may differ from its string's mean: the most extreme of some tens of cells."""
LAGS_S = 600.0
"""Correlation of innovations is summed over the duration of disturbances."""


@dataclass(frozen=True, slots=True)
class CellRecord:
    """K steps of one string.

    Attributes
    ----------
    mean_square_current : ndarray (K,), A²
    inlet : ndarray (K + 1,), °C
        At the instants.
    surface : ndarray (K, r), °C
        Readings that belong to instants 1…K; NaN where there is none.
    age : ndarray (K, r), s
        Instant minus time of the reading, 0…dt.
    dt : float, s
    cells : tuple of int, optional
        0-based cells of these columns; all, in their order, by default.
    """

    mean_square_current: Floats
    inlet: Floats
    surface: Floats
    age: Floats
    dt: float = 1.0
    cells: tuple[int, ...] | None = None

    @property
    def read(self) -> tuple[int, ...]:
        """Columns with readings."""
        there: NDArray[np.bool_] = np.isfinite(self.surface)
        return tuple(k for k in range(there.shape[1]) if there[:, k].any())

    @property
    def sensed(self) -> tuple[int, ...]:
        """0-based cells with readings."""
        return self.read if self.cells is None else tuple(self.cells[k] for k in self.read)


@dataclass(frozen=True, slots=True)
class CellFit:
    """Gaussian posterior over θ.

    Attributes
    ----------
    layout : Layout
    mean : ndarray (p,)
        Logarithms of SI values.
    cov : ndarray (p, p)
        Inflated already.
    prior : CellPrior
        Without the record's temperatures, with the voltages.
    level : float
        Factor on the cells' own disturbances that fits the record best.
    inflation : float
        Factor on the data's covariance because the innovations are not white.
    sensed : tuple of int
        0-based.
    log_marginal : float
        Greatest ln p(y | θ), before any doubt.
    doubt : float
        Factor by which the noise was raised so that the numbers stay near their prior (`doubt`); 1 for a record that
        the model explains.
    """

    layout: Layout
    mean: Floats
    cov: Floats
    prior: CellPrior
    level: float
    inflation: float
    sensed: tuple[int, ...]
    log_marginal: float
    doubt: float = 1.0

    def baseline(self, resistance: Floats | None = None) -> Baseline:
        """Return the result, with the electrical resistances (n,) of the same run, as the prior of a later fit."""
        n = self.layout.cells
        return Baseline(self.layout, self.mean, self.cov, np.full(n, np.nan) if resistance is None else resistance)

    @property
    def R_e(self) -> Floats:
        """Median of each cell's R_e (n,), Ω."""
        return np.asarray(np.exp(self.mean[self.layout.at("R_e")]), dtype=np.float64)

    @property
    def R_e_cov(self) -> Floats:
        """Covariance of ln R_e (n, n)."""
        at = self.layout.at("R_e")
        return np.asarray(self.cov[np.ix_(at, at)], dtype=np.float64)

    @property
    def rel_sd(self) -> Floats:
        """Relative sd of each cell's R_e (n,)."""
        return np.asarray(np.sqrt(np.diag(self.R_e_cov)), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class CellNumbers:
    """A fit in the form for an observer: numbers of the cells, common uncertainty and each cell's own.

    Attributes
    ----------
    values : mapping of symbol to ndarray (n,) or float, SI
    names : tuple of str
    common : ndarray (p, p)
        Common part of the covariance of the logarithms, in the order of `names`.
    own : ndarray (n, 3, 3)
        The rest for ln R_e, ln R_u, ln R_c of each cell.
    """

    values: Mapping[str, float | Floats]
    names: tuple[str, ...]
    common: Floats
    own: Floats


def numbers_of(model: StringModel, fit: CellFit) -> CellNumbers:
    """Split a fit into the common part and each cell's own part.

    Returns
    -------
    CellNumbers
        Both covariances positive semi-definite; for a single cell everything is common.
    """
    n, layout = model.cells, fit.layout
    names = tuple(dict.fromkeys(s for s, _ in layout.names))
    p = layout.parameters(model, fit.mean)
    at = {s: np.array(layout.at(s) * (n if len(layout.at(s)) == 1 else 1)) for s in names}
    apart = ~np.eye(n, dtype=np.bool_) if n > 1 else np.ones((1, 1), np.bool_)
    common = np.array([[fit.cov[np.ix_(at[a], at[b])][apart].mean() for b in names] for a in names])
    common = _positive((common + common.T) / 2.0)
    own = np.zeros((n, 3, 3))
    mine = [s for s in ("R_e", "R_u", "R_c") if s in names]
    to, among = [("R_e", "R_u", "R_c").index(s) for s in mine], [names.index(s) for s in mine]
    for k in range(n):
        rows = np.array([at[s][k] for s in mine])
        own[k][np.ix_(to, to)] = _positive(fit.cov[np.ix_(rows, rows)] - common[np.ix_(among, among)])
    return CellNumbers({s: getattr(p, s) for s in names}, names, common, own)


def _positive(a: Floats) -> Floats:
    values, vectors = np.linalg.eigh(a)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Linear:
    """The record at one θ: block means of residuals and slopes, whitened."""

    white: Floats
    slopes: Floats
    log_det: float
    readings: int

    @property
    def deviance(self) -> float:
        return float(np.sum(self.white**2)) + self.log_det + self.readings * float(np.log(2.0 * np.pi))

    @property
    def info(self) -> Floats:
        """Fisher information of the readings alone (p, p)."""
        return np.asarray(np.einsum("bmp,bmq->pq", self.slopes, self.slopes), dtype=np.float64)

    def posterior(self, theta: Floats, prior: CellPrior) -> Quadratic:
        """Posterior about θ, to first order."""
        pull = np.einsum("bmp,bm->p", self.slopes, self.white) + prior.precision @ (prior.mean - theta)
        return Quadratic(self.info + prior.precision, pull)


class CellProblem:
    """Fit of one record."""

    def __init__(
        self, model: StringModel, record: CellRecord, settings: CellSettings, disturbance: Disturbance, start: Start
    ) -> None:
        self.model, self.record, self.settings = model, record, settings
        self.disturbance, self.start = disturbance, start
        self.layout = Layout.of(model)
        self.sensed = record.sensed
        steps = max(1, round(settings.block_s / record.dt))
        self.steps = min(steps, len(record.mean_square_current))
        K = len(record.mean_square_current)
        self.blocks = -(-K // self.steps)
        read = list(record.read)
        y = record.surface[:, read]
        self.there = np.isfinite(y)
        self.count = self._sum(self.there.astype(np.float64))
        self.y = y
        self.w = np.clip(np.nan_to_num(record.age[:, read]) / record.dt, 0.0, 1.0)
        J = np.zeros((K, 0))
        self.inputs = Inputs(record.mean_square_current, np.zeros(K), record.inlet, record.dt, J, np.zeros(0))
        first = [y[self.there[:, j], j][0] for j in range(y.shape[1])]
        self.level = float(np.mean(first)) if first else float(record.inlet[0])

    def _sum(self, x: Floats) -> Floats:
        """Sum over blocks: (K, m) → (B, m)."""
        padded = np.zeros((self.blocks * self.steps, x.shape[1]))
        padded[: len(x)] = x
        return np.asarray(padded.reshape(self.blocks, self.steps, -1).sum(axis=1), dtype=np.float64)

    def residuals(self, thetas: Sequence[Floats]) -> Floats:
        """Block means of readings minus undisturbed response (B, m, S)."""
        sets = [self.layout.parameters(self.model, t) for t in thetas]
        x0 = np.full((len(sets), 2 * self.model.cells), self.level)
        out = np.empty((self.blocks, len(self.sensed), len(sets)))
        for some, f in surfaces(sets, self.inputs, x0, self.sensed):
            f = f[:, 1:] + self.w * (f[:, :-1] - f[:, 1:])
            for s, own in enumerate(f, start=some.start):
                out[:, :, s] = self._sum(np.where(self.there, self.y - own, 0.0)) / np.maximum(self.count, 1.0)
        return out

    def inside(self, theta: Floats, step: Floats) -> Floats:
        """Largest part of `step` from a feasible θ that keeps a coolant node (bulk: R_u C_f > 1, plus the probe)."""
        if not self.model.has_coolant_path or self.model.coolant == "ntu":
            return np.asarray(theta + step, dtype=np.float64)
        for _ in range(HALVINGS):
            p = self.layout.parameters(self.model, there := theta + step)
            if bool(np.all(p.R_u * p.C_f > 1.001)):
                return np.asarray(there, dtype=np.float64)
            step = step / 2.0
        return theta

    def linear(self, theta: Floats, level: float) -> _Linear:
        """Linearise and whiten at θ."""
        p = len(theta)
        r = self.residuals([theta, *(theta + PROBE * e for e in np.eye(p))])
        r[:, :, 1:] = (r[:, :, :1] - r[:, :, 1:]) / PROBE
        return self.whitened(theta, r, level)

    def whitened(self, theta: Floats, columns: Floats, level: float) -> _Linear:
        """Whiten columns with the filter at θ."""
        d = replace(self.disturbance, heat_cell=level * self.disturbance.heat_cell)
        p = self.layout.parameters(self.model, theta)
        # the middle of the first block: the mean instant of readings 1…steps
        blocks = Blocks(self.steps * self.record.dt, (self.steps + 1) / 2.0 * self.record.dt)
        string = disturbed(p, self.sensed, blocks, d, self.settings.offset_sd, self.start)
        white, log_det = whiten(string, columns, self.count, d.sensor)
        return _Linear(white[:, :, 0], white[:, :, 1:], log_det, int((self.count > 0).sum()))


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of the cells of a string, besides the model and the record.

    Attributes
    ----------
    resistance, resistance_rel_sd : ndarray (n,) or None
        Electrical resistance of each cell and its relative error; NaN for a cell without voltage.
    baseline : Baseline or None
        Replaces the model's hierarchical prior: the result of a commissioning run with more sensors.
    guess : mapping of symbol to float
        Logarithm of the cells' geometric mean: start of the search if the prior is wide.
    """

    resistance: Floats | None = None
    resistance_rel_sd: Floats | None = None
    baseline: Baseline | None = None
    guess: Mapping[str, float] = field(default_factory=dict)

    def prior(self, model: StringModel, layout: Layout, settings: CellSettings) -> CellPrior:
        """Make the prior of θ; raise `ValueError` for a baseline of another structure."""
        R_el = np.full(model.cells, np.nan) if self.resistance is None else self.resistance
        sd = np.zeros(model.cells) if self.resistance_rel_sd is None else self.resistance_rel_sd
        if self.baseline is None:
            return cell_prior(model, layout, settings).with_electrical(layout.at("R_e"), R_el, sd, settings)
        if self.baseline.layout != layout:
            raise ValueError("baseline of a string with other numbers")
        return self.baseline.prior(R_el, sd, settings)

    def first(self, prior: CellPrior, layout: Layout) -> Floats:
        """Return θ at which the search starts."""
        first = prior.mean.copy()
        for symbol, ln in self.guess.items():
            if at_symbol := layout.at(symbol):
                first[at_symbol] += ln - first[at_symbol].mean()
        return first


def fit_cells(
    model: StringModel,
    record: CellRecord,
    *,
    known: Known | None = None,
    settings: CellSettings | None = None,
    disturbance: Disturbance | None = None,
    start: Start | None = None,
) -> CellFit:
    """Find R_e of each cell.

    Parameters
    ----------
    model : StringModel
        The priors' `rel_sd` are those of the string's means.
    record : CellRecord
    known : Known, optional
    settings, disturbance, start : optional

    Returns
    -------
    CellFit
        Always; cells without information keep their prior.

    Raises
    ------
    ValueError
        The baseline is of another structure: an error of the caller.

    Notes
    -----
    About 0.5 s for 5 cells and 89 minutes. Pure: the same arguments give the same result to the last bit.
    """
    known, settings, start = known or Known(), settings or CellSettings(), start or Start()
    problem = CellProblem(model, record, settings, disturbance or Disturbance(), start)
    layout = problem.layout
    prior = known.prior(model, layout, settings)
    if not problem.sensed:
        return CellFit(layout, prior.mean, _inverse(prior.precision), prior, 1.0, 1.0, (), 0.0)
    theta = _scored(problem, prior, known.first(prior, layout), 1.0)
    level, at = _best_level(problem, prior, theta)
    if level != 1.0:
        theta = _scored(problem, prior, theta, level)
        at = problem.linear(theta, level)
    inflation = _coloured(at.white, problem.count > 0, problem.steps * record.dt)
    info = at.info / inflation
    doubt = _doubt(layout, prior, info, theta)
    if doubt > 1.0:
        pull = (info + prior.precision) @ (theta - prior.mean) / doubt**2
        info, inflation = info / doubt**2, inflation * doubt**2
        theta = problem.inside(prior.mean, Quadratic(info + prior.precision, pull).step)
    cov = _inverse(info + prior.precision)
    return CellFit(layout, theta, cov, prior, level, inflation, problem.sensed, -0.5 * at.deviance, doubt)


def _doubt(layout: Layout, prior: CellPrior, info: Floats, theta: Floats) -> float:
    """Factor on the noise with which the string's means, and each cell's differences from them, stay near the prior."""
    cov = _inverse(prior.precision)
    rows, limits = [], []
    for symbol in dict.fromkeys(s for s, _ in layout.names):
        at = layout.at(symbol)
        mean = np.zeros(len(theta))
        mean[at] = 1.0 / len(at)
        rows.append(mean)
        limits.append(sound_sd(symbol))
        if len(at) > 1:
            rows += [np.eye(len(theta))[k] - mean for k in at]
            limits += [UNLIKE_SD] * len(at)
    judged = np.array(rows)
    sd = np.sqrt(np.einsum("cp,pq,cq->c", judged, cov, judged))
    return noise_factor(info, prior.precision, theta - prior.mean, judged, np.array(limits) * sd)


def _inverse(a: Floats) -> Floats:
    inverse = np.linalg.inv(a)
    return np.asarray((inverse + inverse.T) / 2.0, dtype=np.float64)


def _scored(problem: CellProblem, prior: CellPrior, theta: Floats, level: float) -> Floats:
    """Iterate to the fixed point; a step of more than three prior sd is shortened."""
    prior_sd = np.sqrt(np.diag(np.linalg.inv(prior.precision)))
    for _ in range(STEPS):
        q = problem.linear(theta, level).posterior(theta, prior)
        step = q.step
        far = float(np.max(np.abs(step) / np.minimum(prior_sd, 0.3)))
        theta = problem.inside(theta, step / max(1.0, far))
        if far < 1.0 and q.promise < SETTLED**2:
            break
    return theta


def _best_level(problem: CellProblem, prior: CellPrior, theta: Floats) -> tuple[float, _Linear]:
    """Choose the level of the cells' own disturbances by marginal likelihood, θ integrated out to first order."""
    r = problem.residuals([theta, *(theta + PROBE * e for e in np.eye(len(theta)))])
    r[:, :, 1:] = (r[:, :, :1] - r[:, :, 1:]) / PROBE
    best, chosen, kept = np.inf, 1.0, None
    for level in LEVELS:
        at = problem.whitened(theta, r, level)
        deviance = at.posterior(theta, prior).integrated(at.deviance)
        if kept is not None and deviance >= best:
            break
        best, chosen, kept = deviance, level, at
    return chosen, kept or problem.linear(theta, chosen)


def _coloured(white: Floats, there: NDArray[np.bool_], block_s: float) -> float:
    """Sum the innovations' correlations over the disturbances' time: their loss of information against white ones."""
    lags = max(1, round(LAGS_S / block_s))
    n = float(there.sum())
    total = float(np.sum(white**2)) / n
    for lag in range(1, min(lags, len(white) - 1) + 1):
        total += 2.0 * (1.0 - lag / (lags + 1)) * float(np.sum(white[lag:] * white[:-lag])) / n
    return max(1.0, total)
