"""Identification of a string from whole records, and the conversion of a fit to the model that the gateway loads."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.coarse_rows import HOPELESS, doubt
from bms_gateway.diagnosis.core_band import posterior
from bms_gateway.diagnosis.error_words import falls
from bms_gateway.diagnosis.filed import bench_of, filed_fit, seen_on
from bms_gateway.diagnosis.geometry import OF, odd_fitted
from bms_gateway.diagnosis.model_error import REFINEMENTS
from bms_gateway.diagnosis.model_error import fit as fit_with_error
from bms_gateway.diagnosis.prepare import measured
from bms_gateway.diagnosis.record import Record
from bms_gateway.diagnosis.record_windows import keeping, learned, untaught
from bms_gateway.diagnosis.residuals import rmse, structured
from bms_gateway.identify.contract import FIXED
from bms_gateway.identify.coordinates import OWN, Coordinate
from bms_gateway.identify.map_fit import TO_THE_END, FitEffort, MapFit, fitted, stacked
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import KINDS, AddedEffect, Floats, Posterior, Prior, StringModel
from bms_gateway.thermal.effects import EffectParameter, effect_named

FOLLOWED = 0.007
"""Greatest error of a model with effects beyond the noise, as a share of the surfaces' range, for a fit of the whole.
Fits with a smaller error had honest bands, simulated and measured; half of those with a larger error had not."""
UNTOLD, WEAK = 0.9, 0.5
"""Posterior sd over prior sd above which a number is not identifiable, or only weakly."""
UNIDENTIFIABLE, AT_BOUND = "not identifiable", "at its bound: not believed"
AGAINST_FORMAT = "against the cell's format: not believed"
DOUBTED_FORMAT = "doubtful: unlike the cell's format"
DOUBTED = "doubtful: the model lacks something"
"""Status instead of `identified` if the readings show a model error beyond what the sd allow for."""
MOVED = "doubtful: moved from what was known, yet no better known"
"""Status instead of `not identifiable` if the mean left what was known: the readings say something, and it is odd."""
MOVED_SD = 2.0
"""Distance of a number from its prior, in sd of the prior, from which it has moved: one in twenty."""
LAST_DIGITS = FitEffort(60, least_gain=1e-3, refinements=REFINEMENTS)
"""Least gain for the numbers of a model with effects: in a long flat valley the core still moves by a kelvin at the
usual one."""
FIRM = 0.1
"""Relative prior sd up to which a parameter counts as known before the fit."""
LEARNT = 0.9
"""The same ratio for a cell's departure from the others, below which the departure goes into the model."""
SCATTERING = ("R_e", "R_u", "R_c")
"""Numbers in which cells differ within the tolerances."""
CALIBRATED = ("C_c", "C_s", "R_c")
"""Numbers that a calibration with the core fixes. Cooling depends on the place, resistance ages: both stay free."""
CELL_SD = 0.03
"""Relative scatter of cells of one type: a calibration of one cell determines another cell no better."""


@dataclass(frozen=True, slots=True)
class Change:
    """One number before and after a fit.

    Attributes
    ----------
    name : str
        Symbol, or `effect.parameter`.
    of : str
        Record that the number belongs to if each record has its own; otherwise empty.
    unit : str
    before, before_sd, after, after_sd : float
        In this unit. `after_sd` is that of the posterior, with the evidence tempered by the structure of the residual.
    status : str
        `identified`, `weakly identified`, `not identifiable: why`, `at its bound: not believed`,
        `against the cell's format: not believed`, `doubtful: …` or `fixed`.
    """

    name: str
    of: str
    unit: str
    before: float
    before_sd: float
    after: float
    after_sd: float
    status: str


