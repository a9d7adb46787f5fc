r"""Maximum a posteriori output-error fit of a string with any effects, and its Laplace evidence.

The minimised cost over coordinates θ and nuisances ν is

.. math::
    \sum_i D_i\bigl(y_i - f_i(\theta, \nu)\bigr) + \sum ((\theta-\mu)/s)^2 + \sum (\nu/s_\nu)^2

with D the deviance of rounded readings (`likelihood`), f the free-running trajectory, by Gauss–Newton steps with
Levenberg's damping and an active set at the bounds. The log evidence is the Laplace approximation
−½(cost + ln|H| + 2 Σ ln s): the Occam factor of an added number is its prior's width over its posterior's.

In place of the least squares of Lin et al., Eq 3-10, where a model has effects that Eq 1 lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from bms_gateway.identify.coordinates import LIMIT
from bms_gateway.identify.descent import Pace, Patience, descend
from bms_gateway.identify.likelihood import curvature, generalised
from bms_gateway.identify.problem import Prediction, Problem
from bms_gateway.identify.quadratic import Quadratic, solved
from bms_gateway.thermal import Floats

ITERATIONS = 12
ANNEALING = (1e-3, 3e-2)
"""Weights of the data on the way to 1: at first only errors of thirty times the noise count."""
PACE = Pace(1e-8, 1e-8, 30.0, 0.1, 6)
"""The numbers of a string lie in a valley ten thousand times flatter along its axis than across it; Marquardt's usual
1e-3 would make the steps too small."""
REFRESHES = 8
SETTLED = 0.2
"""Cost: smaller gains need no new nuisance columns; evidence is read to a few tenths."""
MISFIT = 2e-3
"""Share of the cost above its expectation: a model with large errors need not converge to the last digit."""
VANISHING = 0.8
"""Largest share of an effect that one step may remove: once it is zero, its other numbers cannot restore it."""
RUNS_AWAY = 1e24
"""Greatest precision of a number as a multiple of its prior's: readings cannot determine a number to 1e-12 of its
prior's sd. Larger values come from diverging derivatives, as those of a negative conductance to the surroundings."""
GAIN = 0.05
"""Cost: a step that gains less ends the fit; a twentieth of the gain of one standard deviation of a number."""


class Whitening(Protocol):
    """Noise with a memory: makes residuals independent with unit variance; held-out readings become zero."""

    log_det: float
    """Logarithm of the determinant of the noise's covariance, K²."""

    def __call__(self, x: Floats) -> Floats:
        """Whiten residuals (M,) or columns (M, P), K."""
        ...


@dataclass(frozen=True, slots=True)
class Linear:
    """The nuisances' columns, computed once for many steps: y moves by `J` ν, each with a prior of sd `sd`.

    Attributes
    ----------
    J : ndarray (M', Q), K per unit
        At the records' places.
    sd : ndarray (Q,)
    gram : ndarray (Q, Q)
        Products of `J` in units of the noise, without held-out readings: computed once, because many fits share them.
    weight : ndarray (M',)
        From `weights`, if the noise is white.
    whitened : ndarray (M, Q) or None
        `J` in units of a noise with a memory.
    """

    J: Floats
    sd: Floats
    gram: Floats
    weight: Floats
    whitened: Floats | None = None

    @classmethod
    def of(cls, problem: Problem, J: Floats, sd: Floats, noise: Whitening | None = None) -> "Linear":
        """Build it with its products."""
        weight, whitened = weights(problem), None if noise is None else weighed(problem, noise, J)
        x = J * weight[:, None] if whitened is None else whitened
        return cls(J, sd, x.T @ x, weight, whitened)

    def products(self, rows: Floats) -> Floats:
        """Products (…, Q) of rows (…, M'), in units of the noise, with `J` in the same units."""
        return np.asarray((rows * self.weight) @ self.J if self.whitened is None else rows @ self.whitened)


