"""R_e of each cell while driving: ticks are collected, a job fits them, and the observer takes the result.

One record lasts an hour and a half. It is fitted three times on the way, each time as a whole. At its end, its
posterior becomes the next record's prior (`Baseline`): joints and thermal resistances are learnt once, later only
changes. Strings without cell voltages on the bus are not fitted: two surfaces do not determine five cells.

Beyond Lin et al., whose last section leaves the parameters of single cells open.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isnan, log
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.identify.cell_kept import baseline_of
from bms_gateway.identify.cell_prior import Baseline, CellPrior, CellSettings, Layout
from bms_gateway.identify.cells_in_words import cell_estimates
from bms_gateway.identify.contract import Estimate, Posterior, Tick
from bms_gateway.identify.doubt import HOPELESS
from bms_gateway.identify.electrical import ElectricalResistance, ElectricalSums, PairMeans
from bms_gateway.identify.resistance_by_cell import CellFit, CellNumbers, CellRecord, Known, fit_cells, numbers_of
from bms_gateway.identify.stretch import Stretch
from bms_gateway.identify.window_readings import GAP_S
from bms_gateway.thermal import Disturbance, Floats, StringModel

MILESTONES_S = (1800.0, 3600.0, 5400.0)
"""Lengths at which a record is fitted; the last one ends it."""
STALE_S = 1.5 * MILESTONES_S[-1]
"""Driving time without a fit (as when the voltages are lost) after which the common parameters are more accurate."""
FLOW_MOVED = 0.05
"""Change of ln(flow ratio) within a record that ends it: C_f is one number per record."""


@dataclass(frozen=True, slots=True)
class CellResult:
    """Result of a job, and whether its record is over."""

    fit: CellFit
    resistance: Floats
    over: bool
    warning: str = ""


@dataclass(frozen=True, slots=True)
class CellJob:
    """One record's fit with all its data; `flow` is its coolant flow over nominal."""

    model: StringModel
    record: CellRecord
    electrical: ElectricalResistance
    baseline: Baseline | None
    settings: CellSettings
    disturbance: Disturbance
    guess: Mapping[str, float]
    flow: float
    over: bool

    def run(self) -> CellResult:
        """Fit the record; the same job gives the same result to the last bit. Its numbers are at nominal flow."""
        ln = float(np.log(self.flow))
        priors, guess, baseline = dict(self.model.priors), dict(self.guess), self.baseline
        if "C_f" in priors and ln != 0.0:
            priors["C_f"] = replace(priors["C_f"], value=np.asarray(priors["C_f"].value) * self.flow)
            if "C_f" in guess:
                guess["C_f"] += ln
            if baseline is not None:
                baseline = replace(baseline, mean=_shifted(baseline.layout, baseline.mean, ln))
        fit = fit_cells(
            replace(self.model, priors=priors),
            self.record,
            known=Known(self.electrical.value, self.electrical.with_skew(self.settings.skew_s), baseline, guess),
            settings=self.settings,
            disturbance=self.disturbance,
        )
        prior = replace(fit.prior, mean=_shifted(fit.layout, fit.prior.mean, -ln))
        fit = replace(fit, mean=_shifted(fit.layout, fit.mean, -ln), prior=prior)
        warning = self.electrical.warning(self.settings.skew_s, self.settings.joint_sd)
        return CellResult(fit, self.electrical.value, self.over, warning)


def _shifted(layout: Layout, theta: Floats, ln: float) -> Floats:
    """Move ln C_f."""
    out = theta.copy()
    out[layout.at("C_f")] += ln
    return out


