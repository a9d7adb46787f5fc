"""The production method: one window after the other, evidence carried between them.

A window of twenty minutes holds two of the cell's slow time constants. Its fit (`posterior_fit`) is a job that may run
on another thread; the engine brings the result back at a bus time of its own. Between windows the evidence forgets a
little of R_e (as much as the last window saw it walk) and R_u, so that ageing and changes of flow are followed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import nan
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.identify.cell_kept import GROWN
from bms_gateway.identify.contract import (
    IDENTIFIED,
    LEARNING,
    Estimate,
    Posterior,
    Tick,
    estimates_of,
    log_prior,
    not_identifiable,
)
from bms_gateway.identify.evidence import Evidence, departures
from bms_gateway.identify.gathered import Gathered
from bms_gateway.identify.lumped import R_E, R_U, fold_distance, fold_gradient, lumped_jacobian
from bms_gateway.identify.posterior_fit import MODEL_SD, WALK_S, Fit, Root, Window, fit_window
from bms_gateway.identify.ticks import Ticks, before_full
from bms_gateway.thermal import KINDS, Floats, Prior, StringModel

CLOGGED = 0.05
"""ln: how far R_u may have gone since a fit that the model file carries, as `GROWN` for R_e. Held to the fit's own sd
they would be followed late, or never; with much more the two of them trade places in a window's noise."""
HOLD_CURRENT_S = 10.0  # a lost current is bridged so long: it cannot hide a drive
GAP_S = 10.0  # a longer tick is a gap: the bus slept, and a straight line through it would be made up
HOLD_INLET_S = 60.0  # the inlet moves slowly


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the windowed method.

    Attributes
    ----------
    window_s : float
        Length of a window: two slow time constants of a cell. The first one too: a fit of half that length takes a
        warming cell for a light one.
    shortest_s : float
        A window cut by a gap is used from this length on.
    cooling_drift : float
        Random step of ln R_u in 20 minutes: filters clog, fans wear, flow is not quite constant.
    least_rise : float
        K: a window whose heat warms the surface by less is left out; it teaches nothing and would only forget.
    good_sd : float
        Relative sd at which a parameter may be called identified.
    root : {"both", "smaller", "larger"}
        Which roots of Eq 9 are possible. Both, unless the flow is known to be forced past the cells (smaller R_u) or
        to stand still (larger): while the inlet stands still, nothing else tells them apart.
    model_sd : float
        K·√s: white error of the two-node model itself, whatever the sensor. The default is for real cells.
    """

    window_s: float = 1200.0
    shortest_s: float = 300.0
    cooling_drift: float = 0.005
    least_rise: float = 0.5
    good_sd: float = 0.15
    root: Root = "both"
    model_sd: float = MODEL_SD


@dataclass(frozen=True, slots=True)
class WindowJob:
    """One window's fit, complete in itself."""

    model: StringModel
    window: Window
    evidence: Evidence
    guess: Floats
    start: Floats | None
    root: Root
    model_sd: float

    def run(self) -> Fit:
        """Fit; the same job gives the same result to the last bit."""
        return fit_window(
            self.model, self.window, self.evidence, self.guess, self.start, root=self.root, model_sd=self.model_sd
        )


