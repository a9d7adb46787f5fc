r"""Fit of one window: maximum a posteriori over parameters, start, drift of the heat and swing of the inlet.

φ: ln of the physical values common to the cells; v: coefficients of the effects that every cell may have (`carried`); ξ
= (x_0, b, κ): the window's nuisances; z(φ): the lumped coordinates (`identifiable`). Gauss–Newton minimises

.. math::
    \tfrac12 \| W (y - f(\varphi, \xi) - C v) \|^2 + \tfrac12 (\xi - \bar\xi)^T P^{-1} (\xi - \bar\xi)
    + \tfrac12 \delta^T \Lambda \delta + g^T \delta + \tfrac12 \sum_i (\varphi_i - m_i)^2 / s_i^2
    + \tfrac12 v^T v, \qquad \delta = (z(\varphi) - z_0, v)

* x_0: start temperatures, as surfaces T_s and e in T_c = T_s + (R_c/R_u)(T_s − T_f + e): the heat that leaves a casing
came
  from its core, except the little that the casing stores. So a hot start during a drive favours neither root, and R_c
  moves the core with it. Both are correlated between the cells (one pack, one garage).
* b: R_e (or the heat from voltage) walks by an unknown amount within the window and ends at its present value. Without
  b, this looks like a time constant, and R_c and R_u are confidently wrong.
* R_e of each core follows its temperature with an unknown B, one of v (`thermal.warmth`). R_e in φ is that at 25 °C.
* κ: gain of the inlet's deviations from its mean. A reading that moves no more than its own error contains no
information
  on μ, although the equations without κ would use it.
* W whitens sensor noise and the slow model error.
* v is constant from window to window like φ, and its evidence is carried along.
* The expected addition of the noise of the inlet's readings to the first term is subtracted (`inlet_noise`).

Cells are equal while the modes are searched. The effect of their differences on the mean and its band is computed at
the mode (`window_evidence`), from one more simulation and one linear step.

The sizes of b and of the slow error are chosen by the marginal likelihood with its determinants: a profile over the
nuisances prefers those that absorb the data, and biases R_e by tens of per cent.

A small residual does not prove a model. The model lacks something if the data want a parameter or a carried effect far
from its prior, a large slow error, or a walk that no cell's warming explains. Its error is then at least so large that
the parameters may stay near their prior. The noise is raised by the factor `doubt`, which widens the posterior and
moves it back towards the prior. From `DOUBTED` to `HOPELESS` it is raised further, so that the window teaches less and
less, and the weight of earlier evidence is reduced.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bms_gateway.identify.carried import WARMTH_AT
from bms_gateway.identify.doubt import hopeless
from bms_gateway.identify.for_observer import apart, effective
from bms_gateway.identify.identifiable import alias, fold_distance, lumped, lumped_jacobian
from bms_gateway.identify.quadratic import Quadratic
from bms_gateway.identify.window_evidence import Evidence
from bms_gateway.identify.window_problem import ANNEAL, Point, Problem, Sizes, V, Window
from bms_gateway.thermal import Floats, StringModel

Root = Literal["both", "smaller", "larger"]
SOUND_SLOW = 0.06
"""K: slow error that right models have in addition to the rounding of their thermocouples; a larger slow residual is a
model error."""
SOUND_WALK = 0.1
"""Walk of ln R_e that a cell's warming explains."""
TRIES = 4  # at raising the noise: each starts where the previous one ended
ALMOST = 0.02  # smaller excess of the factor is ignored
KEPT = 0.25
"""Share of the earlier evidence that is kept if a window is hopeless."""
LEAST_DROP = 0.5
"""Drop of a single mode's log posterior from its top to the other root; below this, the other root is within one sd."""
UNLEARNT = 0.5
"""Variance of B, over that of its prior, from which a hopeless window has taught nothing of it."""
DEAF = 1e3  # times the noise of a hopeless window: only the prior and the evidence count


@dataclass(frozen=True, slots=True)
class Fit:
    """Result of one window.

    Attributes
    ----------
    evidence : Evidence
        Earlier evidence and that of this window, about the better root.
    mode : ndarray (p,)
        φ of the better root.
    mean, cov : ndarray (p + 1,), (p + 1, p + 1)
        Posterior of φ including the carried effects, and of the logarithm of the gain of heat from voltage; of both
        roots together if neither can be excluded.
    apart : tuple of ndarray (p + 4,), (p + 4, p + 4)
        The same with some effects as numbers of their own (`for_observer.apart`).
    warmth : tuple of float
        At which R_e is stated there (`thermal.warmth`), and the sd of the cores' warmth about it in the window.
    end : ndarray (2n,)
        (T_s, e) at the end of the window.
    other_root : float
        Probability of the root that `evidence` does not describe.
    walk : float
        Chosen size of b.
    white, slow, tau : float
        Chosen σ_w, σ_d (K) and τ (s).
    rms : float
        Of the surface residual, K.
    doubt : float
        Factor by which the noise was raised so that parameters stay near their prior; 1 for a right model.
    constant : ndarray (n,), K
        Constant error of each cell's thermocouple; 0 where there is none, and where there are fewer than three.
    """

    evidence: Evidence
    mode: Floats
    mean: Floats
    cov: Floats
    apart: tuple[Floats, Floats]
    warmth: tuple[float, float]
    end: Floats
    other_root: float
    walk: float
    white: float
    slow: float
    tau: float
    rms: float
    doubt: float
    constant: Floats


