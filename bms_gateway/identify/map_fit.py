r"""Maximum a posteriori output-error fit of a string with any effects, and its Laplace evidence.

Minimised over coordinates θ and nuisances ν is

.. math::
    \sum_i D_i\bigl(y_i - f_i(\theta, \nu)\bigr) + \sum ((\theta-\mu)/s)^2 + \sum (\nu/s_\nu)^2

with D the deviance of rounded readings (`likelihood`), f the free-running trajectory, by Gauss–Newton steps with
Levenberg's damping and an active set at the bounds. The log evidence is the Laplace approximation
−½(cost + ln|H| + 2 Σ ln s): the Occam factor of an added number is its prior's width over its posterior's.

In place of the least squares of Lin et al., Eq 3-10, where a model has effects that Eq 1 lacks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy.linalg

from bms_gateway.identify.coordinates import LIMIT
from bms_gateway.identify.likelihood import curvature, generalised
from bms_gateway.identify.problem import Prediction, Problem
from bms_gateway.thermal import Floats

ITERATIONS = 12
ANNEALING = (1e-3, 3e-2)
"""Weights of the data on the way to 1: at first only what is off by thirty times the noise counts."""
DAMPING, TRIES = 1e-8, 6
"""Share of the Hessian's diagonal: the numbers of a string lie in a valley ten thousand times flatter along than
across, where Marquardt's usual 1e-3 would creep. Grows by 30 until the cost falls."""
REFRESHES = 8
SETTLED = 0.2
"""Cost: less is not worth another look at the nuisances' columns; evidence is read to a few tenths."""
MISFIT = 2e-3
"""Share of what the cost has above its expectation: a model that misses much need not be settled to the last digit."""
VANISHING = 0.8
"""Share of its size by which a step may take an effect away: gone, its other numbers could not bring it back."""
ROUNDING = 1e-12
"""Of a precision scaled to a unit diagonal: combinations known worse than this are lost in rounding."""
RUNS_AWAY = 1e24
"""Precision of a number as a multiple of its prior's: readings cannot tell a number to 1e-12 of its prior's sd. More
comes of derivatives that grow without limit, as those of a negative conductance to the surroundings do."""
FORETOLD = 0.8
"""Share of the gain that a step's columns promised from which they are used once more."""
GAIN = 0.05
"""Cost: a step that gains less ends the fit; a twentieth of what one standard deviation of a number is worth."""


class Whitening(Protocol):
    """Noise with a memory: what makes residuals independent and of unit variance, held-out readings zero."""

    log_det: float
    """Logarithm of the determinant of the noise's covariance, K²."""

    def __call__(self, x: Floats) -> Floats:
        """Whiten residuals (M,) or columns (M, P), K."""
        ...