@dataclass(frozen=True, slots=True)
class Identified:
    """The numbers of a model from some records, and the model error.

    Attributes
    ----------
    fit : MapFit
        The numbers and their posterior, compared with all readings as they came: everything that is shown of a fitted
        model, and the content of its file.
    closest : MapFit
        The fit that is closest to the surfaces, because it assumes no model error. It judges the model, as a search
        does, and is not for use. It is the same fit if the model explains the readings.
    model_error_K : float
        Size of the assumed slow error; 0 if the model explains the readings.
    """

    fit: MapFit
    closest: MapFit
    model_error_K: float

    @property
    def comes_closer(self) -> bool:
        """Whether `closest` is closer to the surfaces than the numbers."""
        used = stacked(self.fit.problem)[4]
        return falls(rmse(self.fit, used), rmse(self.closest, used))


@dataclass(frozen=True, slots=True)
class ChannelError:
    """Errors of one thermocouple in one record, K; NaN where there is no reading.

    Attributes
    ----------
    source : str
    kind : {"surface", "core"}
    cell : int
    trained_K, held_K, floor_K : float
    """

    source: str
    kind: str
    cell: int
    trained_K: float
    held_K: float
    floor_K: float


def identify(
    model: StringModel, records: Sequence[Record], *, core: bool = False, closest: MapFit | None = None
) -> Identified:
    """Fit a string to records, from the priors before any data.

    If the model cannot follow the surfaces to within their noise, the fit allows for a model error. Without it, the
    missing effect would count as white noise: it would move the numbers, and with them the core, far from the truth,
    with small standard deviations. The numbers then come from the windows of the live method (`record_windows`), if the
    effects of the model change only the heat in the cores and the inputs. Otherwise, structure that remains besides the
    model error lowers the weight of the data once more (`posterior`). If the rows of the current are so far apart that
    no window can use them, nothing is learnt from the records.

    Parameters
    ----------
    model : StringModel
    records : sequence of Record
        Records of one cell type: they share the physics; each has its own start and, if there are several, its own
        cooling.
    core : bool
        Whether to use thermocouples in cores too; nothing is then held out.
    closest : MapFit, optional
        Fit of this model, before any data, to these records, from the start of a search: it replaces a fit.
    """
    start = model.unfitted
    ready = [measured(r, start, core=core) for r in records] if closest is None else closest.problem.records
    fit = fitted(Problem(start, ready)) if closest is None else closest
    hopeless = max(doubt(r) for r in records) > HOPELESS
    if core or not (hopeless or structured(fit)):
        return Identified(fit, fit, 0.0)
    bench = bench_of(start, ready)
    problem = Problem(start, bench.records, bench.beliefs)
    found = fit_with_error(bench, problem, problem.begin, LAST_DIGITS if start.effects else TO_THE_END)
    of_whole = seen_on(found.map, ready)
    whole = _settled(of_whole, model) if start.effects else None
    if whole is not None and not hopeless and _missed(whole) <= FOLLOWED:
        return Identified(whole, fit, found.discrepancy.size)
    known = learned(start, ready, whole)
    if known is None and hopeless:
        known = untaught(start)
    if known is None:
        numbers = _settled(of_whole, model) if whole is None else whole
        return Identified(numbers, fit, found.discrepancy.size)
    believed = keeping(bench, found, known, None if whole is None else np.sqrt(np.diag(posterior(whole))))
    return Identified(_settled(seen_on(believed.map, ready), model), fit, believed.discrepancy.size)


def _settled(fit: MapFit, model: StringModel) -> MapFit:
    """Fit again what belongs to the record of a fit, with the numbers that the model file will contain."""
    problem = fit.problem
    if len(problem.records) > 1:  # each has its own cooling, and no file has several
        return fit
    own = filed_fit(fitted_model(fit, model), problem.records, model_error=True)
    found = dict(zip((c.name for c in own.problem.coordinates), own.theta.tolist(), strict=True))
    found |= dict(zip((c.name for c in own.problem.nuisances), own.nu.tolist(), strict=True))
    C = posterior(fit)
    found |= {
        problem.nuisances[i].name: 0.0
        for symbol in SCATTERING
        if not _told(fit, symbol, C)
        for i in _cells_of(fit, symbol)
    }
    theta = [found.get(c.name, z) for c, z in zip(problem.coordinates, fit.theta.tolist(), strict=True)]
    nu = [found.get(c.name, z) for c, z in zip(problem.nuisances, fit.nu.tolist(), strict=True)]
    return seen_on(replace(fit, theta=np.array(theta), nu=np.array(nu)), problem.records)


