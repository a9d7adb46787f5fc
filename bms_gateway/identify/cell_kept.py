"""R_e of single cells from a commissioning run: how the model file keeps them, and how the gateway reads them.

Beyond Lin et al., whose last section leaves the parameters of single cells open.
"""

from dataclasses import replace

import numpy as np

from bms_gateway.identify.cell_prior import Baseline, CellSettings, Layout
from bms_gateway.identify.resistance_by_cell import CellFit, CellNumbers, numbers_of
from bms_gateway.thermal import KINDS, Commissioning, Floats, Prior, StringModel

GROWN = 0.15
"""Relative change of the cells' common R_e in a vehicle's life. With a smaller value, identification while driving
would take growth for an error of its readings: it would follow by half, and ageing would not be reported."""
LEAST_SD = 1e-6
"""Zero would mean fixed."""


def kept(model: StringModel, fit: CellFit, electrical: Floats) -> StringModel:
    """Keep a fit of single cells in the model of its string.

    Parameters
    ----------
    model : StringModel
        The knowledge before any data is kept in its `before`.
    fit : CellFit
        At nominal flow.
    electrical : ndarray (n,), Ω
        Electrical resistances of the same run; NaN where there were none.

    Returns
    -------
    StringModel
        Values per cell; `rel_sd` is the change in later years that the cells may have in common.
    """
    layout = fit.layout
    sd = np.sqrt(np.diag(fit.cov))
    correlation = np.round(fit.cov / np.outer(sd, sd), 9) + 0.0
    np.fill_diagonal(correlation, 1.0)
    priors = dict(model.priors)
    p = layout.parameters(model, fit.mean)
    for symbol in dict.fromkeys(s for s, _ in layout.names):
        one = len(layout.at(symbol)) == 1 and np.ndim(model.priors[symbol].value) == 0
        value = _rounded(np.atleast_1d(getattr(p, symbol)), symbol)
        priors[symbol] = Prior(float(value[0]) if one else value, model.priors[symbol].rel_sd)
    kind = KINDS["R_e"]
    plausible = np.where((electrical >= kind.lower) & (electrical <= kind.upper), electrical, np.nan)
    told = Commissioning(layout.labels, np.array([_short(x) for x in sd]), correlation, _rounded(plausible, "R_e"))
    out = replace(
        model,
        priors=priors,
        before=dict(model.before or model.priors),
        correlation=None,
        commissioning=told,
    )
    numbers = numbers_of(out, _today(out, _baseline(out, layout, told)))
    shared = dict(zip(numbers.names, np.sqrt(np.diag(numbers.common)).tolist(), strict=True))
    shared["R_e"] = float(np.hypot(shared["R_e"], GROWN))
    out = replace(
        out, priors={s: replace(x, rel_sd=_short(shared[s])) if s in shared else x for s, x in priors.items()}
    )
    if out.posterior is None:
        return out
    values, spread = out.free_numbers  # evidence against its cores remains
    return replace(out, posterior=replace(out.posterior, values=values, sd=spread))


def baseline_of(model: StringModel) -> Baseline | None:
    """Read the result of a commissioning run from the model; None without one, or with one of another structure."""
    layout, told = Layout.of(model), model.commissioning
    if told is None or model.effects or told.names != layout.labels:
        return None
    return _baseline(model, layout, told)


def numbers_kept(model: StringModel) -> CellNumbers | None:
    """Numbers of the cells with which an observer starts; None without a commissioning run."""
    baseline = baseline_of(model)
    return None if baseline is None else numbers_of(model, _today(model, baseline))


def _baseline(model: StringModel, layout: Layout, told: Commissioning) -> Baseline:
    mean = np.empty(len(layout.names))
    for symbol in dict.fromkeys(s for s, _ in layout.names):
        at = layout.at(symbol)
        ln = np.log(np.asarray(model.priors[symbol].value, dtype=np.float64))
        mean[at] = ln if len(at) > 1 else ln.mean()
    return Baseline(layout, mean, told.correlation * np.outer(told.rel_sd, told.rel_sd), told.electrical)


def _today(model: StringModel, baseline: Baseline) -> CellFit:
    """Posterior of the run, widened by possible ageing of the cells since."""
    n = model.cells
    prior = baseline.prior(np.full(n, np.nan), np.zeros(n), CellSettings())
    cov = np.linalg.inv(prior.precision)
    return CellFit(baseline.layout, prior.mean, (cov + cov.T) / 2.0, prior, 1.0, 1.0, (), 0.0)


def _rounded(x: Floats, symbol: str) -> Floats:
    """Round the shown number to six significant digits: far more exact than it is known, and readable in a file."""
    kind = KINDS[symbol]
    out = np.array([float(f"{v / kind.to_si:.6g}") * kind.to_si for v in x])
    return np.asarray(np.clip(out, kind.lower, kind.upper), dtype=np.float64)


def _short(sd: float) -> float:
    return float(f"{max(float(sd), LEAST_SD):.4g}")