@dataclass(frozen=True, slots=True)
class Linear:
    """The nuisances' columns, taken once for many steps: y moves by `J` ν, a prior of sd `sd` each.

    Attributes
    ----------
    J : ndarray (M', Q), K per unit
        At the records' places.
    sd : ndarray (Q,)
    gram : ndarray (Q, Q)
        Products of `J` in units of the noise, without held-out readings: taken once, for many fits share them.
    weight : ndarray (M',)
        As `weights` gives them, where the noise is white.
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
        """Products (…, Q) of rows (…, M'), which are in units of the noise, with `J` in these units."""
        return np.asarray((rows * self.weight) @ self.J if self.whitened is None else rows @ self.whitened)


@dataclass(frozen=True, slots=True)
class MapFit:
    """A fit.

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
        In place of the white noise of rounded readings; `r` is then what it leaves.
    steep : float
        As `curvature` gives it.
    tempered : bool
        Whether H allows for what is not white in the residual already.
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
        """What the model reads (M,), °C, at all readings."""
        return self.prediction.y

    @property
    def readings(self) -> int:
        """How many readings were fitted to: what a model that is right costs, give or take its chance."""
        return sum(int(np.count_nonzero(m.used)) for m in self.problem.records)

    def weighed(self, columns: Floats) -> Floats:
        """Columns (M', P) in units of the noise, zero where a reading is held out."""
        return weighed(self.problem, self.noise, columns)

    def gathered(self, r: Floats) -> Floats:
        """Residuals (M,) as weighed columns see them, zero where a reading is held out."""
        return gathered(self.problem, self.noise, r)

    def products(self, columns: Floats) -> Floats:
        """Products (P + Q, p) of the fit's own weighed columns with other weighed ones (M', p)."""
        return np.concatenate([self.weighed(self.J).T @ columns, self.linear.products(columns.T).T])

    @property
    def light(self) -> "MapFit":
        """The same fit without its columns, a hundred megabytes for a long string: to be kept, not to be fitted on.

        Numbers, precision, prediction and residual stay.
        """
        self.problem.forget()
        linear = replace(self.linear, J=self.linear.J[:0].copy(), weight=self.linear.weight[:0].copy(), whitened=None)
        return replace(self, J=self.J[:0].copy(), linear=linear)

    @property
    def free(self) -> np.ndarray:
        """Which of [θ, ν] (P + Q,) stand inside their bounds and could move either way."""
        cs = self.problem.coordinates
        lower = np.concatenate([[c.lower for c in cs], -LIMIT * self.linear.sd])
        upper = np.concatenate([[c.upper for c in cs], LIMIT * self.linear.sd])
        z, margin = np.concatenate([self.theta, self.nu]), 1e-6 * (upper - lower)
        return np.asarray((z > lower + margin) & (z < upper - margin))

    def at_bound(self, name: str) -> bool:
        """Whether a coordinate ended on its bound."""
        c = self.problem.coordinates[self.problem.index(name)]
        z, width = self.theta[self.problem.index(name)], 1e-3 * (c.upper - c.lower)
        return bool(z <= c.lower + width or z >= c.upper - width)


def solved(H: Floats, b: Floats) -> Floats:
    """Solve H x = b for a precision whose numbers may be so unlike that rounding takes its last digits."""
    scale = 1.0 / np.sqrt(np.diag(H))
    unit = H * np.outer(scale, scale)
    unit[np.diag_indices_from(unit)] += ROUNDING
    x = scipy.linalg.cho_solve(scipy.linalg.cho_factor(unit), scale[:, None] * b)
    return np.asarray(scale[:, None] * x, dtype=np.float64)


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

    Without effects and in a steady stream the balances are linear and the plain recursion will do; else columns a
    few per cent off hold a fit fast where it stands, and what it leaves looks like one more effect.
    """
    sd = np.array([c.sd for c in problem.nuisances])
    refinements = 1 if problem.model.effects or any(np.ptp(m.drive.flow) > 0.0 for m in problem.records) else 0
    J = problem.columns(theta, prediction, problem.nuisances, refinements, nu)
    return Linear.of(problem, J, sd, noise)


def weights(problem: Problem) -> Floats:
    """Weights (M',) of means at the places against white noise, 1/K; zero where held out."""
    return np.concatenate([np.where(p.at.used, np.sqrt(p.count) / p.at.sigma, 0.0) for p in problem.places])


def weighed(problem: Problem, noise: Whitening | None, columns: Floats) -> Floats:
    """Columns at the places in units of the noise, zero where held out; at all readings if it has a memory."""
    if noise is not None:
        return noise(problem.spread(columns))
    return np.asarray(columns * weights(problem)[:, None])


def gathered(problem: Problem, noise: Whitening | None, r: Floats) -> Floats:
    """Residuals (M,) in units of the noise, as `weighed` columns see them."""
    return r if noise is not None else problem.gathered(r)


@dataclass(frozen=True, slots=True)
class FitStart:
    """Where a fit starts.

    Attributes
    ----------
    theta : ndarray (P,)
    nu : ndarray (Q,), optional
        Nuisances; 0 without.
    guess : sequence of ndarray, optional
        Trajectories near the start's, one per record.
    J : ndarray (M', P'), optional
        Columns of the first P' coordinates near the start: spares taking them in the first iteration.
    """

    theta: Floats
    nu: Floats | None = None
    guess: Sequence[Floats] | None = None
    J: Floats | None = None


@dataclass(frozen=True, slots=True)
class FitEffort:
    """How far a fit is taken.

    Attributes
    ----------
    iterations : int
    give_up : float
        Stop as soon as the cost is unlikely to fall below: the fit is then only good for ranking.
    outclassed : float
        Stop where even what the second step, or a later one, promises would leave the cost above this.
    least_gain : float
        Cost: a step that gains less ends the fit. In a long flat valley the core still moves by a kelvin for GAIN.
    refinements : int
        Of the sensitivities: more where the balances are far from linear.
    trust : float
        Weight of the data: below 1 the priors hold on, and a start far off is led in along the curved valley.
    """

    iterations: int = ITERATIONS
    give_up: float = np.inf
    outclassed: float = np.inf
    least_gain: float = GAIN
    refinements: int = 1
    trust: float = 1.0


TO_THE_END = FitEffort()


def map_fit(
    problem: Problem,
    start: FitStart,
    effort: FitEffort = TO_THE_END,
    *,
    linear: Linear | None = None,
    noise: Whitening | None = None,
) -> MapFit:
    """Fit.

    Parameters
    ----------
    problem : Problem
    start : FitStart
    effort : FitEffort
    linear : Linear, optional
        The nuisances' columns: being small they need not be taken anew in each step. None are fitted without.
    noise : Whitening, optional
        Takes the place of the records' own noise.
    """
    y, _, sigma0, step, used = stacked(problem)
    none = np.zeros((sum(len(p.first) for p in problem.places), 0))
    linear = linear or Linear.of(problem, none, np.zeros(0), noise)
    lower, upper, prior, sd = (
        np.array([getattr(c, k) for c in problem.coordinates]) for k in ("lower", "upper", "prior", "sd")
    )
    lower, upper = np.concatenate([lower, -LIMIT * linear.sd]), np.concatenate([upper, LIMIT * linear.sd])
    prior, sd = np.concatenate([prior, np.zeros(len(linear.sd))]), np.concatenate([sd, linear.sd])
    P, trust = len(problem.coordinates), effort.trust
    z = np.concatenate([start.theta, np.zeros(len(linear.sd)) if start.nu is None else start.nu])
    z = np.clip(z, lower, upper)

    def judge(z: Floats, p: Prediction) -> tuple[float, Floats]:
        strain = float(np.sum(((z - prior) / sd) ** 2))
        if noise is not None:
            r = noise(y - p.y)
            return trust * (float(r @ r) + noise.log_det) + strain, r
        r, deviance = generalised(y - p.y, sigma0, step)
        return trust * float(np.sum(deviance[used])) + strain, r

    prediction = problem.predict(z[:P], start.guess, z[P:])
    cost, r = judge(z, prediction)
    columns, own, H, slope = none, none, np.eye(len(z)), np.zeros(len(z))
    damping, steep, kept = DAMPING, 1.0, False
    for iteration in range(effort.iterations):
        with np.errstate(over="ignore", invalid="ignore"):  # of columns that ran away; seen and told below
            pull = gathered(problem, noise, np.where(used, trust * r, 0.0))
            if kept:
                slope = np.concatenate([pull @ own, linear.products(pull)])
            else:
                columns = _columns(problem, z, prediction, None if iteration else start.J, effort.refinements)
                steep = 1.0 if noise is not None else curvature((y - prediction.y)[used], sigma0[used], step[used])
                own = weighed(problem, noise, columns)
                H, slope = _normal(own, linear, sd, trust * steep, pull)
            gradient = slope - (z - prior) / sd**2
        if iteration and cost - _promise(H, gradient) > effort.outclassed:
            break
        before, promised = cost, 0.0
        if not np.isfinite(gradient).all() or not (np.diag(H) * sd**2 < RUNS_AWAY).all():
            cost, H = np.inf, np.diag(sd**-2)  # what runs away tells no direction and no number: the fit is none
            break
        for new, damped in _steps(problem, H, gradient, z, lower, upper, damping):
            trial = problem.predict(new[:P], prediction.X, new[P:])
            trial_cost, trial_r = judge(new, trial)
            if np.isfinite(trial_cost) and trial_cost < cost:
                promised = float((new - z) @ (2.0 * gradient - H @ (new - z)))
                z, prediction, cost, r = new, trial, trial_cost, trial_r
                damping = max(0.1 * damped, DAMPING)
                break
        gain = before - cost
        slow = cost > effort.give_up and max(gain, promised) < 0.3 * (cost - effort.give_up)
        settled = gain < effort.least_gain or (iteration > 0 and slow)
        if settled and not kept:
            break
        # columns that foretold the gain will do for another step, but not to end on
        kept = not settled and gain > FORETOLD * promised
    log_evidence = -0.5 * cost - 0.5 * float(np.linalg.slogdet(H)[1]) - float(np.sum(np.log(sd)))
    return MapFit(problem, z[:P], z[P:], linear, columns, H, prediction, r, cost, log_evidence, noise, steep)


def refreshed(fit: MapFit, iterations: int = 6) -> MapFit:
    """Fit on with the nuisances' columns and the recursions' reference taken anew at the optimum."""
    fit.problem.renew(fit.prediction, fit.theta, fit.nu)
    prediction = fit.problem.predict(fit.theta, fit.prediction.X, fit.nu)
    linear = nuisance_columns(fit.problem, fit.theta, prediction, fit.noise, fit.nu)
    start = FitStart(fit.theta, fit.nu, prediction.X)
    return map_fit(fit.problem, start, FitEffort(iterations), linear=linear, noise=fit.noise)


def converged(fit: MapFit) -> MapFit:
    """Fit on until neither numbers nor the nuisances' columns move any more."""
    for _ in range(REFRESHES):
        before = fit.cost
        fit = refreshed(fit, iterations=3)
        if abs(before - fit.cost) < max(SETTLED, MISFIT * (fit.cost - fit.readings)):
            break
    return fit


def fitted(problem: Problem) -> MapFit:
    """Fit a problem from where its coordinates begin, the data trusted more and more."""
    return converged(annealed(problem, problem.begin))


def annealed(problem: Problem, theta: Floats) -> MapFit:
    """Lead a start far off into the valley: a rough fit, the data trusted more and more."""
    nu, guess, linear = None, None, None
    fit: MapFit | None = None
    for trust in ANNEALING:
        prediction = problem.predict(theta, guess, nu)
        problem.renew(prediction, theta, nu)
        if fit is not None:  # at first what is off is far more than tolerances can make
            nu = np.zeros(len(problem.nuisances))
            linear = nuisance_columns(problem, theta, prediction, nu=nu)
        effort = FitEffort(iterations=4, trust=trust, least_gain=1.0)
        fit = map_fit(problem, FitStart(theta, nu, prediction.X), effort, linear=linear)
        theta, nu, guess = fit.theta, fit.nu, fit.prediction.X
    assert fit is not None  # noqa: S101 - there are steps of annealing
    return fit


def _columns(problem: Problem, z: Floats, prediction: Prediction, J: Floats | None, refinements: int) -> Floats:
    P = len(problem.coordinates)
    new = problem.coordinates if J is None else problem.coordinates[J.shape[1] :]
    columns = problem.columns(z[:P], prediction, new, refinements, z[P:])
    return columns if J is None else np.concatenate([J, columns], axis=1)


def _normal(J: Floats, linear: Linear, sd: Floats, trust: float, pull: Floats) -> tuple[Floats, Floats]:
    """Precision, and what the residuals pull; the nuisances' columns, being many, are gone through only once."""
    P = J.shape[1]
    mine = np.empty((P + 1, len(J)))
    mine[:P], mine[P] = J.T, pull
    own, cross = mine @ mine[:P].T, linear.products(mine)
    H = trust * np.block([[own[:P], cross[:P]], [cross[:P].T, linear.gram]])
    H[np.diag_indices_from(H)] += 1.0 / sd**2
    return np.asarray(H, dtype=np.float64), np.concatenate([own[P], cross[P]])


def _promise(H: Floats, gradient: Floats) -> float:
    """Cost that an undamped step would gain if all were linear; infinite where nothing can be foretold."""
    gain = float(gradient @ solved(H, gradient[:, None])[:, 0]) if np.isfinite(gradient).all() else np.inf
    return gain if np.isfinite(gain) else np.inf


def _steps(
    problem: Problem, H: Floats, gradient: Floats, z: Floats, lower: Floats, upper: Floats, damping: float
) -> Iterator[tuple[Floats, float]]:
    """Ever shorter steps, each with its damping."""
    for _ in range(TRIES):
        step = _step(H, gradient, z, lower, upper, damping)
        yield np.clip(z + step * _within_reach(problem, z, step), lower, upper), damping
        damping *= 30.0


def _within_reach(problem: Problem, z: Floats, step: Floats) -> float:
    """Share of a step that leaves every number where its linear response still means something."""
    share = 1.0
    for c, at, move in zip(problem.coordinates, z, step, strict=False):
        reach = min(c.reach, VANISHING * (at - c.lower)) if c.vanishing and move < 0.0 else c.reach
        if abs(move) > reach > 0.0:
            share = min(share, reach / abs(move))
    return share


def _step(H: Floats, gradient: Floats, z: Floats, lower: Floats, upper: Floats, damping: float) -> Floats:
    """Damped Gauss–Newton step within the bounds: what would cross one goes to it, and the rest makes up for that."""
    A = H + damping * np.diag(np.diag(H))
    free = np.ones(len(z), np.bool_)
    step = np.zeros(len(z))
    for _ in range(10):
        rest = gradient[free] - A[np.ix_(free, ~free)] @ step[~free]
        step[free] = scipy.linalg.cho_solve(scipy.linalg.cho_factor(A[np.ix_(free, free)]), rest)
        out = free & ((z + step < lower) | (z + step > upper))
        if not out.any():
            break
        step[out] = np.where(step[out] < 0.0, lower[out], upper[out]) - z[out]
        free &= ~out
    return step