def _missed(fit: MapFit) -> float:
    """Root mean square error of a fit at the surfaces beyond their noise, as a share of their range."""
    y, sigma, _, _, used = stacked(fit.problem)
    excess = float(np.mean(np.square((y - fit.y)[used]) - np.square(sigma[used])))
    return float(np.sqrt(max(excess, 0.0)) / max(np.ptp(y[used]), 1e-9))


def fitted_model(
    fit: MapFit,
    model: StringModel,
    *,
    calibrated: bool = False,
    doubt: float = 0.0,
    model_error_K: float = 0.0,
    not_proven: Sequence[str] = (),
) -> StringModel:
    """Return the model with the numbers of a fit, for the gateway to estimate with.

    Parameters
    ----------
    fit : MapFit
        Fit of the model, or of the model with more effects, that starts from the priors before any data; this start is
        kept in `before` and in the `start` of each effect.
    model : StringModel
        The model; its numbers before any data are kept in `before`.
    calibrated : bool
        Whether the fit has used thermocouples in cores; its numbers of the cell then become priors, no narrower than
        the scatter between cells.
    doubt : float
        Share of core minus surface that may be wrong in addition to the covariance of the numbers.
    model_error_K : float
        Model error that the fit allowed for.
    not_proven : sequence of str
        Reasons why the core is not proven.

    Returns
    -------
    StringModel
        If several records each have their own cooling, R_u is the geometric mean, and its sd covers that of a further
        record. Cells get values of their own if the readings determine them; their tolerances stay, because these
        values are not exact either.
    """
    problem = fit.problem
    names, mix = _mixed(fit)
    C = posterior(fit)
    P = len(fit.theta)
    z = mix @ fit.theta
    covariance = mix @ C[:P, :P] @ mix.T + np.diag([_scatter(fit, name) for name in names])
    sd = np.sqrt(np.diag(covariance))
    priors = dict(problem.model.priors)
    for name, x, spread in zip(names, z, sd, strict=True):
        if name in priors:
            value = np.asarray(priors[name].value) * np.exp(x) * _departures(fit, name, C)
            kind = KINDS[name]
            value = np.clip(_rounded(value, kind.to_si), kind.lower, kind.upper)
            priors[name] = Prior(value if value.ndim else float(value), _short(spread))
    before = dict(model.before or model.priors)
    if calibrated:
        for name in CALIBRATED:
            if name in names:
                value = float(np.exp(np.mean(np.log(priors[name].value))))
                before[name] = Prior(
                    float(_rounded(np.asarray(value), KINDS[name].to_si)), max(CELL_SD, priors[name].rel_sd)
                )
    spread_of = dict(zip(names, sd.tolist(), strict=True))
    scale = np.outer(sd, sd)
    found = replace(
        problem.model,
        priors=priors,
        effects=tuple(_effect(fit, e, spread_of) for e in problem.model.effects),
        before=before,
        correlation=(tuple(names), _correlation(covariance / scale)) if len(names) > 1 else None,
    )
    left = Posterior(*found.free_numbers, model_error_K, doubt, calibrated, tuple(not_proven))
    return replace(found, posterior=left)


def starting_with(fit: MapFit, model: StringModel) -> StringModel:
    """Return a model before any data with the effects of a fit, whose numbers are the start of its identification."""
    effects = fitted_model(fit, model).effects
    return replace(model.unfitted, effects=tuple(replace(e, start=None) for e in effects))