@dataclass(frozen=True, slots=True)
class WindowJob:
    """Fit of one window with all its data.

    Attributes
    ----------
    model : StringModel
    window : Window
    evidence : Evidence
        Of the windows before.
    guess : ndarray (p,)
        First φ.
    start : ndarray (2n,) or None
        (T_s, e) at the end of the window before, °C and K; None if nothing is known.
    root : {"both", "smaller", "larger"}
        Which roots of Eq 9 are possible.
    model_sd : float, K·√s
        White error of the model itself.
    carried : float
        Size of the carried effects, in their own sd.
    least_doubt : float
        Least factor by which the noise is raised.
    """

    model: StringModel
    window: Window
    evidence: Evidence
    guess: Floats
    start: Floats | None
    root: Root
    model_sd: float
    carried: float
    least_doubt: float

    def run(self) -> Fit:
        """Fit; the same job gives the same result to the last bit.

        References
        ----------
        Lin et al., Eq 1, 9, 16–18 for the model; the method is not in the paper.
        """
        return _fitted(self)


def _fitted(job: WindowJob) -> Fit:
    model, root = job.model, job.root
    problem = Problem(model, job.window, job.evidence, job.start, job.carried)
    p = problem.p
    phi, xi = np.array(job.guess, dtype=np.float64), problem.xi0
    floor = problem.error_floor(job.model_sd)
    sizes = Sizes(floor, 0.05, 100.0, 0.1)
    for scale in () if job.evidence.info.any() else ANNEAL:
        point = problem.minimise(phi, xi, sizes, scale, 6)
        phi, xi = point.phi, point.xi
    point = problem.minimise(phi, xi, sizes, 1.0, 10)
    for _ in range(2):
        sizes = problem.choose(point, floor)
        problem.hear_noise(point, sizes)
        point = problem.minimise(point.phi, point.xi, sizes, 1.0, 10)
    point, mean, cov, other = _both_roots(problem, point, sizes, root)
    doubt = 1.0
    sound = float(np.hypot(SOUND_SLOW, problem.means.rounding))
    least = max(sizes.slow / sound, float(np.sqrt(sizes.walk / SOUND_WALK)), job.least_doubt)
    for _ in range(TRIES):
        factor = max(problem.noisier(point, mean[:p], sizes), least / doubt)
        if factor <= 1.0 + ALMOST:
            break
        doubt *= factor
        sizes = replace(sizes, white=sizes.white * factor, slow=sizes.slow * factor)
        problem.hear_noise(point, sizes)
        point = problem.minimise(point.phi, point.xi, sizes, 1.0, 10)
        point, mean, cov, other = _both_roots(problem, point, sizes, root)
    share = hopeless(doubt)
    if share > 0.0:  # at 1 nothing is learnt, and earlier evidence is reduced
        problem.distrust(KEPT**share)
        sizes = replace(sizes, white=sizes.white * DEAF**share, slow=sizes.slow * DEAF**share)
        problem.hear_noise(point, sizes)
        point = problem.minimise(point.phi, problem.xi0, sizes, 1.0, 10)
        point, mean, cov, other = _both_roots(problem, point, sizes, root)
    told = problem.marginal(point)
    if model.cells > 1:
        told = problem.with_cells(point, sizes)
        step, wider = problem.mean_of_cells(point, told)
        cov += wider - problem.covariance(point)
        mean = np.append(problem.inside(mean[:p], step[:p]), mean[p:] + step[p:])
    back, P = np.eye(len(told.pull)), problem.P
    D = problem.lumped_slopes(point.phi, problem.cores.mean)
    back[:P, :P] = np.linalg.inv(D)
    info_z = back.T @ told.H @ back
    rms = float(np.sqrt(np.nanmean(point.residual**2))) if problem.means.valid.any() else np.nan
    z = lumped(point.phi, model.has_conduction) + D[:p, p + WARMTH_AT] * point.xi[WARMTH_AT]
    v = np.zeros(len(told.pull))
    v[p : problem.P] = point.xi[:V]
    grad_z = -back.T @ told.pull - info_z @ v  # evidence is stated about v = 0
    at = stated = problem.cores.mean
    if float(cov[p + WARMTH_AT, p + WARMTH_AT]) > UNLEARNT:
        stated *= 1.0 - share  # R_e of the file counts as that of cells that drive, whatever their temperature
    own = apart(problem, mean, cov, stated)
    mean, cov = effective(problem, mean, cov, stated)
    return Fit(
        Evidence(z, 0.5 * (info_z + info_z.T), grad_z, at),
        point.phi, mean, cov, own, (at, problem.cores.swing), point.end, other, sizes.walk, sizes.white, sizes.slow,
        sizes.tau, rms, doubt, problem.constants(point, sizes),
    )  # fmt: skip