@dataclass(frozen=True, slots=True)
class MapFit:
    """Result of a fit.

    Attributes
    ----------
    problem : Problem
    theta, nu : ndarray (P,), (Q,)
    linear : Linear
    J : ndarray (M', P), K per unit
        At the optimum and the records' places.
    H : ndarray (P + Q, P + Q)
        Precision of [θ, ν]: half the cost's Hessian.
    prediction : Prediction
    r : ndarray (M,)
        Generalised residuals (sd 1 when the model is right), at all readings, held-out ones too.
    cost, log_evidence : float
    noise : Whitening or None
        Replaces the white noise of rounded readings; `r` is then whitened by it.
    steep : float
        From `curvature`.
    tempered : bool
        Whether H already allows for a residual that is not white.
    """

    problem: Problem
    theta: Floats
    nu: Floats
    linear: Linear
    J: Floats
    H: Floats
    prediction: Prediction
    r: Floats
    cost: float
    log_evidence: float
    noise: Whitening | None = None
    steep: float = 1.0
    tempered: bool = False

    @property
    def covariance(self) -> Floats:
        """Covariance (P, P) of the coordinates, nuisances marginalised."""
        P = len(self.theta)
        return solved(self.H, np.eye(len(self.H))[:, :P])[:P]

    @property
    def y(self) -> Floats:
        """Model values (M,), °C, at all readings."""
        return self.prediction.y

    @property
    def readings(self) -> int:
        """Number of fitted readings: the expected cost of a right model."""
        return sum(int(np.count_nonzero(m.used)) for m in self.problem.records)

    def weighed(self, columns: Floats) -> Floats:
        """Columns (M', P) in units of the noise, zero where a reading is held out."""
        return weighed(self.problem, self.noise, columns)

    def gathered(self, r: Floats) -> Floats:
        """Residuals (M,) in the form that weighed columns have, zero where a reading is held out."""
        return gathered(self.problem, self.noise, r)

    def products(self, columns: Floats) -> Floats:
        """Products (P + Q, p) of the weighed columns of the fit with other weighed columns (M', p)."""
        return np.concatenate([self.weighed(self.J).T @ columns, self.linear.products(columns.T).T])

    @property
    def light(self) -> "MapFit":
        """The same fit without its columns (a hundred megabytes for a long string), to be stored but not continued.

        Numbers, precision, prediction and residual are kept.
        """
        self.problem.forget()
        linear = replace(self.linear, J=self.linear.J[:0].copy(), weight=self.linear.weight[:0].copy(), whitened=None)
        return replace(self, J=self.J[:0].copy(), linear=linear)

    @property
    def free(self) -> np.ndarray:
        """Which of [θ, ν] (P + Q,) are inside their bounds and could move in both directions."""
        cs = self.problem.coordinates
        lower = np.concatenate([[c.lower for c in cs], -LIMIT * self.linear.sd])
        upper = np.concatenate([[c.upper for c in cs], LIMIT * self.linear.sd])
        z, margin = np.concatenate([self.theta, self.nu]), 1e-6 * (upper - lower)
        return np.asarray((z > lower + margin) & (z < upper - margin))

    def at_bound(self, name: str) -> bool:
        """Whether a coordinate ended at its bound."""
        c = self.problem.coordinates[self.problem.index(name)]
        z, width = self.theta[self.problem.index(name)], 1e-3 * (c.upper - c.lower)
        return bool(z <= c.lower + width or z >= c.upper - width)


def stacked(problem: Problem) -> tuple[Floats, Floats, Floats, Floats, np.ndarray]:
    """Stack readings, σ, σ₀, step (M,) of all records, and which are used."""
    ms = problem.records
    return (
        np.concatenate([m.y for m in ms]),
        np.concatenate([m.sigma for m in ms]),
        np.concatenate([m.sigma0[m.channel] for m in ms]),
        np.concatenate([m.step[m.channel] for m in ms]),
        np.concatenate([m.used for m in ms]),
    )


