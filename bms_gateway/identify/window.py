"""The method for vehicles: one window after the other, with evidence carried between them.

A window of twenty minutes contains two of the cell's slow time constants. Its fit (`posterior_fit`) is a job that may
run on another thread; the engine returns the result at a bus time that it chooses. Between windows a little of the
evidence on R_e (its walk in the last window) and R_u is discarded, so that ageing and changes of flow are followed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.identify.carried import NAMES as CARRIED
from bms_gateway.identify.cell_kept import GROWN
from bms_gateway.identify.contract import (
    IDENTIFIED,
    LEARNING,
    Estimate,
    HeatGain,
    Posterior,
    Tick,
    estimates_of,
    log_prior,
    not_identifiable,
)
from bms_gateway.identify.doubt import DOUBTED
from bms_gateway.identify.entropic_charge import EntropicCharge
from bms_gateway.identify.for_observer import APART_AT, APART_SD
from bms_gateway.identify.identifiable import C_C, R_C, R_E, R_U, fold_distance, fold_gradient, lumped_jacobian
from bms_gateway.identify.posterior_fit import Fit, Root, WindowJob
from bms_gateway.identify.ticks import Ticks, before_full
from bms_gateway.identify.unsized import as_shown, shown_sd
from bms_gateway.identify.window_evidence import Evidence, departures
from bms_gateway.identify.window_now import WindowNow
from bms_gateway.identify.window_problem import MODEL_SD, WALK_S
from bms_gateway.identify.window_readings import GAP_S
from bms_gateway.thermal import HEAT_GAIN_SD, KINDS, Floats, Prior, StringModel
from bms_gateway.thermal.entropy import CAPACITY_AH, PRIOR_SD

CLOGGED = 0.05
"""ln: sd of the change of R_u since a fit in the model file, like `GROWN` for R_e. With the fit's own sd alone, changes
would be followed late or never; with much more, noise of a window exchanges parts of the two."""
CARRIED_DRIFT = 0.3
"""Sd of a carried effect's change from one window to the next, in its own sd: it differs between drives."""
OTHER_WARMTH = 0.3
"""ln: sd of R_e at 25 °C where R_e is known at another temperature that cells have while driving (`thermal.warmth`)."""
FORGOTTEN = 10.0
"""ln: a step of R_u that removes all earlier knowledge of it."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Constants of the windowed method.

    Attributes
    ----------
    window_s : float
        Length of a window: two slow time constants of a cell. Also of the first window: a fit of half that length would
        mistake a warming cell for a light one.
    first_look_s : float
        Length at which the first window is fitted before it is full; the result goes to the observer and is replaced by
        that of the whole window.
    shortest_s : float
        A window cut by a gap is used from this length on.
    cooling_drift : float
        Random step of ln R_u in 20 minutes: filters clog, fans wear, flow is not quite constant.
    least_rise : float
        K: a window whose heat warms the surface by less is not used: it has no information, and evidence would be lost.
    good_sd : float
        Relative sd up to which a parameter is called identified.
    root : {"both", "smaller", "larger"}
        Possible roots of Eq 9. Both, unless the flow is known to be forced past the cells (smaller R_u) or to be still
        (larger): with a constant inlet, the data cannot decide.
    carried : float
        Size of the effects that every real cell may have, in their own sd. 0 for cells that are exactly two nodes, as
        the simulated cells of the paper.
    model_sd : float
        K·√s: white error of the two-node model itself, for any sensor. The default is for real cells.
    """

    window_s: float = 1200.0
    first_look_s: float = 600.0
    shortest_s: float = 300.0
    cooling_drift: float = 0.005
    least_rise: float = 0.5
    good_sd: float = 0.15
    root: Root = "both"
    carried: float = 1.0
    model_sd: float = MODEL_SD


@dataclass(frozen=True, slots=True)
class _Told:
    """Content of `posterior` and `doubts`: from the newest fit, also from an early one.

    Attributes
    ----------
    mean, cov : ndarray (p,), (p, p)
        Of the logarithms of the parameters.
    gain : float
        ln of the gain of heat by the voltage.
    gain_cov : ndarray (p + 1,)
        Its covariance with the logarithms, and its variance.
    doubt : float
    constant : ndarray (n,)
        As of `Fit`.
    """

    mean: Floats
    cov: Floats
    gain: float
    gain_cov: Floats
    doubt: float
    constant: Floats