def _both_roots(problem: Problem, point: Point, sizes: Sizes, root: Root) -> tuple[Point, Floats, Floats, float]:
    """Find the other root; return mean and covariance of both if neither can be excluded."""
    cov = problem.covariance(point)
    here = np.append(point.phi, point.xi[:V])
    other = np.clip(alias(point.phi), problem.sought.low, problem.sought.high)
    other = np.where(problem.sought.info > 0.0, other, point.phi)
    if root != "both":
        if (fold_distance(point.phi) > 0.0) == (root == "smaller") and problem.feasible(other):
            point = problem.minimise(other, point.xi, sizes, 1.0, 10)
        return point, np.append(point.phi, point.xi[:V]), problem.covariance(point), 0.0
    jump = lumped(other, problem.model.has_conduction) - lumped(point.phi, problem.model.has_conduction)
    info = _of_numbers(problem, point)
    back = np.linalg.inv(lumped_jacobian(point.phi, problem.model.has_conduction))
    if not problem.feasible(other) or 0.5 * jump @ (back.T @ info @ back) @ jump > 20.0:
        return point, here, cov, 0.0  # the inlet moved enough to exclude the other root
    problem.cores.seek_other()
    twin = problem.minimise(other, point.xi, sizes, 1.0, 10)
    twin = problem.minimise(twin.phi, twin.xi, sizes, 1.0, 10)  # with the cores that it has found
    if np.max(np.abs(twin.phi - point.phi)) < 0.05:  # it returned: there is only one mode
        mean, cov = _leaning(problem, point, other, sizes, cov)
        problem.keep_root(point, other=False)
        return point, mean, cov, 0.0
    scores = problem.score(twin), problem.score(point)
    weight = 1.0 / (1.0 + np.exp(np.clip(scores[0] - scores[1], -50.0, 50.0)))
    there = np.append(twin.phi, twin.xi[:V])
    better = weight > 0.5
    if better:
        point, twin, here, there, weight = twin, point, there, here, 1.0 - weight
    problem.keep_root(point, other=better)
    apart = there - here
    cov = (1.0 - weight) * problem.covariance(point) + weight * problem.covariance(twin)
    return point, here + weight * apart, cov + weight * (1.0 - weight) * np.outer(apart, apart), float(weight)


def _of_numbers(problem: Problem, point: Point) -> Floats:
    """Information (p, p) of the data on φ, with the carried effects integrated out."""
    q, known = problem.marginal(point), np.zeros(problem.P)
    known[problem.p :] = 1.0
    return Quadratic(q.H + np.diag(known), q.pull).marginal(np.arange(problem.p)).H


def _leaning(problem: Problem, point: Point, other: Floats, sizes: Sizes, cov: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance of a single mode whose posterior is wider towards the other root than away from it.

    With a the vector from the mode to the other root, the normal distribution at the mode expects the log posterior
    there to be lower by Δ = aᵀ H a / 2. If it is lower by Δ* < Δ only, the distribution is wider on that side: (2
    Δ)^{-1/2} on one side and (2 Δ*)^{-1/2} on the other, in units of a.
    """
    free, mean = problem.sought.free, np.append(point.phi, point.xi[:V])
    away = other - point.phi
    expected = 0.5 * float(away @ (_of_numbers(problem, point) + np.diag(problem.sought.info)) @ away)
    found = max(problem.profile(other, point.xi, sizes) - point.cost, LEAST_DROP)
    if found >= expected:
        return mean, cov
    near, far = (2.0 * expected) ** -0.5, (2.0 * found) ** -0.5
    way = cov[:, free] @ np.linalg.solve(cov[np.ix_(free, free)], away[free])
    moved, variance = split_normal(near, far)
    return mean + moved * way, cov + (variance - near**2) * np.outer(way, way)


def split_normal(near: float, far: float) -> tuple[float, float]:
    """Mean and variance, about the mode, of a normal distribution with a different sd on each side.

    Parameters
    ----------
    near, far : float
        sd below and above the mode.

    References
    ----------
    K. F. Wallis, The two-piece normal, binormal, or double Gaussian distribution, Statistical Science 29 (2014).

    Examples
    --------
    >>> x = np.linspace(-20.0, 20.0, 100_001)
    >>> p = np.exp(-0.5 * (x / np.where(x < 0.0, 1.0, 2.5)) ** 2)
    >>> mean = float(np.sum(p * x) / np.sum(p))
    >>> np.allclose(split_normal(1.0, 2.5), (mean, np.sum(p * (x - mean) ** 2) / np.sum(p)), rtol=1e-5)
    True
    """
    apart = far - near
    return float(np.sqrt(2.0 / np.pi)) * apart, (1.0 - 2.0 / np.pi) * apart**2 + near * far
