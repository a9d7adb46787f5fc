r"""Fit of one window: maximum a posteriori over parameters, start, drift of the heat and swing of the inlet.

With φ = ln of the physical values common to the cells, ξ = (x_0, b, κ) the window's nuisances and z(φ) the lumped
coordinates (`lumped`), Gauss–Newton minimises

.. math::
    \tfrac12 \| W (y - f(\varphi, \xi)) \|^2 + \tfrac12 (\xi - \bar\xi)^T P^{-1} (\xi - \bar\xi)
    + \tfrac12 \delta^T \Lambda \delta + g^T \delta + \tfrac12 \sum_i (\varphi_i - m_i)^2 / s_i^2,
    \qquad \delta = z(\varphi) - z_0

* x_0: start temperatures, as surfaces T_s and e in T_c = T_s + (R_c/R_u)(T_s − T_f + e): what leaves a casing came from
  its core but for the little that it stores. So a hot start mid-drive favours neither root, and R_c moves the core with
  it. Both are correlated between the cells (one pack, one garage).
* b: R_e (or the heat from voltage) walks by an unknown amount within the window and ends at its value of now. A real
  cell's resistance falls as it warms (one more element of b follows the measured surface); without b that passes for a
  time constant, and R_c and R_u are confidently wrong.
* κ: gain of the inlet's departures from its mean. A reading that moves no more than its own error says nothing of μ,
  however sharply the equations would take it at its word.
* W whitens sensor noise and slow model discrepancy.
* What noise of the inlet's readings is expected to add to the first term is taken off it (`inlet_noise`).

Cells are alike while the modes are sought; what their differences do to the mean and its band is reckoned at the mode
(`evidence`), from one more simulation and one linear step.

The sizes of b and of the discrepancy are chosen by the marginal likelihood with its determinants: a profile over the
nuisances prefers whatever lets them swallow the data, and biases R_e by tens of per cent.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bms_gateway.identify.contract import log_prior, string_parameters
from bms_gateway.identify.discrepancy import SIZES, TAUS, Whitener, white_sd
from bms_gateway.identify.evidence import UNLIKE, Evidence, unlike
from bms_gateway.identify.inlet_noise import inlet_noise, of_swing, slopes_by_noise
from bms_gateway.identify.lumped import alias, fold_distance, lumped, lumped_jacobian
from bms_gateway.identify.response import Inputs, Response, respond
from bms_gateway.thermal import KINDS, Floats, StringModel, StringParameters, coolant_path

Root = Literal["both", "smaller", "larger"]
STEP = 1e-4  # of a logarithm, for derivatives: truncation and rounding both stay near 1e-8
ANNEAL = (30.0, 10.0, 3.0)  # times the noise: far starts slide in on a blunted likelihood instead of sticking
WALKS = (0.01, 0.03, 0.1, 0.3, 0.8)  # candidates for the walk of ln R_e in `WALK_S`
WALK_S = 1200.0
KNOT_S = 200.0  # spacing of the walk's knots; faster changes average out over the slow time constant
WARMING_SD = 0.03  # 1/K of the surface: LFP loses 2…6 % of R_e per kelvin in the cold, 1 % when warm
INLET_SD = 0.1  # K: difference between the inlet's reading and what the cells feel, as it moves
SWING_SD = 0.5  # at most so unsure of κ
MODEL_SD = (
    0.2  # K·√s, white: a two-node cell is not believed better, whatever the sensor. Decides on real cells: with 0.01
)
# the fast pole of a cell with radial diffusion drags R_c and R_u (core 3 K off, 1 K with 0.2); 0.4 blunts the slow one
FRESH = ((5.0, 6.0, 1.0), (4.0, 4.0, 1.0))
# K: sd of an unknown start: of T_s and of e; all alike, from end to end of the string, each by itself
CARRIED = ((0.5, 0.5, 0.3), (1.0, 0.5, 0.3))  # K: the same where the window before ended there
STEEP = 1.5  # largest step of a logarithm in one iteration


@dataclass(frozen=True, slots=True)
class Window:
    """K steps and the readings at their ends.

    Attributes
    ----------
    square, heat : ndarray (K,)
        Mean I², A², where heat is I²R_e; heat per cell, W, where it comes from voltage; 0 otherwise.
    inlet : ndarray (K + 1,)
    surface, age : ndarray (K, n)
        °C with NaN for none; s.
    dt : float
    """

    square: Floats
    heat: Floats
    inlet: Floats
    surface: Floats
    age: Floats
    dt: float


@dataclass(frozen=True, slots=True)
class Fit:
    """Outcome of one window.

    Attributes
    ----------
    evidence : Evidence
        Carried in and this window's, about the better root.
    mode : ndarray (p,)
        φ of the better root.
    mean, cov : ndarray (p,), (p, p)
        Posterior of φ; of both roots together where neither can be excluded.
    end : ndarray (2n,)
        (T_s, e) at the end of the window.
    other_root : float
        Probability of the root that `evidence` is not about.
    walk : float
        Chosen size of b.
    white, slow, tau : float
        Chosen σ_w, σ_d (K) and τ (s).
    rms : float
        Of the surface residual, K.
    """

    evidence: Evidence
    mode: Floats
    mean: Floats
    cov: Floats
    end: Floats
    other_root: float
    walk: float
    white: float
    slow: float
    tau: float
    rms: float


@dataclass(frozen=True, slots=True)
class _Sizes:
    white: float
    slow: float
    tau: float
    walk: float


@dataclass(frozen=True, slots=True)
class _Point:
    """Everything at one (φ, ξ): residual and columns, then Hessian and gradient by source."""

    phi: Floats
    xi: Floats
    residual: Floats  # (K, m), NaN where no reading
    columns: Floats  # (K, m, p + q)
    end: Floats  # (T_s, e)
    H: Floats  # of data, evidence and nuisances
    g: Floats
    cost: float  # with the prior


class _Problem:
    """One window and what is carried into it; sets up once what does not change between iterations."""

    def __init__(self, model: StringModel, window: Window, evidence: Evidence, start: Floats | None) -> None:
        self.model, self.evidence = model, evidence
        p = len(evidence.z0)
        self.info, self.grad = np.ascontiguousarray(evidence.info[:p, :p]), evidence.grad[:p]
        self.names, self.prior_mean, prior_sd = log_prior(model)
        self.free = np.flatnonzero(prior_sd > 0.0)
        self.prior_info = np.zeros(len(prior_sd))
        self.prior_info[self.free] = prior_sd[self.free] ** -2
        self.low = np.log([KINDS[s].lower for s in self.names])
        self.high = np.log([KINDS[s].upper for s in self.names])
        self.sensed = [k - 1 for k in model.sensors]
        self.y = window.surface[:, self.sensed]
        self.valid = np.isfinite(self.y)
        self.late = np.clip(np.nan_to_num(window.age[:, self.sensed]) / window.dt, 0.0, 1.0)
        K, N = len(window.square), 2 * model.cells
        J = max(1, round(K * window.dt / KNOT_S))
        knots = np.linspace(0.0, K, J + 1)
        shapes = np.array([np.interp(np.arange(K) + 0.5, knots, e) for e in np.eye(J + 1)[:J]]).T
        shapes = np.column_stack([shapes, _warming(self.y)])
        self.inputs = Inputs(window.square, window.heat, window.inlet, window.dt, shapes, np.zeros(J + 1))
        left = (K - knots[:J]) * window.dt / WALK_S
        self.walk_info = np.linalg.inv(np.minimum.outer(left, left))
        n = model.cells
        self.start_info = np.zeros((N, N))
        along = np.linspace(-1.0, 1.0, n)
        for part, (common, ends, own) in zip(
            (slice(0, n), slice(n, N)), FRESH if start is None else CARRIED, strict=True
        ):
            P = common**2 + ends**2 * np.outer(along, along) + own**2 * np.eye(n)
            self.start_info[part, part] = np.linalg.inv(P)
        early = self.y[: max(1, round(10.0 / window.dt))]
        seen = early[np.isfinite(early)]
        if start is None:
            start = np.zeros(N)
            start[:n] = seen.mean() if seen.size else window.inlet[0]
        self.swing_info = (float(np.std(window.inlet)) / INLET_SD) ** 2 + SWING_SD**-2
        self.N, self.J, self.p = N, J, len(self.names)
        self.unlike_sd = np.array([model.tolerances.get(f"cell_{s}", 0.0) for s in UNLIKE])
        self.xi0 = np.concatenate([start, np.zeros(J + 2)])
        self.moving = np.concatenate([self.free, np.arange(self.p, self.p + N + J + 2)])
        self.noise = inlet_noise(window.inlet, window.dt)
        self.by_noise = np.zeros(self.p + len(self.xi0))

    def feasible(self, phi: Floats) -> bool:
        """Whether the coolant node exists there (bulk: R_u C_f > 1, with room for the derivative's step)."""
        if not self.model.has_coolant_path or self.model.coolant == "ntu":
            return True
        p = string_parameters(self.model, self.names, phi)
        return bool(np.all(p.R_u * p.C_f > 1.001))

    def inside(self, phi: Floats, step: Floats) -> Floats:
        """As much of `step` from a feasible φ as stays feasible."""
        step = step * min(1.0, STEEP / max(float(np.max(np.abs(step))), STEEP))
        while not self.feasible(there := np.clip(phi + step, self.low, self.high)):
            step = step / 2.0
        return np.asarray(there, dtype=np.float64)

    def sets(self, phi: Floats) -> list[StringParameters]:
        """Strings of φ and of φ with one logarithm more by `STEP` each."""
        return [string_parameters(self.model, self.names, q) for q in (phi, *(phi + STEP * np.eye(self.p)))]

    def simulate(self, phi: Floats, xi: Floats) -> tuple[Floats, Floats, Floats]:
        """Residual (K, m), its columns −∂r/∂(φ, ξ) (K, m, p + q), and (T_s, e) at the end (2n,)."""
        sets = self.sets(phi)
        R = self.respond(sets, xi)
        f = self.read(R.surface.transpose(1, 2, 0))
        by_phi = (f[:, :, 1:] - f[:, :, :1]) / STEP
        E, _ = self.start_map(sets[0], self.inputs.inlet[0])
        columns = np.concatenate([by_phi, self.read(R.surface_by_start) @ E, self.read(R.surface_by_input)], axis=2)
        E, c = self.start_map(sets[0], self.inputs.inlet[-1])
        return np.where(self.valid, self.y - f[:, :, 0], np.nan), columns, np.linalg.solve(E, R.last[0] - c)

    def respond(self, sets: list[StringParameters], xi: Floats) -> Response:
        """Response of parameter sets with the nuisances ξ."""
        inputs = replace(self.inputs, departure=xi[self.N : -1], swing=1.0 + float(xi[-1]))
        starts = (self.start_map(s, inputs.inlet[0]) for s in sets)
        return respond(sets, inputs, np.array([E @ xi[: self.N] + c for E, c in starts]), self.sensed)

    def read(self, Y: Floats) -> Floats:
        """Surfaces (K + 1, m, …) at the readings' own times (K, m, …)."""
        late = self.late[:, :, None]
        return np.asarray((1.0 - late) * Y[1:] + late * Y[:-1], dtype=np.float64)

    def start_map(self, p: StringParameters, inlet: float) -> tuple[Floats, Floats]:
        """X = E (T_s, e) + c at an instant, with E (2n, 2n) and c (2n,)."""
        n = self.N // 2
        M, m = coolant_path(p)
        over = (p.R_c / p.R_u)[:, None]
        E, c = np.zeros((self.N, self.N)), np.zeros(self.N)
        E[1::2, :n] = np.eye(n)
        E[0::2, :n] = np.eye(n) + over * (np.eye(n) - M)
        E[0::2, n:] = over * np.eye(n)
        c[0::2] = -over[:, 0] * m * inlet
        return E, c

    def nuisance_info(self, walk: float) -> Floats:
        """P⁻¹ over ξ."""
        out = np.zeros((self.N + self.J + 2,) * 2)
        out[: self.N, : self.N] = self.start_info
        out[self.N : -2, self.N : -2] = self.walk_info / walk**2
        out[-2, -2] = WARMING_SD**-2
        out[-1, -1] = self.swing_info
        return out

    def normal(self, residual: Floats, columns: Floats, whitener: Whitener) -> Floats:
        """[columns, residual]ᵀ [columns, residual], whitened (p + q + 1, p + q + 1)."""
        both = whitener(np.concatenate([columns, residual[:, :, None]], axis=2)).reshape(-1, columns.shape[2] + 1)
        return np.asarray(both.T @ both, dtype=np.float64)

    def assemble(self, phi: Floats, xi: Floats, seen: tuple[Floats, Floats, Floats], M: Floats, walk: float) -> _Point:
        """Add evidence and nuisances to the data's normal matrix `M`."""
        p = self.p
        H, g, cost = M[:-1, :-1].copy(), -M[:-1, -1], 0.5 * float(M[-1, -1])
        D, delta = (
            lumped_jacobian(phi, self.model.has_conduction),
            lumped(phi, self.model.has_conduction) - self.evidence.z0,
        )
        pull = self.info @ delta
        H[:p, :p] += D.T @ self.info @ D
        g[:p] += D.T @ (pull + self.grad)
        info, off = self.nuisance_info(walk), xi - self.xi0
        H[p:, p:] += info
        g[p:] += info @ off
        g -= self.by_noise
        cost -= float(self.by_noise @ np.concatenate([phi, xi]))
        prior = self.prior_info @ (phi - self.prior_mean) ** 2
        cost += float(0.5 * delta @ pull + self.grad @ delta + 0.5 * off @ info @ off + 0.5 * prior)
        return _Point(phi, xi, *seen, H, g, cost)

    def at(self, phi: Floats, xi: Floats, whitener: Whitener, walk: float) -> _Point:
        seen = self.simulate(phi, xi)
        return self.assemble(phi, xi, seen, self.normal(*seen[:2], whitener), walk)

    def with_prior(self, point: _Point) -> tuple[Floats, Floats]:
        """Hessian and gradient over what moves, prior included."""
        H, g, p = point.H.copy(), point.g.copy(), self.p
        H[np.arange(p), np.arange(p)] += self.prior_info
        g[:p] += self.prior_info * (point.phi - self.prior_mean)
        return H[np.ix_(self.moving, self.moving)], g[self.moving]

    def minimise(self, phi: Floats, xi: Floats, sizes: _Sizes, scale: float, most: int) -> _Point:
        """Levenberg–Marquardt from (φ, ξ) with noise times `scale`."""
        W = Whitener.of(self.valid, sizes.white * scale, sizes.slow * scale, sizes.tau, self.inputs.dt)
        here = self.at(phi, xi, W, sizes.walk)
        enough = 1e-3 if scale == 1.0 else 0.1  # of the log posterior
        f, p, damping = len(self.free), self.p, 0.0
        for _ in range(most):
            H, g = self.with_prior(here)
            top = float(np.max(np.diag(H)[:f], initial=1.0))
            there = None
            while damping <= 1e6 * top:
                A = H.copy()
                A[np.arange(f), np.arange(f)] += damping
                move = np.zeros(p + len(xi))
                move[self.moving] = -np.linalg.solve(A, g)
                phi = np.clip(here.phi + move[:p], self.low, self.high)
                if np.max(np.abs(move[:p])) <= STEEP and self.feasible(phi):
                    there = self.at(phi, here.xi + move[p:], W, sizes.walk)
                    if there.cost <= here.cost:
                        break
                damping = max(4.0 * damping, 1e-3 * top)
            if there is None or there.cost > here.cost:
                return here  # no way down from here
            gained = here.cost - there.cost
            here = there
            damping = damping / 8.0 if damping > 1e-6 * top else 0.0
            if gained < enough:
                break
        return here

    def choose(self, at: _Point, white_floor: float) -> _Sizes:
        """Sizes with the largest marginal likelihood, everything else integrated out about `at`."""
        white = white_sd(at.residual, white_floor)
        best, chosen = np.inf, _Sizes(white, SIZES[0], TAUS[0], WALKS[0])
        for slow in SIZES:
            for tau in TAUS:
                W = Whitener.of(self.valid, white, slow, tau, self.inputs.dt)
                M = self.normal(at.residual, at.columns, W)
                for walk in WALKS:
                    point = self.assemble(at.phi, at.xi, (at.residual, at.columns, at.end), M, walk)
                    H, g = self.with_prior(point)
                    L = np.linalg.cholesky(H)
                    down = np.linalg.solve(L, g)
                    score = point.cost - 0.5 * float(down @ down) + 0.5 * W.log_det
                    score += float(np.log(np.diag(L)).sum()) + self.J * np.log(walk)
                    if score < best:
                        best, chosen = score, _Sizes(white, slow, tau, walk)
        return chosen

    def hear_noise(self, at: _Point, sizes: _Sizes) -> None:
        """Take off, from here on, what noise of the inlet adds to the squares about `at`; a constant apart."""
        if self.noise == 0.0:
            return
        W = Whitener.of(self.valid, sizes.white, sizes.slow, sizes.tau, self.inputs.dt)
        swing = 1.0 + float(at.xi[-1])
        slopes = self.noise**2 * slopes_by_noise(
            self.sets(at.phi), STEP, len(self.y), self.inputs.dt, swing, self.sensed, lambda Y: W(self.read(Y))
        )
        heard = float(np.sum(W(at.columns[:, :, -1:]) ** 2))
        self.by_noise[: self.p], self.by_noise[-1] = slopes[:-1], of_swing(float(slopes[-1]), heard)

    def score(self, point: _Point) -> float:
        """−ln of the posterior mass about a mode (Laplace), up to a constant."""
        H, _ = self.with_prior(point)
        return point.cost + 0.5 * float(np.linalg.slogdet(H)[1])

    def marginal(self, point: _Point) -> tuple[Floats, Floats]:
        """Information and gradient over φ, nuisances integrated out, prior not included."""
        p = self.p
        gain = np.linalg.solve(point.H[p:, p:], point.H[p:, :p])
        return point.H[:p, :p] - point.H[:p, p:] @ gain, point.g[:p] - gain.T @ point.g[p:]

    def with_cells(self, point: _Point, sizes: _Sizes) -> tuple[Floats, Floats]:
        """Information and gradient as of `marginal`, over φ and the departures u of single cells."""
        p, r = self.p, len(point.g)
        base = string_parameters(self.model, self.names, point.phi)
        f = self.read(self.respond([base, *unlike(base, STEP)], point.xi).surface.transpose(1, 2, 0))
        by_cell = ((f[:, :, 1:] - f[:, :, :1]) / STEP).reshape(*f.shape[:2], len(UNLIKE), self.model.cells)
        by_cell = self.unlike_sd[:, None] * (by_cell - by_cell.mean(axis=3, keepdims=True))
        columns = np.concatenate([point.columns, by_cell.reshape(*f.shape[:2], -1)], axis=2)
        W = Whitener.of(self.valid, sizes.white, sizes.slow, sizes.tau, self.inputs.dt)
        M = self.normal(point.residual, columns, W)
        H, g = M[:-1, :-1].copy(), -M[:-1, -1]
        H[:r, :r], g[:r] = point.H, point.g
        carried, delta = self.evidence, lumped(point.phi, self.model.has_conduction) - self.evidence.z0
        cross = lumped_jacobian(point.phi, self.model.has_conduction).T @ carried.info[:p, p:]
        H[:p, r:] += cross
        H[r:, :p] += cross.T
        H[r:, r:] += carried.info[p:, p:]
        g[r:] += carried.info[p:, :p] @ delta + carried.grad[p:]
        kept = np.r_[:p, r : len(g)]
        gain = np.linalg.solve(H[p:r, p:r], H[p:r, kept])
        return H[np.ix_(kept, kept)] - H[kept, p:r] @ gain, g[kept] - gain.T @ g[p:r]

    def mean_of_cells(self, point: _Point, info: Floats, grad: Floats) -> tuple[Floats, Floats]:
        """Step of φ from the mode, and covariance there, with u integrated out of `with_cells`."""
        p, own = self.p, info[self.p :, self.p :] + np.eye(len(grad) - self.p)
        gain = np.linalg.solve(own, info[p:, :p])
        H = info[:p, :p] + np.diag(self.prior_info) - info[:p, p:] @ gain
        g = grad[:p] + self.prior_info * (point.phi - self.prior_mean) - gain.T @ grad[p:]
        cov = np.zeros((p, p))
        cov[np.ix_(self.free, self.free)] = np.linalg.inv(H[np.ix_(self.free, self.free)])
        cov = 0.5 * (cov + cov.T)
        return -cov @ g, cov

    def covariance(self, point: _Point) -> Floats:
        """Posterior covariance of φ at a mode; zero for what is fixed."""
        info, _ = self.marginal(point)
        post = info + np.diag(self.prior_info)
        cov = np.zeros_like(post)
        part = np.ix_(self.free, self.free)
        cov[part] = np.linalg.inv(post[part])
        return 0.5 * (cov + cov.T)


def _warming(y: Floats) -> Floats:
    """Mean measured surface over its value at the end of the window (K,), K; 0 where nothing was read."""
    counted = np.isfinite(y).sum(axis=1)
    read = np.flatnonzero(counted)
    if not len(read):
        return np.zeros(len(y))
    mean = np.nansum(y[read], axis=1) / counted[read]
    return np.asarray(np.interp(np.arange(len(y)), read, mean) - np.mean(mean[-60:]), dtype=np.float64)


def fit_window(
    model: StringModel,
    window: Window,
    evidence: Evidence,
    guess: Floats,
    start: Floats | None,
    *,
    root: Root = "both",
    model_sd: float = MODEL_SD,
) -> Fit:
    """Fit one window.

    Parameters
    ----------
    model : StringModel
    window : Window
    evidence : Evidence
        Of the windows before.
    guess : ndarray (p,)
        First φ.
    start : ndarray (2n,) or None
        (T_s, e) where the window before ended, °C and K; None where nothing is known.
    root : {"both", "smaller", "larger"}
        Which roots of Eq 9 are possible.
    model_sd : float, K·√s
        White error of the model itself.

    Returns
    -------
    Fit

    References
    ----------
    Lin et al., Eq 1, 9, 16–18 for the model; the method is ours.
    """
    problem = _Problem(model, window, evidence, start)
    phi, xi = np.array(guess, dtype=np.float64), problem.xi0
    floor = model_sd / float(np.sqrt(window.dt))
    sizes = _Sizes(floor, 0.05, 100.0, 0.1)
    for scale in () if evidence.info.any() else ANNEAL:
        point = problem.minimise(phi, xi, sizes, scale, 6)
        phi, xi = point.phi, point.xi
    point = problem.minimise(phi, xi, sizes, 1.0, 10)
    for _ in range(2):
        sizes = problem.choose(point, floor)
        problem.hear_noise(point, sizes)
        point = problem.minimise(point.phi, point.xi, sizes, 1.0, 10)
    point, mean, cov, other = _both_roots(problem, point, sizes, root)
    info, grad = problem.marginal(point)
    if model.cells > 1:
        info, grad = problem.with_cells(point, sizes)
        step, wider = problem.mean_of_cells(point, info, grad)
        mean, cov = problem.inside(mean, step), cov + wider - problem.covariance(point)
    back = np.eye(len(grad))
    back[: problem.p, : problem.p] = np.linalg.inv(lumped_jacobian(point.phi, model.has_conduction))
    info_z = back.T @ info @ back
    rms = float(np.sqrt(np.nanmean(point.residual**2))) if problem.valid.any() else np.nan
    return Fit(
        Evidence(lumped(point.phi, model.has_conduction), 0.5 * (info_z + info_z.T), back.T @ grad),
        point.phi, mean, cov, point.end, other, sizes.walk, sizes.white, sizes.slow, sizes.tau, rms,
    )  # fmt: skip


def _both_roots(problem: _Problem, point: _Point, sizes: _Sizes, root: Root) -> tuple[_Point, Floats, Floats, float]:
    """Look on the other side of the fold; mean and covariance of both where neither can be excluded."""
    cov = problem.covariance(point)
    other = np.clip(alias(point.phi), problem.low, problem.high)
    other = np.where(problem.prior_info > 0.0, other, point.phi)
    if root != "both":
        if (fold_distance(point.phi) > 0.0) == (root == "smaller") and problem.feasible(other):
            point = problem.minimise(other, point.xi, sizes, 1.0, 10)
        return point, point.phi, problem.covariance(point), 0.0
    jump = lumped(other, problem.model.has_conduction) - lumped(point.phi, problem.model.has_conduction)
    info, _ = problem.marginal(point)
    back = np.linalg.inv(lumped_jacobian(point.phi, problem.model.has_conduction))
    if not problem.feasible(other) or 0.5 * jump @ (back.T @ info @ back) @ jump > 20.0:
        return point, point.phi, cov, 0.0  # the inlet moved enough to exclude it
    twin = problem.minimise(other, point.xi, sizes, 1.0, 10)
    if np.max(np.abs(twin.phi - point.phi)) < 0.05:
        return point, point.phi, cov, 0.0  # it slid back: there is one mode only
    weight = 1.0 / (1.0 + np.exp(np.clip(problem.score(twin) - problem.score(point), -50.0, 50.0)))
    if weight > 0.5:
        point, twin, weight = twin, point, 1.0 - weight
    mean = (1.0 - weight) * point.phi + weight * twin.phi
    apart = twin.phi - point.phi
    cov = (1.0 - weight) * problem.covariance(point) + weight * problem.covariance(twin)
    return point, mean, cov + weight * (1.0 - weight) * np.outer(apart, apart), float(weight)