def changes(fit: MapFit, *, doubted: bool = False) -> tuple[Change, ...]:
    """List every number of a fit before and after the fit; `doubted` as `KnownCore.numbers_doubted`."""
    model = fit.problem.model
    sd = np.sqrt(np.diag(posterior(fit)))
    sources = [m.source for m in fit.problem.records]
    odd = _unlike_format(fit)
    found = []
    for name, prior in model.priors.items():
        kind = KINDS[name]
        value = float(np.exp(np.mean(np.log(prior.value)))) / kind.to_si
        if prior.fixed:
            found.append(Change(name, "", kind.unit, value, 0.0, value, 0.0, FIXED))
            continue
        for i, c in enumerate(fit.problem.coordinates):
            if c.name.partition("@")[0] != name or c.effect is not None:
                continue
            now = value * float(np.exp(fit.theta[i]))
            of = "" if c.record is None else sources[c.record]
            status = _status(fit, i, sd[i], odd, doubted)
            found.append(Change(name, of, kind.unit, value, value * prior.rel_sd, now, now * float(sd[i]), status))
    for e in model.effects:
        found += [_effect_change(fit, e, p, sd, odd, doubted) for p in effect_named(e.name).parameters]
    return tuple(found)


def channel_errors(fit: MapFit) -> tuple[ChannelError, ...]:
    """Errors of each thermocouple of each record."""
    found, first = [], 0
    _, sigma, _, _, _ = stacked(fit.problem)
    for m in fit.problem.records:
        part = slice(first, first + len(m.y))
        first += len(m.y)
        error, noise = m.y - fit.y[part], sigma[part]
        for j, (kind, cell) in enumerate(m.channels):
            mine = m.channel == j
            found.append(
                ChannelError(
                    m.source,
                    "surface" if kind == "surface" else "core",
                    cell,
                    root_mean_square(error[mine & m.used]),
                    root_mean_square(error[mine & ~m.used]),
                    root_mean_square(noise[mine]),
                )
            )
    return tuple(found)


def root_mean_square(x: Floats) -> float:
    """Root mean square; NaN without values."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


def _mixed(fit: MapFit) -> tuple[list[str], Floats]:
    """Return the names of the model's free numbers, and the matrix from coordinates to them, as means over records."""
    coordinates = fit.problem.coordinates
    plain = [c.name.partition("@")[0] for c in coordinates]
    names = [n for n in fit.problem.model.priors if n in plain]
    names += [c.name for c in coordinates if c.effect is not None]
    mix = np.array([[float(p == n) for p in plain] for n in names]).reshape(len(names), len(plain))
    return names, mix / np.maximum(mix.sum(axis=1, keepdims=True), 1.0)


def _scatter(fit: MapFit, name: str) -> float:
    """Variance of a number between records, because a further record has its own cooling too."""
    own = [z for c, z in zip(fit.problem.coordinates, fit.theta, strict=True) if c.name.startswith(f"{name}@")]
    return float(np.var(own, ddof=1)) if name in OWN and len(own) > 1 else 0.0


def _departures(fit: MapFit, name: str, C: Floats) -> Floats | float:
    """Factor of each cell (n,) on the string's value; 1 if the readings do not determine single cells."""
    return np.asarray(1.0 + fit.nu[_cells_of(fit, name)]) if _told(fit, name, C) else 1.0


def _cells_of(fit: MapFit, name: str) -> list[int]:
    """Places of the cells' departures among the nuisances."""
    return [i for i, c in enumerate(fit.problem.nuisances) if c.name.startswith(f"{name}[")]


def _told(fit: MapFit, name: str, C: Floats) -> bool:
    """Whether the cells' departures go into the model."""
    at = _cells_of(fit, name)
    if not at or not len(fit.nu):
        return False
    sd, prior = np.sqrt(np.diag(C)[[len(fit.theta) + i for i in at]]), fit.linear.sd[at]
    return bool((sd < LEARNT * prior).any())