class WindowIdentifier:
    """Windowed maximum a posteriori identification of one string.

    Parameters
    ----------
    model : StringModel
    settings : Settings

    References
    ----------
    Lin et al., Eq 1, 16–18 for the model; the method is ours, in place of Eq 5.
    """

    def __init__(self, model: StringModel, settings: Settings | None = None) -> None:
        # plain dicts: a job must pickle, and read-only views of mappings do not
        self._model = replace(model, priors=_since(model), tolerances=dict(model.tolerances))
        self._settings = settings or Settings()
        self._names, self._prior_mean, self._prior_sd = log_prior(self._model)
        p = len(self._names)
        self._evidence = Evidence.none(p, departures(model))
        self._mean, self._cov = self._prior_mean.copy(), np.diag(self._prior_sd**2)
        self._guess = self._prior_mean.copy()
        self._other_root = 0.0
        self._walk = 0.0
        self._windows = 0
        self._from_voltage = False
        self._pending = False
        self._end: Floats | None = None
        self._clear()

    def _clear(self) -> None:
        self._dt = 0.0
        self._square: list[float] = []
        self._heat: list[float] = []
        self._readings = Gathered()
        self._inlet: list[float] = []
        self._joined = False  # the window begins where a fitted one ended
        self._held = (0.0, 0.0)  # seconds without current, without inlet

    def add(self, tick: Tick) -> WindowJob | None:
        """Take in one tick.

        Returns
        -------
        WindowJob or None
            A job when a window is full, or when a gap ends one that is long enough.
        """
        job = None
        if tick.dt > GAP_S or (self._square and abs(tick.dt - self._dt) > 1e-6):
            job = self._close()
        blind, still = self._held
        # plain numbers, many times a second: comparing them with themselves tells NaN far faster than numpy does
        square, heat, inlet = tick.mean_square_current, tick.heat, tick.inlet
        no_heat, no_inlet = square != square and heat != heat, inlet != inlet
        blind = blind + tick.dt if no_heat else 0.0
        still = still + tick.dt if no_inlet else 0.0
        if blind > HOLD_CURRENT_S or still > HOLD_INLET_S:
            return job or self._close()
        if not self._inlet:
            if no_heat or no_inlet:
                return job
            self._inlet = [inlet]  # the first tick gives the instant from which the window runs
            return job
        if no_heat:
            square, heat = (self._square[-1], self._heat[-1]) if self._square else (0.0, nan)
        self._held, self._dt = (blind, still), tick.dt
        self._square.append(square)
        self._heat.append(heat)
        self._readings.add(tick.surface, tick.age)
        self._inlet.append(self._inlet[-1] if no_inlet else inlet)
        if len(self._square) * tick.dt >= self._settings.window_s - 1e-6:
            return self._close(full=True)
        return job

    def patience(self, dt: float) -> int:
        """Tell how many regular ticks `take` may bring before one must come by `add`: none of them ends a window."""
        if not self._inlet or (self._square and abs(self._dt - dt) > 1e-6):
            return 0
        return before_full(self._settings.window_s, len(self._square), dt)

    def take(self, ticks: Ticks) -> None:
        """Take in regular ticks, no more than `patience` says; the same as adding them one by one."""
        self._held, self._dt = (0.0, 0.0), ticks.dt
        self._square += ticks.square.tolist()
        self._heat += ticks.heat.tolist()
        self._inlet += ticks.inlet.tolist()
        self._readings.take(ticks.surface, ticks.age)

    def _close(self, full: bool = False) -> WindowJob | None:
        """End the window; a job if it is long enough and warm enough and none is under way."""
        square, heat, inlet = np.array(self._square), np.array(self._heat), np.array(self._inlet)
        readings, dt, joined = self._readings, self._dt, self._joined
        self._clear()
        if not len(square) or len(square) * dt < self._settings.shortest_s or self._pending:
            return None
        measured = np.isfinite(heat)
        square = np.where(measured, 0.0, np.nan_to_num(square))
        heat = np.where(measured, heat, 0.0)
        R_e, R_u = np.exp(self._guess[[R_E, R_U]])
        if R_u * float(np.mean(square * R_e + np.abs(heat))) < self._settings.least_rise:
            return None
        window = Window(square, heat, inlet, *readings.whole(), dt)
        self._from_voltage = bool(measured.mean() > 0.5)
        evidence = self._evidence
        if self._windows:
            part = np.sqrt(len(square) * dt / WALK_S)
            steps = np.array([max(self._walk, 0.01), self._settings.cooling_drift]) * part
            along = np.zeros((len(evidence.grad), 2))
            along[: len(self._names)] = lumped_jacobian(self._guess, self._model.has_conduction)[:, [R_E, R_U]]
            evidence = evidence.forget(along, steps)
        self._pending = True
        if full:  # the next window runs on from this one's last instant
            self._inlet = [float(inlet[-1])]
        start = self._end if joined else None
        self._joined = full
        known = self._settings
        return WindowJob(self._model, window, evidence, self._guess, start, known.root, known.model_sd)

    def accept(self, result: Fit) -> None:
        """Take back the result of the last job."""
        self._evidence, self._mean, self._cov = result.evidence, result.mean, result.cov
        self._other_root, self._walk = result.other_root, result.walk
        self._guess = result.mode
        self._end = result.end
        self._windows += 1
        self._pending = False

    def posterior(self) -> Posterior:
        """Gaussian over the logarithms; the prior until the first window is in."""
        return Posterior(self._names, self._mean, self._cov)

    def estimates(self) -> tuple[Estimate, ...]:
        """Every parameter with sd and status."""
        status = [self._status(i) for i in range(len(self._names))]
        return estimates_of(self.posterior(), status)

    def _status(self, i: int) -> str:
        name, sd, prior = self._names[i], float(np.sqrt(self._cov[i, i])), float(self._prior_sd[i])
        if prior == 0.0:
            return "fixed"
        if not self._windows:
            return LEARNING
        if min(self._mean[i] - np.log(KINDS[name].lower), np.log(KINDS[name].upper) - self._mean[i]) < 0.01:
            return not_identifiable("at its bound")
        if sd < 0.5 * prior and sd < self._settings.good_sd:
            return IDENTIFIED
        return not_identifiable(self._why(i, sd))

    def _why(self, i: int, sd: float) -> str:
        if i == R_E and self._from_voltage:
            return "heat is taken from voltage"
        along = np.zeros(len(self._names))
        along[[R_E, R_U]] = 1.0
        rise_sd = float(np.sqrt(along @ self._cov @ along))
        if rise_sd > 0.3 and not self._from_voltage:
            return "too little current"
        g = fold_gradient(self._mean)
        if self._other_root > 0.02 or abs(fold_distance(self._mean)) < 2.0 * float(np.sqrt(g @ self._cov @ g)):
            return "near the fold R_u = R_u*"
        if i in (R_E, R_U) and rise_sd < 0.5 * sd:
            return "only R_e*R_u is determined"
        return "the data add little to the prior"

    def snapshot(self) -> dict[str, Any]:
        """Knowledge as JSON-able values; the window under way is not kept."""
        e = self._evidence
        arrays = {
            "z0": e.z0,
            "info": e.info,
            "grad": e.grad,
            "mean": self._mean,
            "cov": self._cov,
            "guess": self._guess,
        }
        return {
            "method": "window",
            "names": list(self._names),
            **{k: v.tolist() for k, v in arrays.items()},
            "other_root": self._other_root,
            "walk": self._walk,
            "windows": self._windows,
            "from_voltage": self._from_voltage,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a snapshot of a string with the same parameters.

        Raises
        ------
        StateError
            The snapshot is another method's or another structure's, or is not finite.
        """
        if state.get("method") != "window" or state.get("names") != list(self._names):
            raise StateError("identified parameters: the stored state is of another method or string; starting anew")
        p = len(self._names)
        c = p + departures(self._model)
        shapes = {"z0": (p,), "mean": (p,), "guess": (p,), "grad": (c,), "info": (c, c), "cov": (p, p)}
        vectors = {k: np.array(state[k], dtype=np.float64) for k in shapes}
        if any(v.shape != shapes[k] or not np.isfinite(v).all() for k, v in vectors.items()):
            raise StateError("identified parameters: the stored state is damaged; starting anew")
        self._evidence = Evidence(vectors["z0"], vectors["info"], vectors["grad"])
        self._mean, self._cov, self._guess = vectors["mean"], vectors["cov"], vectors["guess"]
        self._other_root, self._walk = float(state["other_root"]), float(state["walk"])
        self._windows, self._from_voltage = int(state["windows"]), bool(state["from_voltage"])
        self._pending = False
        self._clear()


def _since(model: StringModel) -> dict[str, Prior]:
    """Tell what is known of a string today: what was fitted once, and what it may have become since."""
    priors = dict(model.priors)
    if model.before is not None:
        for name, more in (("R_e", GROWN), ("R_u", CLOGGED)):
            p = priors[name]
            priors[name] = p if p.fixed else replace(p, rel_sd=max(p.rel_sd, more))
    return priors