class CellIdentifier:
    """Per-cell R_e of one string, live.

    Parameters
    ----------
    model : StringModel
        More than one cell, no effects. The result of a commissioning run in it is the first record's prior.
    disturbance : Disturbance, optional
    settings : CellSettings, optional
    """

    def __init__(
        self, model: StringModel, disturbance: Disturbance | None = None, settings: CellSettings | None = None
    ) -> None:
        # plain dicts, because a job must be picklable and read-only mapping views are not
        self._model = replace(model, priors=dict(model.priors), tolerances=dict(model.tolerances))
        settings = settings or CellSettings()
        self._settings = replace(settings, spread=dict(settings.spread))
        self._disturbance = disturbance or Disturbance()
        self._sums = ElectricalSums(model.cells)
        self._fit: CellFit | None = None
        self._resistance = np.full(model.cells, np.nan)
        self._baseline = baseline_of(model)
        self._pending = False
        self._warning = ""
        self._since = 0.0  # seconds of awake time since the last fit
        self._clear()

    def _clear(self) -> None:
        self._ticks = Stretch(([],))  # I², A²
        self._flow = 1.0
        self._fitted_s, self._next_s = 0.0, MILESTONES_S[0]
        self._heard = False
        self._sums.reset()

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Forget the readings of a cell (0-based) in the last seconds of the present window."""
        self._ticks.disbelieve(cell, seconds)

    def add(
        self, tick: Tick, pairs: PairMeans | None, current: float, flow_ratio: float, common: Callable[[], Posterior]
    ) -> CellJob | None:
        """Include one tick.

        Parameters
        ----------
        tick : Tick
        pairs : PairMeans or None
            Voltages of the tick's cells with the current at their instants.
        current : float, A
            Mean of the tick.
        flow_ratio : float
            Coolant flow over nominal; NaN where unknown.
        common : callable
            Returns the posterior of the common parameters, where the first fit begins to search.

        Returns
        -------
        CellJob or None
        """
        job = None
        self._since += min(tick.dt, GAP_S)
        ratio = flow_ratio if flow_ratio > 0.0 else self._flow
        moved = len(self._ticks) > 0 and ratio != self._flow and abs(log(ratio / self._flow)) > FLOW_MOVED
        if tick.dt > GAP_S or moved or self._ticks.steps_otherwise(tick.dt):
            job = self._close(common)
        begins = not self._ticks.inlet
        square = tick.mean_square_current
        taken = self._ticks.add(tick, None if isnan(square) else (square,), (0.0,))
        if taken == "lost":
            return job or self._close(common)
        if taken == "waits":
            if self._ticks.inlet and begins:
                self._flow = ratio
            return job
        self._heard |= pairs is not None
        self._sums.update(pairs, current, tick.dt)
        seconds = self._ticks.length_s
        if not self._heard and seconds >= MILESTONES_S[0] / 2.0:
            self._clear()  # no voltages on this bus: there will be no fit
            return job
        if seconds >= self._next_s:
            over = seconds >= MILESTONES_S[-1]
            job = self._job(common, over) or job
            self._fitted_s = seconds
            self._next_s = min((m for m in MILESTONES_S if m > seconds), default=inf)
            if over:
                self._clear()
        return job

    def _close(self, common: Callable[[], Posterior]) -> CellJob | None:
        """End the record; return a job if the record has data beyond its last fit."""
        seconds = self._ticks.length_s
        job = self._job(common, over=True) if seconds >= max(MILESTONES_S[0], 1.2 * self._fitted_s) else None
        self._clear()
        return job

    def _job(self, common: Callable[[], Posterior], over: bool) -> CellJob | None:
        ticks = self._ticks
        electrical = self._sums.result(ticks.dt)
        if self._pending or 2 * int(np.isfinite(electrical.value).sum()) < self._model.cells:
            return None
        surface, age, read = ticks.readings.read()
        record = CellRecord(np.array(ticks.of_ticks[0]), np.array(ticks.inlet), surface, age, ticks.dt, read)
        if not record.sensed:
            return None
        self._pending = True
        known = common()
        guess = {} if self._baseline else dict(zip(known.names, known.mean.tolist(), strict=True))
        return CellJob(
            self._model,
            record,
            electrical,
            self._baseline,
            self._settings,
            self._disturbance,
            guess,
            self._flow,
            over,
        )

    def accept(self, result: CellResult) -> None:
        """Use the result of the last job."""
        self._pending, self._warning = False, result.warning
        if result.fit.doubt > HOPELESS:  # nothing is learnt; earlier knowledge of the cells may be wrong too
            self._fit = None
            self._clear()  # what the model does not explain would spoil the later fits of this record too
            return
        self._since = 0.0
        self._fit, self._resistance = result.fit, result.resistance
        if result.over:
            self._baseline = result.fit.baseline(result.resistance)

    @property
    def fit(self) -> CellFit | None:
        """The newest fit, at nominal flow."""
        return self._fit

    @property
    def warning(self) -> str:
        """A sentence if the voltages' skew spoils the fit; empty otherwise."""
        return self._warning

    def numbers(self) -> CellNumbers | None:
        """Numbers for the observer if all cells' R_e are identified and the fit is recent; None otherwise."""
        if self._fit is None or self._since > STALE_S or self._fit.rel_sd.max() > self._settings.good_sd:
            return None
        return numbers_of(self._model, self._fit)

    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates `R_e_1` … `R_e_n`, empty before the first fit."""
        return () if self._fit is None else cell_estimates(self._fit, self._settings, self._resistance)

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values, without the current record."""
        return {
            "names": [list(name) for name in Layout.of(self._model).names],
            "fit": None if self._fit is None else _plain(self._fit.mean, self._fit.cov),
            "since": self._since,
            "sensed": [] if self._fit is None else list(self._fit.sensed),
            "resistance": _numbers(self._resistance),
            "baseline": None if self._baseline is None else _plain(self._baseline.mean, self._baseline.cov),
            "baseline_resistance": None if self._baseline is None else _numbers(self._baseline.resistance),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a snapshot of a string with the same parameters.

        Raises
        ------
        StateError
            The snapshot belongs to another structure, or is not finite.
        """
        layout = Layout.of(self._model)
        if state.get("names") != [list(name) for name in layout.names]:
            raise StateError("resistances of the cells: the stored state is of another string; starting anew")
        p = len(layout.names)
        fit, baseline = (_taken(state[key], p) for key in ("fit", "baseline"))
        self._resistance = _array(state["resistance"], self._model.cells)
        if fit is not None:  # the posterior replaces the earlier prior
            prior = CellPrior(fit[0], np.asarray(np.linalg.pinv(fit[1], hermitian=True), dtype=np.float64))
            sensed = tuple(int(k) for k in state["sensed"])
            self._fit = CellFit(layout, *fit, prior, 1.0, 1.0, sensed, 0.0)
        if baseline is not None:
            before = _array(state["baseline_resistance"], self._model.cells)
            self._baseline = Baseline(layout, *baseline, before)
        self._since = float(state["since"])
        self._pending = False
        self._clear()


def _numbers(a: Floats) -> list[float | None]:
    return [x if x == x else None for x in a.tolist()]


def _array(values: Sequence[float | None], n: int) -> Floats:
    a = np.array([np.nan if x is None else x for x in values], dtype=np.float64)
    if a.shape != (n,) or bool((a <= 0.0).any()):
        raise StateError("resistances of the cells: the stored state is damaged; starting anew")
    return a


def _plain(mean: Floats, cov: Floats) -> dict[str, list[float]]:
    return {"mean": mean.tolist(), "cov": cov[np.tril_indices(len(mean))].tolist()}


def _taken(state: Mapping[str, Any] | None, p: int) -> tuple[Floats, Floats] | None:
    if state is None:
        return None
    mean, lower = (np.array(state[key], dtype=np.float64) for key in ("mean", "cov"))
    rows, columns = np.tril_indices(p)
    if mean.shape != (p,) or lower.shape != rows.shape or not (np.isfinite(mean).all() and np.isfinite(lower).all()):
        raise StateError("resistances of the cells: the stored state is damaged; starting anew")
    cov = np.empty((p, p))
    cov[rows, columns] = cov[columns, rows] = lower
    if np.linalg.eigvalsh(cov)[0] < -1e-9:
        raise StateError("resistances of the cells: the stored state is damaged; starting anew")
    return mean, cov