def _effect(fit: MapFit, e: AddedEffect, spread: Mapping[str, float]) -> AddedEffect:
    values, sd = dict(e.values), dict.fromkeys(e.values, 0.0)
    for p in effect_named(e.name).parameters:
        name = f"{e.key}.{p.name}"
        if name in spread:
            z = float(fit.theta[fit.problem.index(name)])
            value = float(_rounded(np.asarray(np.exp(z) if p.log else z), p.to_si))
            values[p.name] = min(max(value, p.lower), p.upper)
            sd[p.name] = _short(spread[name]) if p.log else _short(spread[name] / p.to_si) * p.to_si
    return replace(e, values=values, sd=sd, start=e.values if any(sd.values()) else None)


def _effect_change(
    fit: MapFit, e: AddedEffect, p: EffectParameter, sd: Floats, odd: Mapping[str, bool], doubted: bool
) -> Change:
    name = f"{e.key}.{p.name}"
    before = p.prior / p.to_si
    before_sd = before * p.sd if p.log else p.sd / p.to_si
    if name not in [c.name for c in fit.problem.coordinates]:
        value = e.values[p.name] / p.to_si
        return Change(name, "", p.unit, value, 0.0, value, 0.0, FIXED)
    i = fit.problem.index(name)
    z = float(fit.theta[i])
    value = (float(np.exp(z)) if p.log else z) / p.to_si
    spread = value * float(sd[i]) if p.log else float(sd[i]) / p.to_si
    return Change(name, "", p.unit, before, before_sd, value, spread, _status(fit, i, sd[i], odd, doubted))


def statuses(fit: MapFit, *, doubted: bool = False) -> list[str]:
    """Decide for each coordinate of a fit whether the records identify it; no other place decides this.

    `doubted` as `KnownCore.numbers_doubted`.
    """
    sd, odd = np.sqrt(np.diag(posterior(fit))), _unlike_format(fit)
    return [_status(fit, i, float(sd[i]), odd, doubted) for i in range(len(fit.theta))]


def _unlike_format(fit: MapFit) -> Mapping[str, bool]:
    """Return the symbols whose fitted values are unusual for the model's format, and whether they are impossible."""
    return {symbol: odd.excluded for odd in odd_fitted(fit) for symbol in OF[odd.name]}


def _status(fit: MapFit, i: int, sd: float, odd: Mapping[str, bool], doubted: bool) -> str:
    c = fit.problem.coordinates[i]
    symbol = c.name.partition("@")[0] if c.effect is None else ""
    if odd.get(symbol, False):
        return AGAINST_FORMAT
    if fit.at_bound(c.name):
        return AT_BOUND
    if sd > UNTOLD * c.sd:
        if moved(c, float(fit.theta[i])):
            return MOVED
        if c.effect is None and c.sd <= FIRM:
            return f"{UNIDENTIFIABLE}: known to {100.0 * c.sd:.2g} % beforehand"
        return f"{UNIDENTIFIABLE}: the data say no more than was known"
    if symbol in odd:
        return DOUBTED_FORMAT
    if doubted:
        return DOUBTED
    return "weakly identified" if sd > WEAK * c.sd else "identified"


def moved(c: Coordinate, z: float) -> bool:
    """Whether a number left what was known of it before the data."""
    return abs(z - c.prior) > MOVED_SD * c.sd


def _rounded(x: Floats, to_si: float) -> Floats:
    """Round to six significant digits of the shown number, far finer than its uncertainty."""
    return np.asarray([float(f"{v / to_si:.6g}") * to_si for v in np.ravel(x)]).reshape(np.shape(x))


def _short(sd: float) -> float:
    return float(f"{max(sd, 1e-6):.4g}")  # zero would mean fixed


def _correlation(R: Floats) -> Floats:
    """Return the correlation: symmetric, ones on the diagonal, rounded."""
    R = np.round(0.5 * (R + R.T), 6) + 0.0
    np.fill_diagonal(R, 1.0)
    return np.asarray(R)