def nuisance_columns(
    problem: Problem,
    theta: Floats,
    prediction: Prediction,
    noise: Whitening | None = None,
    nu: Floats | None = None,
) -> Linear:
    """Columns of the problem's nuisances about `theta` and `nu`.

    Without effects and in a steady stream the balances are linear, and the plain recursion is enough. Otherwise,
    columns with an error of a few per cent stop a fit early, and its residual looks like one more effect.
    """
    sd = np.array([c.sd for c in problem.nuisances])
    refinements = 1 if problem.model.effects or any(np.ptp(m.drive.flow) > 0.0 for m in problem.records) else 0
    J = problem.columns(theta, prediction, problem.nuisances, refinements, nu)
    return Linear.of(problem, J, sd, noise)


def weights(problem: Problem) -> Floats:
    """Weights (M',) of means at the places against white noise, 1/K; zero where held out."""
    return np.concatenate([np.where(p.at.used, np.sqrt(p.count) / p.at.sigma, 0.0) for p in problem.places])


def weighed(problem: Problem, noise: Whitening | None, columns: Floats) -> Floats:
    """Columns at the places in units of the noise, zero if held out; at all readings if the noise has a memory."""
    if noise is not None:
        return noise(problem.spread(columns))
    return np.asarray(columns * weights(problem)[:, None])


def gathered(problem: Problem, noise: Whitening | None, r: Floats) -> Floats:
    """Residuals (M,) in units of the noise, in the form that `weighed` columns have."""
    return r if noise is not None else problem.gathered(r)


@dataclass(frozen=True, slots=True)
class FitStart:
    """Where a fit starts.

    Attributes
    ----------
    theta : ndarray (P,)
    nu : ndarray (Q,), optional
        Nuisances; 0 by default.
    guess : sequence of ndarray, optional
        Trajectories near the start's, one per record.
    J : ndarray (M', P'), optional
        Columns of the first P' coordinates near the start: the first iteration then need not compute them.
    """

    theta: Floats
    nu: Floats | None = None
    guess: Sequence[Floats] | None = None
    J: Floats | None = None


@dataclass(frozen=True, slots=True)
class FitEffort:
    """When a fit stops.

    Attributes
    ----------
    iterations : int
    give_up : float
        Stop as soon as the cost is unlikely to fall below this: the fit then serves only for ranking.
    outclassed : float
        Stop if the promise of the second or a later step leaves the cost above this.
    least_gain : float
        Cost: a step that gains less ends the fit. In a long flat valley the core still moves by a kelvin at GAIN.
    refinements : int
        Number of refinements of the sensitivities: more if the balances are far from linear.
    trust : float
        Weight of the data: below 1 the priors are stronger, and a distant start follows the curved valley.
    """

    iterations: int = ITERATIONS
    give_up: float = np.inf
    outclassed: float = np.inf
    least_gain: float = GAIN
    refinements: int = 1
    trust: float = 1.0


TO_THE_END = FitEffort()


@dataclass(frozen=True, slots=True)
class _Place:
    """Numbers [θ, ν], their prediction, and the residual."""

    z: Floats
    deviance: float
    prediction: Prediction
    r: Floats


