r"""One window of one string as a least-squares problem: the free numbers, the nuisances and their priors.

See `posterior_fit` for the theory.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.identify.carried import NAMES, ROLL_AT, WARMTH_AT, Carried, Course, columns, roll_bend, roll_share
from bms_gateway.identify.contract import string_parameters
from bms_gateway.identify.descent import Pace, Patience, descend
from bms_gateway.identify.doubt import noise_factor, sound_sd
from bms_gateway.identify.identifiable import R_C, R_E, R_U, lumped, lumped_jacobian
from bms_gateway.identify.inlet_noise import Sight, inlet_noise, of_swing, slopes_by_noise
from bms_gateway.identify.model_noise import SIZES, TAUS, Whitener, white_sd
from bms_gateway.identify.quadratic import Quadratic
from bms_gateway.identify.response import Inputs, Response, Warmth, respond
from bms_gateway.identify.window_evidence import UNLIKE, Evidence, unlike
from bms_gateway.identify.window_means import Means, Sought
from bms_gateway.identify.window_start import FRESH, first_start, start_information, start_map, swing_information
from bms_gateway.identify.window_warmth import CoresOfRoots, at_readings_of, warmth_of
from bms_gateway.thermal import Floats, StringModel, StringParameters
from bms_gateway.thermal.entropy import CAPACITY_AH
from bms_gateway.thermal.warmth import LEAST_B, MOST_B, WARMTH_SD

STEP = 1e-4  # of a logarithm, for derivatives: truncation and rounding both stay near 1e-8
ANNEAL = (30.0, 10.0, 3.0)  # times the noise: with a broad likelihood, distant starts reach the optimum
WALKS = (0.01, 0.03, 0.1, 0.3, 0.8)  # candidates for the walk of ln R_e in `WALK_S`
WALK_S = 1200.0
KNOT_S = 200.0  # spacing of the walk's knots; faster changes average out over the slow time constant
MODEL_SD = 0.14
"""K·√s, white: no model of a cell is more exact, with any sensor. Determined on real cells: core 3 K off with 0.01; 0.4
loses the slow time constant."""
CONSTANT_SD = 0.4
"""K: constant error of each of `LEAST_SEVERAL` or more thermocouples: of two, nothing tells which one is wrong, and to
one alone, the temperature of the surroundings that every window carries (`carried`) is the same."""
LEAST_SEVERAL = 3
CARRIED = ((0.5, 0.5, 0.3), (1.0, 0.5, 0.3))  # K: spread of a start where the earlier window ended there
V = len(NAMES)
"""Carried effects."""
Each = float | list[float]  # of all parameter sets, or of each
STEEP = 1.5  # largest step of a logarithm in one iteration
PACE = Pace(0.0, 1e-3, 4.0, 0.125, 16, halves=True)


@dataclass(frozen=True, slots=True)
class Window:
    """K steps and the readings at their ends.

    Attributes
    ----------
    square, heat : ndarray (K,)
        Mean I², A², where heat is I²R_e; heat per cell, W, where it comes from voltage; 0 otherwise.
    current : ndarray (K,), A
        Mean current, discharge positive.
    inlet : ndarray (K + 1,)
    surface, age : ndarray (K, n)
        °C with NaN for none; s.
    dt : float
    """

    square: Floats
    heat: Floats
    current: Floats
    inlet: Floats
    surface: Floats
    age: Floats
    dt: float


@dataclass(frozen=True, slots=True)
class Sizes:
    """Sizes of the noise: white and slow, K; memory of the slow part, s; walk of ln R_e in `WALK_S`."""

    white: float
    slow: float
    tau: float
    walk: float


@dataclass(frozen=True, slots=True)
class Point:
    """Everything at one (φ, ξ): residual and columns, then Hessian and gradient by source."""

    phi: Floats
    xi: Floats
    residual: Floats  # (K, m), NaN where no reading
    columns: Floats  # (K, m, p + q)
    end: Floats  # (T_s, e)
    H: Floats  # of data, evidence and nuisances
    g: Floats
    cost: float  # with the prior
    z: Floats  # the free part of (phi, xi)

    @property
    def deviance(self) -> float:
        """Twice the cost."""
        return 2.0 * self.cost


class Problem:
    """One window with its earlier evidence; holds what does not change between iterations."""

    def __init__(
        self, model: StringModel, window: Window, evidence: Evidence, start: Floats | None, carried: float
    ) -> None:
        self.model, self.evidence, self.size = model, evidence, carried
        self.sought = Sought.of(model)
        self.info, self.grad = np.ascontiguousarray(evidence.info[: self.P, : self.P]), evidence.grad[: self.P]
        self.means = Means.of(window.surface, window.age, [k - 1 for k in model.sensors], window.dt)
        read = window.surface[:, self.means.sensed]
        K = len(window.square)
        J = max(1, round(K * window.dt / KNOT_S))
        knots = np.linspace(0.0, K, J + 1)
        shapes = np.array([np.interp(np.arange(K) + 0.5, knots, e) for e in np.eye(J + 1)[:J]]).T
        self.inputs = Inputs(window.square, window.heat, window.inlet, window.dt, shapes, np.zeros(J))
        if carried > 0.0:
            self.inputs = replace(self.inputs, warmth=Warmth.nothing(K, model.cells))
        self.cores = CoresOfRoots()
        left = (K - knots[:J]) * window.dt / WALK_S
        self.walk_info = np.linalg.inv(np.minimum.outer(left, left))
        self.start_info = start_information(model.cells, *(FRESH if start is None else CARRIED))
        if start is None:
            start = first_start(read, window.dt, float(window.inlet[0]), model.cells)
        self.swing_info = swing_information(window.inlet)
        self.unlike_sd = np.array([model.tolerances.get(f"cell_{s}", 0.0) for s in UNLIKE])
        self.xi0 = np.concatenate([np.zeros(V), start, np.zeros(J + 1)])
        self.moving = np.concatenate([self.sought.free, np.arange(self.p, self.p + len(self.xi0))])
        self.noise = inlet_noise(window.inlet, window.dt)
        self.by_noise = np.zeros(self.p + len(self.xi0))
        self.course = Course.of(
            window.square, window.heat, window.current, window.inlet, window.dt, model.capacity_Ah or CAPACITY_AH
        )
        self.carried = np.zeros((*self.means.y.shape, V))
        self.effects = Carried(self.carried, np.zeros((2, V)), np.zeros((self.N, V)), np.zeros((1, model.cells)))

    @property
    def p(self) -> int:
        """Count the numbers φ."""
        return len(self.sought.names)

    @property
    def P(self) -> int:
        """Count φ and the coefficients v of the carried effects, which are the first of ξ."""
        return self.p + V

    @property
    def N(self) -> int:
        """Count the numbers of a start."""
        return len(self.start_info)

    @property
    def J(self) -> int:
        """Count the knots of the walk."""
        return len(self.walk_info)

    @property
    def lasting(self) -> NDArray[np.intp]:
        """Places of the numbers that are also needed after the window."""
        return np.concatenate([self.sought.free, np.arange(self.p, self.P)])

    def error_floor(self, model_sd: float) -> float:
        """Least sd of a reading about the model, K.

        The model itself has an error of `model_sd`, K·√s. It also responds to noise of the inlet's readings, which no
        cell feels: by R_c/(R_c + R_u), as the casing follows the coolant earlier than the core does.
        """
        R_c, R_u = np.exp(self.sought.mean[[R_C, R_U]])
        followed = self.noise * float(np.sqrt(self.inputs.dt) * R_c / (R_c + R_u))
        return float(np.hypot(model_sd, followed) / np.sqrt(self.means.dt))

    def distrust(self, kept: float) -> None:
        """Keep a share of the earlier evidence."""
        e = self.evidence
        self.evidence = replace(e, info=kept * e.info, grad=kept * e.grad)
        self.info, self.grad = kept * self.info, kept * self.grad

    def feasible(self, phi: Floats) -> bool:
        """Whether the coolant node exists at φ (bulk: R_u C_f > 1, with a margin for the derivative's step)."""
        if not self.model.has_coolant_path or self.model.coolant == "ntu":
            return True
        p = string_parameters(self.model, self.sought.names, phi)
        return bool(np.all(p.R_u * p.C_f > 1.001))

    def inside(self, phi: Floats, step: Floats) -> Floats:
        """Largest part of `step` from a feasible φ that stays feasible."""
        step = step * min(1.0, STEEP / max(float(np.max(np.abs(step))), STEEP))
        while not self.feasible(there := np.clip(phi + step, self.sought.low, self.sought.high)):
            step = step / 2.0
        return np.asarray(there, dtype=np.float64)

    def sets(self, phi: Floats) -> list[StringParameters]:
        """Strings of φ, and of φ with one logarithm increased by `STEP` each."""
        return [string_parameters(self.model, self.sought.names, q) for q in (phi, *(phi + STEP * np.eye(self.p)))]

    def simulate(self, phi: Floats, xi: Floats) -> tuple[Floats, Floats, Floats]:
        """Residual (K, m), its columns −∂r/∂(φ, ξ) (K, m, p + q), and (T_s, e) at the end (2n,)."""
        sets, shares, B = self.sets(phi), [self.roll(xi)] * (self.p + 1), [self.B(xi)] * (self.p + 1)
        if self.size > 0.0:
            sets, shares, B = [*sets, sets[0]], [*shares, self.roll(xi, STEP)], [*B, B[0]]
            if self.model.cells > 1:
                sets, shares, B = [*sets, sets[0]], [*shares, shares[0]], [*B, self.B(xi, STEP)]
        R = self.respond(sets, xi, shares, B)
        f = self.means.read(R.surface.transpose(1, 2, 0))
        by_phi = (f[:, :, 1 : self.p + 1] - f[:, :, :1]) / STEP
        E, _ = start_map(sets[0], self.inputs.inlet[0])
        by_start, by_input = self.means.read(R.surface_by_start) @ E, self.means.read(R.surface_by_input)
        columns = np.concatenate([by_phi, self.carried, by_start, by_input[:, :, : self.J + 1]], axis=2)
        if self.size > 0.0:
            beside = (f[:, :, self.p + 1 :] - f[:, :, :1]) / STEP
            columns[:, :, self.p + ROLL_AT] = beside[:, :, 0]
            columns[:, :, self.p + WARMTH_AT] = self.B_unit * by_input[:, :, -1] + beside[:, :, 1:].sum(axis=2)
        E, c = start_map(sets[0], self.inputs.inlet[-1])
        predicted, last = f[:, :, 0] + self.carried @ xi[:V], R.last[0] + self.effects.last @ xi[:V]
        return np.where(self.means.valid, self.means.y - predicted, np.nan), columns, np.linalg.solve(E, last - c)

    def carry(self, phi: Floats, xi: Floats) -> None:
        """Set the carried effects to those along the trajectory of (φ, ξ)."""
        if self.size == 0.0:
            return
        p = string_parameters(self.model, self.sought.names, phi)
        R = self.respond([p], xi, self.roll(xi))
        E, c = start_map(p, self.inputs.inlet[0])
        x0 = E @ xi[V : V + self.N] + c
        found = columns(p, self.course, x0, R.surface[0], self.means.sensed, self.B(xi))
        self.effects = found.times(self.size)
        self.carried = self.means.read(self.effects.readings)
        simulated = self.means.read(R.surface[0][:, :, None])[:, :, 0] + self.carried @ xi[:V]
        core = at_readings_of(self.means, simulated, found.core, p, self.course.dt)
        w, self.cores.mean, self.cores.swing = warmth_of(core, self.course)
        self.inputs = replace(self.inputs, warmth=w)

    @property
    def B_unit(self) -> float:
        """One unit of the coefficient of B, 1000 K."""
        return self.size * WARMTH_SD

    def B(self, xi: Floats, more: float = 0.0) -> float:
        """B with which R_e follows the warmth of the cores, with `more` added to its coefficient, 1000 K."""
        return self.B_unit * (float(xi[WARMTH_AT]) + more)

    def roll(self, xi: Floats, more: float = 0.0) -> float:
        """Share of R_c within the jelly roll, with `more` added to its coefficient."""
        return roll_share(self.size * (float(xi[ROLL_AT]) + more)) if self.size > 0.0 else 0.0

    def respond(self, sets: list[StringParameters], xi: Floats, share: Each = 0.0, B: Each | None = None) -> Response:
        """Response of parameter sets with the nuisances ξ, the roll's share of R_c, and B by which cells differ."""
        start = xi[V : V + self.N]
        inputs = replace(self.inputs, departure=xi[V + self.N : -1], swing=1.0 + float(xi[-1]), B=self.B(xi))
        starts = (start_map(s, inputs.inlet[0]) for s in sets)
        at = np.array([E @ start + c for E, c in starts])
        return respond(sets, inputs, at, self.means.sensed, share, inputs.B if B is None else B)

    def whitener(self, sizes: Sizes, scale: float = 1.0) -> Whitener:
        """Filter of the noise."""
        constant = CONSTANT_SD if len(self.means.sensed) >= LEAST_SEVERAL and self.size > 0.0 else 0.0
        return self.means.whitener(sizes.white * scale, sizes.slow * scale, sizes.tau, constant)

    def constants(self, point: Point, sizes: Sizes) -> Floats:
        """Constant error (n,), K, of each cell's thermocouple; 0 without one."""
        out = np.zeros(self.model.cells)
        out[self.means.sensed] = self.whitener(sizes).constants(point.residual)
        return out

    def nuisance_info(self, walk: float) -> Floats:
        """P⁻¹ over ξ, without the carried effects' prior."""
        first, end = V, V + self.N
        out = np.zeros((end + self.J + 1,) * 2)
        out[first:end, first:end] = self.start_info
        out[end:-1, end:-1] = self.walk_info / walk**2
        out[-1, -1] = self.swing_info
        return out

    def normal(self, residual: Floats, columns: Floats, whitener: Whitener) -> Floats:
        """[columns, residual]ᵀ [columns, residual], whitened (p + q + 1, p + q + 1)."""
        both = whitener(np.concatenate([columns, residual[:, :, None]], axis=2)).reshape(-1, columns.shape[2] + 1)
        return np.asarray(both.T @ both, dtype=np.float64)

    def assemble(self, phi: Floats, xi: Floats, seen: tuple[Floats, Floats, Floats], M: Floats, walk: float) -> Point:
        """Add evidence and nuisances to the data's normal matrix `M`."""
        p, P = self.p, self.P
        H, g, cost = M[:-1, :-1].copy(), -M[:-1, -1], 0.5 * float(M[-1, -1])
        if self.size > 0.0:  # small shares are exponential in v: without the curvature, steps overshoot
            at = p + ROLL_AT
            H[at, at] += max(0.0, self.size * roll_bend(self.size * float(xi[ROLL_AT])) * float(g[at]))
        D, delta = self.to_evidence(phi, xi)
        pull = self.info @ delta
        H[:P, :P] += D.T @ self.info @ D
        g[:P] += D.T @ (pull + self.grad)
        info, off = self.nuisance_info(walk), xi - self.xi0
        H[p:, p:] += info
        g[p:] += info @ off
        g -= self.by_noise
        cost -= float(self.by_noise @ np.concatenate([phi, xi]))
        prior = self.sought.info @ (phi - self.sought.mean) ** 2 + xi[:V] @ xi[:V]
        cost += float(0.5 * delta @ pull + self.grad @ delta + 0.5 * off @ info @ off + 0.5 * prior)
        return Point(phi, xi, *seen, H, g, cost, np.concatenate([phi, xi])[self.moving])

    def keep_root(self, point: Point, other: bool) -> None:
        """From now on, the cells of `point` are meant, of the better root or of the `other`, which is better then."""
        self.carry(point.phi, point.xi)
        self.cores.keep(other)

    def lumped_slopes(self, phi: Floats, warmth: float, of_B: float = 1.0) -> Floats:
        """Slope (P, P) of (z, v) by (φ, v), z with R_e at a `warmth` and B times `of_B`."""
        D = np.eye(self.P)
        D[: self.p, : self.p] = lumped_jacobian(phi, self.model.has_conduction)
        D[: self.p, self.p + WARMTH_AT] = D[: self.p, R_E] * self.B_unit * warmth
        D[self.p + WARMTH_AT, self.p + WARMTH_AT] = of_B
        return D

    def to_evidence(self, phi: Floats, xi: Floats) -> tuple[Floats, Floats]:
        """Slope (P, P) of the evidence's coordinates (z, v) by (φ, v), and their distance from its origin (P,)."""
        more, of_B = self.cores.known()
        D, v = self.lumped_slopes(phi, self.evidence.warmth + more, of_B), xi[:V].copy()
        z = lumped(phi, self.model.has_conduction) - self.evidence.z0 + D[: self.p, self.p + WARMTH_AT] * v[WARMTH_AT]
        v[WARMTH_AT] *= of_B
        return D, np.concatenate([z, v])

    def at(self, phi: Floats, xi: Floats, whitener: Whitener, walk: float) -> Point:
        """Simulate, and compute Hessian and gradient."""
        seen = self.simulate(phi, xi)
        return self.assemble(phi, xi, seen, self.normal(*seen[:2], whitener), walk)

    def posterior(self, point: Point) -> Quadratic:
        """Posterior over the free numbers, including the prior."""
        H, g, P = point.H.copy(), point.g.copy(), self.P
        info, pull = self.prior(point)
        H[np.arange(P), np.arange(P)] += info
        g[:P] += pull
        return Quadratic(H[np.ix_(self.moving, self.moving)], -g[self.moving])

    def prior(self, point: Point) -> tuple[Floats, Floats]:
        """Diagonal information (P,) of the prior over (φ, v), and its gradient (P,) at a point."""
        info = np.append(self.sought.info, np.ones(V))
        return info, info * np.concatenate([point.phi - self.sought.mean, point.xi[:V]])

    def minimise(self, phi: Floats, xi: Floats, sizes: Sizes, scale: float, most: int) -> Point:
        """Minimise from (φ, ξ) with the noise times `scale`."""
        self.carry(phi, xi)
        valley = _Noisy(self, self.whitener(sizes, scale), sizes.walk)
        patience = Patience(most, 2e-3 if scale == 1.0 else 0.2, reuse=False)
        return descend(valley, self.at(phi, xi, valley.whitener, sizes.walk), PACE, patience)[0]

    def profile(self, phi: Floats, xi: Floats, sizes: Sizes) -> float:
        """Return −ln of the posterior at fixed φ with the best nuisances, from ξ by one linear step."""
        self.carry(phi, xi)
        here = self.at(phi, xi, self.whitener(sizes), sizes.walk)
        q, first = self.posterior(here), len(self.sought.free)
        return here.cost - 0.5 * Quadratic(q.H[first:, first:], q.pull[first:]).promise

    def choose(self, at: Point, white_floor: float) -> Sizes:
        """Sizes with the largest marginal likelihood, all else integrated out about `at`."""
        white = white_sd(at.residual, white_floor)
        best, chosen = np.inf, Sizes(white, SIZES[0], TAUS[0], WALKS[0])
        for slow in SIZES:
            for tau in TAUS:
                W = self.whitener(Sizes(white, slow, tau, WALKS[0]))
                M = self.normal(at.residual, at.columns, W)
                for walk in WALKS:
                    point = self.assemble(at.phi, at.xi, (at.residual, at.columns, at.end), M, walk)
                    score = self.posterior(point).integrated(point.deviance) + W.log_det + 2.0 * self.J * np.log(walk)
                    if score < best:
                        best, chosen = score, Sizes(white, slow, tau, walk)
        return chosen

    def hear_noise(self, at: Point, sizes: Sizes) -> None:
        """Subtract from now on the addition of the inlet's noise to the squares about `at`, except for a constant."""
        if self.noise == 0.0:
            return
        W = self.whitener(sizes)
        swing = 1.0 + float(at.xi[-1])
        slopes = self.noise**2 * slopes_by_noise(
            self.sets(at.phi),
            STEP,
            len(self.means.seen),
            self.inputs.dt,
            swing,
            Sight(self.means.sensed, lambda Y: W(self.means.read(Y))),
        )
        heard = float(np.sum(W(at.columns[:, :, -1:]) ** 2))
        self.by_noise[: self.p], self.by_noise[-1] = slopes[:-1], of_swing(float(slopes[-1]), heard)

    def score(self, point: Point) -> float:
        """−ln of the posterior mass about a mode (Laplace), up to a constant.

        The promise of one more step is not included: between two roots, the step leads to the other root.
        """
        return point.cost + 0.5 * self.posterior(point).log_det

    def marginal(self, point: Point) -> Quadratic:
        """Posterior of (φ, v), the window's nuisances integrated out, without the prior."""
        return Quadratic(point.H, -point.g).marginal(np.arange(self.P))

    def with_cells(self, point: Point, sizes: Sizes) -> Quadratic:
        """Posterior as of `marginal`, over (φ, v) and the differences u of single cells."""
        P, r = self.P, len(point.g)
        base = string_parameters(self.model, self.sought.names, point.phi)
        f = self.means.read(self.respond([base, *unlike(base, STEP)], point.xi).surface.transpose(1, 2, 0))
        by_cell = ((f[:, :, 1:] - f[:, :, :1]) / STEP).reshape(*f.shape[:2], len(UNLIKE), self.model.cells)
        by_cell = self.unlike_sd[:, None] * (by_cell - by_cell.mean(axis=3, keepdims=True))
        columns = np.concatenate([point.columns, by_cell.reshape(*f.shape[:2], -1)], axis=2)
        W = self.whitener(sizes)
        M = self.normal(point.residual, columns, W)
        H, g = M[:-1, :-1].copy(), -M[:-1, -1]
        H[:r, :r], g[:r] = point.H, point.g
        carried = self.evidence
        D, delta = self.to_evidence(point.phi, point.xi)
        cross = D.T @ carried.info[:P, P:]
        H[:P, r:] += cross
        H[r:, :P] += cross.T
        H[r:, r:] += carried.info[P:, P:]
        g[r:] += carried.info[P:, :P] @ delta + carried.grad[P:]
        return Quadratic(H, -g).marginal(np.r_[:P, r : len(g)])

    def mean_of_cells(self, point: Point, cells: Quadratic) -> tuple[Floats, Floats]:
        """Step of (φ, v) from the mode, and covariance there, with u integrated out of `with_cells`."""
        known = np.ones(len(cells.pull))
        known[: self.P] = 0.0
        q = Quadratic(cells.H + np.diag(known), cells.pull).marginal(np.arange(self.P))
        cov = self._inverted(q.H)
        return cov @ (q.pull - self.prior(point)[1]), cov

    def covariance(self, point: Point) -> Floats:
        """Posterior covariance of (φ, v) at a mode; zero for fixed numbers."""
        return self._inverted(self.marginal(point).H)

    def _inverted(self, info: Floats) -> Floats:
        """Covariance (P, P) from an information with the prior added; zero for fixed numbers."""
        post = info + np.diag(np.append(self.sought.info, np.ones(V)))
        cov = np.zeros_like(post)
        part = np.ix_(self.lasting, self.lasting)
        cov[part] = np.linalg.inv(post[part])
        return 0.5 * (cov + cov.T)

    def noisier(self, point: Point, mean: Floats, sizes: Sizes) -> float:
        """Factor on the noise with which all numbers would lie near their prior (`doubt`).

        Parameters
        ----------
        point : Point
        mean : ndarray (p,)
            φ of both roots.
        sizes : Sizes
        """
        sound = np.array([sound_sd(s) for s in (*self.sought.names, *NAMES)])[self.lasting]
        sd = np.append(self.sought.info, np.ones(V))[self.lasting] ** -0.5
        off = np.append(mean - self.sought.mean, point.xi[:V])[self.lasting]
        if not len(self.sought.free) or np.all(np.abs(off) <= sound * sd):
            return 1.0  # nearly always: nothing has to be checked
        part = np.ix_(self.lasting, self.lasting)
        known = np.diag(sd**-2)
        if self.model.cells == 1:
            info = self.marginal(point).H[part]
        else:  # the effect of unequal cells on the mean is no model error
            step, cov = self.mean_of_cells(point, self.with_cells(point, sizes))
            off, info = off + step[self.lasting], np.linalg.inv(cov[part]) - known
        return noise_factor(info, known, off, np.eye(len(off)), sound * sd)


class _Noisy:
    """The deviance of a window over the free part of (φ, ξ), for one noise."""

    def __init__(self, problem: Problem, whitener: Whitener, walk: float) -> None:
        self.problem, self.whitener, self.walk = problem, whitener, walk
        least, most = np.outer((-np.inf, np.inf), np.ones(len(problem.xi0)))
        if problem.size > 0.0:
            least[WARMTH_AT], most[WARMTH_AT] = LEAST_B / problem.B_unit, MOST_B / problem.B_unit
        self.lower = np.concatenate([problem.sought.low, least])[problem.moving]
        self.upper = np.concatenate([problem.sought.high, most])[problem.moving]

    def at(self, z: Floats, near: Point) -> Point | None:
        """Simulate; None if there is no coolant node."""
        p = self.problem
        all_of = np.concatenate([near.phi, near.xi])
        all_of[p.moving] = z
        phi, xi = all_of[: p.p], all_of[p.p :]
        return p.at(phi, xi, self.whitener, self.walk) if p.feasible(phi) else None

    def slopes(self, here: Point, fresh: bool) -> Quadratic:  # noqa: ARG002 - a point has its own columns
        return self.problem.posterior(here)

    def stiffness(self, H: Floats) -> Floats:
        """Return Levenberg's damping, on φ alone: all else is nearly linear."""
        f = len(self.problem.sought.free)
        out = np.zeros(len(H))
        out[:f] = np.max(np.diag(H)[:f], initial=1.0)
        return out

    def share(self, z: Floats, step: Floats) -> float:  # noqa: ARG002 - as far from everywhere
        return min(1.0, STEEP / max(float(np.max(np.abs(step[: len(self.problem.sought.free)]), initial=0.0)), STEEP))