class WindowIdentifier:
    """Windowed maximum a posteriori identification of one string.

    Attributes
    ----------
    now : WindowNow
        The present window.

    References
    ----------
    Lin et al., Eq 1, 16–18 for the model; the method replaces Eq 5 and is not in the paper.
    """

    learns = True

    def __init__(self, model: StringModel, settings: Settings | None = None) -> None:
        # plain dicts, because a job must be picklable and read-only mapping views are not
        self._model = replace(model, priors=_since(model), tolerances=dict(model.tolerances))
        self._settings = settings or Settings()
        self._names, self._prior_mean, self._prior_sd = log_prior(self._model)
        p = len(self._names)
        self._shown = shown_sd(float(self._prior_sd[C_C]))
        self._evidence = Evidence.none(p, len(CARRIED) + departures(model))
        self._told = _Told(
            self._prior_mean.copy(), np.diag(self._prior_sd**2), 0.0, np.zeros(p + 1), 1.0, np.zeros(model.cells)
        )
        self._guess = self._prior_mean.copy()
        self._other_root = 0.0
        self._walk = 0.0
        self._windows = 0
        self._from_voltage = False
        self._out: Literal["", "window", "look"] = ""
        self._end: Floats | None = None
        self._entropy = EntropicCharge(3600.0 * (model.capacity_Ah or CAPACITY_AH))
        self.now = WindowNow()

    def add(self, tick: Tick) -> WindowJob | None:
        """Include one tick.

        Returns
        -------
        WindowJob or None
            A job if a window is full, or if a gap ends a window that is long enough.
        """
        job = None
        self._entropy.add(tick.current, min(tick.dt, GAP_S))
        if tick.dt > GAP_S or self.now.steps_otherwise(tick.dt):
            job = self._close()
        taken = self.now.append(tick)
        if taken == "lost":
            return job or self._close()
        if taken == "waits":
            return job
        length = self.now.length_s
        if length >= self._settings.window_s - 1e-6:
            return self._close(full=True)
        if not self._windows and not self.now.looked and length >= self._settings.first_look_s - 1e-6:
            return self._look()
        return job

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Forget the readings of a cell (0-based) in the last seconds of the present window."""
        self.now.disbelieve(cell, seconds)

    def patience(self, dt: float) -> int:
        """Count the regular ticks that `take` may get before one must come by `add`; none of them ends a window."""
        if not self.now.inlet or self.now.steps_otherwise(dt):
            return 0
        known = self._settings
        ahead = known.window_s if self._windows or self.now.looked else min(known.first_look_s, known.window_s)
        return before_full(ahead, len(self.now), dt)

    def take(self, ticks: Ticks) -> None:
        """Include regular ticks, no more than `patience` allows; the same as adding them one by one."""
        self._entropy.take(ticks)
        self.now.extend(ticks)

    def finish(self) -> WindowJob | None:
        """End the present window, as a gap does."""
        return self._close()

    def cool_anew(self) -> None:
        """Discard the knowledge of R_u: another record follows, whose cells are cooled differently."""
        along = np.zeros((len(self._evidence.grad), 1))
        along[: len(self._names), 0] = lumped_jacobian(self._guess, self._model.has_conduction)[:, R_U]
        self._evidence = self._evidence.forget(along, np.array([FORGOTTEN]))

    @property
    def windows(self) -> int:
        """Number of results of whole windows that were used."""
        return self._windows

    def _look(self) -> WindowJob | None:
        """Fit the window so far; it continues."""
        self.now.looked = True
        job = self._close(look=True)
        if job is not None:
            self._out = "look"
        return job

    def _close(self, full: bool = False, look: bool = False) -> WindowJob | None:
        """End the window, or fit it early (`look`); a job if it is long and warm enough and no job is running."""
        now = self.now
        if not look:
            self.now = WindowNow()
        if not len(now) or now.length_s < self._settings.shortest_s or self._out:
            return None
        window, measured = now.window()
        R_e, R_u = np.exp(self._guess[[R_E, R_U]])
        if R_u * float(np.mean(window.square * R_e + np.abs(window.heat))) < self._settings.least_rise:
            return None
        self._from_voltage = measured > 0.5
        apart = self._entropy.ask(window.current, window.dt)
        evidence = self._evidence
        if self._windows:
            part = np.sqrt(now.length_s / WALK_S)
            p, V = len(self._names), len(CARRIED)
            level, slope = (p + APART_AT[: len(PRIOR_SD)]).tolist()
            evidence = evidence.at_charge(apart, (level, slope))
            steps = np.full(2 + V, CARRIED_DRIFT) * part
            steps[:2] = max(self._walk, 0.01) * part, self._settings.cooling_drift * part
            along = np.zeros((len(evidence.grad), 2 + V))
            along[:p, :2] = lumped_jacobian(self._guess, self._model.has_conduction)[:, [R_E, R_U]]
            along[p : p + V, 2:] = np.eye(V)
            evidence = evidence.forget(along, steps)
        self._out = "window"
        if full:  # the next window begins at the last instant of this one
            self.now = WindowNow(inlet=[float(window.inlet[-1])], joined=True)
        start = self._end if now.joined else None
        known = self._settings
        # a model that was wrong in the last window is not right because it fits this one
        least_doubt = float(np.sqrt(self._told.doubt))
        return WindowJob(
            self._model, window, evidence, self._guess, start, known.root, known.model_sd, known.carried, least_doubt
        )

    def accept(self, result: Fit) -> None:
        """Use the result of the last job."""
        p = len(self._names)
        looked, self._out = self._out == "look", ""
        mean, cov = self._as_shown(result.mean, result.cov)
        self._entropy.answer(*self._as_shown(*result.apart), result.warmth[0], looked=looked)
        self._told = _Told(mean[:p], cov[:p, :p], float(mean[p]), cov[p], result.doubt, result.constant)
        if looked:
            return
        self._evidence = result.evidence
        self._other_root, self._walk = result.other_root, result.walk
        self._guess = result.mode
        self._end = result.end
        self._windows += 1

    def _as_shown(self, mean: Floats, cov: Floats) -> tuple[Floats, Floats]:
        """Reduce what a fit says of a cell of unknown size; see `unsized`."""
        if not self._shown > 0.0:
            return mean, cov
        beside = (HEAT_GAIN_SD, *APART_SD)[: len(mean) - len(self._names)]
        known, known_sd = np.append(self._prior_mean, np.zeros(len(beside))), np.append(self._prior_sd, beside)
        return as_shown(mean, cov, known, known_sd, R_C, self._shown)

    def posterior(self) -> Posterior:
        """Gaussian over the logarithms; the prior until the first result."""
        told, heat = self._told, None
        if self._from_voltage and told.gain_cov[-1] > 0.0:
            heat = HeatGain(float(np.exp(told.gain)), told.gain_cov)
        apart = self._entropy.numbers(self._names, gain=heat is not None)
        return Posterior(self._names, told.mean, told.cov, heat, apart, told.constant)

    def estimates(self) -> tuple[Estimate, ...]:
        """Every parameter with sd and status."""
        status = [self._status(i) for i in range(len(self._names))]
        return estimates_of(self.posterior(), status)

    def _status(self, i: int) -> str:
        name, sd, prior = self._names[i], float(np.sqrt(self._told.cov[i, i])), float(self._prior_sd[i])
        if prior == 0.0:
            return "fixed"
        if not self._windows:
            return LEARNING
        mean = self._told.mean[i]
        if min(mean - np.log(KINDS[name].lower), np.log(KINDS[name].upper) - mean) < 0.01:
            return not_identifiable("at its bound")
        if sd < 0.5 * prior and sd < self._settings.good_sd:
            return IDENTIFIED
        return not_identifiable(self._why(i, sd))

    def _why(self, i: int, sd: float) -> str:
        if i == R_E and self._from_voltage:
            return "heat is taken from voltage"
        along = np.zeros(len(self._names))
        along[[R_E, R_U]] = 1.0
        rise_sd = float(np.sqrt(along @ self._told.cov @ along))
        if rise_sd > 0.3 and not self._from_voltage:
            return "too little current"
        g = fold_gradient(self._told.mean)
        if self._other_root > 0.02 or abs(fold_distance(self._told.mean)) < 2.0 * float(
            np.sqrt(g @ self._told.cov @ g)
        ):
            return "near the fold R_u = R_u*"
        if i in (R_E, R_U) and rise_sd < 0.5 * sd:
            return "only R_e*R_u is determined"
        return "the data add little to the prior"

    def doubts(self) -> tuple[str, ...]:
        """Say that parameters near their prior explain the newest window only with a far larger noise."""
        if self._told.doubt <= DOUBTED:
            return ()
        return (
            "the surfaces of the last drives do not fit parameters near those of the model file (they would fit if the "
            f"model's error were {self._told.doubt:.0f} times as large as the residuals): an effect is missing, or a "
            "number of the file is wrong",
        )

    def snapshot(self) -> dict[str, Any]:
        """State as JSON-able values, without the present window."""
        e, told = self._evidence, self._told
        arrays = {
            "z0": e.z0,
            "info": e.info,
            "grad": e.grad,
            "mean": told.mean,
            "cov": told.cov,
            "guess": self._guess,
        }
        return {
            "method": "window",
            "names": [*self._names, *CARRIED],
            **{k: v.tolist() for k, v in arrays.items()},
            "other_root": self._other_root,
            "walk": self._walk,
            "warmth": e.warmth,
            "windows": self._windows,
            "from_voltage": self._from_voltage,
            "gain": told.gain,
            "gain_cov": told.gain_cov.tolist(),
            "doubt": told.doubt,
            "constant": told.constant.tolist(),
            "entropy": self._entropy.snapshot(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a snapshot of a string with the same parameters.

        Raises
        ------
        StateError
            The snapshot belongs to another method or structure, or is not finite.
        """
        names, p = [*self._names, *CARRIED], len(self._names)
        older = state.get("names") == names[:-1]
        if state.get("method") != "window" or not (older or state.get("names") == names):
            raise StateError("identified parameters: the stored state is of another method or string; starting anew")
        if older:
            state = _with_warmth(state, p + len(CARRIED) - 1)
        c = p + len(CARRIED) + departures(self._model)
        shapes = {"z0": (p,), "mean": (p,), "guess": (p,), "grad": (c,), "info": (c, c), "cov": (p, p)}
        shapes["gain_cov"] = (p + 1,)
        state = {"constant": [0.0] * self._model.cells, **state}  # of a version that did not seek it
        shapes["constant"] = (self._model.cells,)
        vectors, warmth = {k: np.array(state[k], dtype=np.float64) for k in shapes}, float(state.get("warmth", 0.0))
        if any(v.shape != shapes[k] or not np.isfinite(v).all() for k, v in vectors.items()) or not np.isfinite(warmth):
            raise StateError("identified parameters: the stored state is damaged; starting anew")
        try:
            self._entropy = self._entropy.restored(state.get("entropy"), p + 1 + len(APART_SD))
        except (KeyError, TypeError, ValueError) as e:
            raise StateError("identified parameters: the stored state is damaged; starting anew") from e
        self._evidence = Evidence(vectors["z0"], vectors["info"], vectors["grad"], warmth)
        self._guess = vectors["guess"]
        if older:  # at which temperature it knew R_e is not told
            along = np.zeros((c, 1))
            along[:p, 0] = lumped_jacobian(self._guess, self._model.has_conduction)[:, R_E]
            self._evidence = self._evidence.forget(along, np.array([OTHER_WARMTH]))
        self._told = _Told(
            vectors["mean"],
            vectors["cov"],
            float(state["gain"]),
            vectors["gain_cov"],
            float(state["doubt"]),
            vectors["constant"],
        )
        self._other_root, self._walk = float(state["other_root"]), float(state["walk"])
        self._windows, self._from_voltage = int(state["windows"]), bool(state["from_voltage"])
        self._out = ""
        self.now = WindowNow()


def _with_warmth(state: Mapping[str, Any], at: int) -> dict[str, Any]:
    """Complete the state of a version whose windows held R_e to be the same at all temperatures, by no evidence.

    `at` is the place of the warmth in the evidence. What the observer is told beside the parameters follows with the
    next window.
    """
    info, grad = np.array(state["info"], np.float64), np.array(state["grad"], np.float64)
    info = np.insert(np.insert(info, at, 0.0, axis=0), at, 0.0, axis=1)
    entropy = {"at": state["entropy"]["at"]} if state.get("entropy") else None
    return {**state, "info": info.tolist(), "grad": np.insert(grad, at, 0.0).tolist(), "entropy": entropy}


def _since(model: StringModel) -> dict[str, Prior]:
    """Priors for today: the fit in the model file, widened by possible changes since."""
    priors = dict(model.priors)
    if model.before is not None:
        for name, more in (("R_e", GROWN), ("R_u", CLOGGED)):
            p = priors[name]
            priors[name] = p if p.fixed else replace(p, rel_sd=max(p.rel_sd, more))
    return priors