class _Records:
    """The deviance of all records as a function of [θ, ν]."""

    def __init__(self, problem: Problem, linear: Linear | None, noise: Whitening | None, effort: FitEffort) -> None:
        self.problem, self.noise, self.effort = problem, noise, effort
        self.y, _, self.sigma0, self.step, self.used = stacked(problem)
        none = np.zeros((sum(len(p.first) for p in problem.places), 0))
        self.linear = linear or Linear.of(problem, none, np.zeros(0), noise)
        lower, upper, prior, sd = (
            np.array([getattr(c, k) for c in problem.coordinates]) for k in ("lower", "upper", "prior", "sd")
        )
        small = self.linear.sd
        self.lower, self.upper = np.concatenate([lower, -LIMIT * small]), np.concatenate([upper, LIMIT * small])
        self.prior, self.sd = np.concatenate([prior, np.zeros(len(small))]), np.concatenate([sd, small])
        self.columns, self.steep = none, 1.0
        self.known: Floats | None = None
        """Columns that need not be computed at the first iteration."""
        self._own, self._H = none, np.eye(len(self.sd))

    def at(self, z: Floats, near: "_Place | Sequence[Floats] | None") -> _Place:
        """Simulate the records from a trajectory nearby."""
        P, trust = len(self.problem.coordinates), self.effort.trust
        p = self.problem.predict(z[:P], near.prediction.X if isinstance(near, _Place) else near, z[P:])
        strain = float(np.sum(((z - self.prior) / self.sd) ** 2))
        if self.noise is not None:
            r = self.noise(self.y - p.y)
            return _Place(z, trust * (float(r @ r) + self.noise.log_det) + strain, p, r)
        r, deviance = generalised(self.y - p.y, self.sigma0, self.step)
        return _Place(z, trust * float(np.sum(deviance[self.used])) + strain, p, r)

    def slopes(self, here: _Place, fresh: bool) -> Quadratic | None:
        """Compute the columns of θ anew if `fresh`; None if they are not finite."""
        with np.errstate(over="ignore", invalid="ignore"):  # diverging columns are detected and reported below
            pull = gathered(self.problem, self.noise, np.where(self.used, self.effort.trust * here.r, 0.0))
            slope = self._look(here, pull) if fresh else self._as_before(pull)
            gradient = slope - (here.z - self.prior) / self.sd**2
        told = np.isfinite(gradient).all() and (np.diag(self._H) * self.sd**2 < RUNS_AWAY).all()
        return Quadratic(self._H, gradient) if told else None

    def _as_before(self, pull: Floats) -> Floats:
        """Return the gradient of the residuals by the columns of the last iteration."""
        return np.concatenate([pull @ self._own, self.linear.products(pull)])

    def _look(self, here: _Place, pull: Floats) -> Floats:
        """Compute columns and precision; return the gradient of the residuals."""
        known, self.known = self.known, None
        P = len(self.problem.coordinates)
        new = self.problem.coordinates if known is None else self.problem.coordinates[known.shape[1] :]
        columns = self.problem.columns(here.z[:P], here.prediction, new, self.effort.refinements, here.z[P:])
        self.columns = columns if known is None else np.concatenate([known, columns], axis=1)
        if self.noise is None:
            used = self.used
            self.steep = curvature((self.y - here.prediction.y)[used], self.sigma0[used], self.step[used])
        self._own = weighed(self.problem, self.noise, self.columns)
        self._H, slope = _normal(self._own, self.linear, self.sd, self.effort.trust * self.steep, pull)
        return slope

    def stiffness(self, H: Floats) -> Floats:
        """Return the diagonal itself (Z,), after Marquardt."""
        return np.diag(H)

    def share(self, z: Floats, step: Floats) -> float:
        """Share of a step that leaves every number where its linear response is still valid."""
        share = 1.0
        for c, at, move in zip(self.problem.coordinates, z, step, strict=False):
            reach = min(c.reach, VANISHING * (at - c.lower)) if c.vanishing and move < 0.0 else c.reach
            if abs(move) > reach > 0.0:
                share = min(share, reach / abs(move))
        return share


def map_fit(
    problem: Problem,
    start: FitStart,
    effort: FitEffort = TO_THE_END,
    *,
    linear: Linear | None = None,
    noise: Whitening | None = None,
) -> MapFit:
    """Fit a problem from a start.

    Parameters
    ----------
    problem : Problem
    start : FitStart
    effort : FitEffort
    linear : Linear, optional
        The nuisances' columns: small, so they are not computed anew in each step. Without them, no nuisance is fitted.
    noise : Whitening, optional
        Replaces the records' own noise.
    """
    valley = _Records(problem, linear, noise, effort)
    z = np.concatenate([start.theta, np.zeros(len(valley.linear.sd)) if start.nu is None else start.nu])
    here = valley.at(np.clip(z, valley.lower, valley.upper), start.guess)
    valley.known = start.J
    patience = Patience(effort.iterations, effort.least_gain, give_up=effort.give_up, outclassed=effort.outclassed)
    here, slopes = descend(valley, here, PACE, patience)
    P, sd = len(problem.coordinates), valley.sd
    theta, nu = here.z[:P], here.z[P:]
    # diverging derivatives give no direction and no number: the fit is invalid
    H, cost = (np.diag(sd**-2), np.inf) if slopes is None else (slopes.H, here.deviance)
    log_evidence = -0.5 * cost - 0.5 * float(np.linalg.slogdet(H)[1]) - float(np.sum(np.log(sd)))
    return MapFit(
        problem, theta, nu, valley.linear, valley.columns, H, here.prediction, here.r, cost, log_evidence, noise,
        valley.steep,
    )  # fmt: skip


def refreshed(fit: MapFit, iterations: int = 6) -> MapFit:
    """Continue a fit with the nuisances' columns and the recursions' reference renewed at the optimum."""
    fit.problem.renew(fit.prediction, fit.theta, fit.nu)
    prediction = fit.problem.predict(fit.theta, fit.prediction.X, fit.nu)
    linear = nuisance_columns(fit.problem, fit.theta, prediction, fit.noise, fit.nu)
    start = FitStart(fit.theta, fit.nu, prediction.X)
    return map_fit(fit.problem, start, FitEffort(iterations), linear=linear, noise=fit.noise)


def converged(fit: MapFit) -> MapFit:
    """Continue a fit until neither its numbers nor the nuisances' columns move."""
    for _ in range(REFRESHES):
        before = fit.cost
        fit = refreshed(fit, iterations=3)
        if abs(before - fit.cost) < max(SETTLED, MISFIT * (fit.cost - fit.readings)):
            break
    return fit


def fitted(problem: Problem) -> MapFit:
    """Fit a problem from the start of its coordinates, with increasing weight of the data."""
    return converged(annealed(problem, problem.begin))


def annealed(problem: Problem, theta: Floats) -> MapFit:
    """Bring a distant start into the valley: a rough fit with increasing weight of the data."""
    nu, guess, linear = None, None, None
    fit: MapFit | None = None
    for trust in ANNEALING:
        prediction = problem.predict(theta, guess, nu)
        problem.renew(prediction, theta, nu)
        if fit is not None:  # at first the errors are far greater than tolerances can explain
            nu = np.zeros(len(problem.nuisances))
            linear = nuisance_columns(problem, theta, prediction, nu=nu)
        effort = FitEffort(iterations=4, trust=trust, least_gain=1.0)
        fit = map_fit(problem, FitStart(theta, nu, prediction.X), effort, linear=linear)
        theta, nu, guess = fit.theta, fit.nu, fit.prediction.X
    assert fit is not None  # noqa: S101 - there are steps of annealing
    return fit


def _normal(J: Floats, linear: Linear, sd: Floats, trust: float, pull: Floats) -> tuple[Floats, Floats]:
    """Precision and gradient of the residuals; the nuisances' columns are many and used only once."""
    P = J.shape[1]
    mine = np.empty((P + 1, len(J)))
    mine[:P], mine[P] = J.T, pull
    own, cross = mine @ mine[:P].T, linear.products(mine)
    H = trust * np.block([[own[:P], cross[:P]], [cross[:P].T, linear.gram]])
    H[np.diag_indices_from(H)] += 1.0 / sd**2
    return np.asarray(H, dtype=np.float64), np.concatenate([own[P], cross[P]])
