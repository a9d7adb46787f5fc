r"""The paper's on-line method: recursive least squares over the filtered regression, as reference.

.. math::
    K = \frac{P\varphi}{f + \varphi^T P \varphi}, \quad \theta^+ = \theta + K (z - \varphi^T\theta), \quad
    P^+ = (P - K \varphi^T P) / f

in scaled signals. Learning stops while |φ|²/m² < 1e-3 with m² = 1 + |φ|², because forgetting while parked would forget
everything. The regressors contain the noise of T_s, so the estimates are biased (R_e −10 % at 0.05 K, on the fold at
0.1 K), and the stated sd, which ignores it, is a lower bound. Use the windowed method on a vehicle.
"""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.identify.contract import (
    FIXED,
    IDENTIFIED,
    LEARNING,
    Estimate,
    Posterior,
    Tick,
    estimates_of,
    log_prior,
    not_identifiable,
)
from bms_gateway.identify.identifiable import C_C, C_S, R_C, R_E, R_U, lumped
from bms_gateway.identify.regression import (
    LAMBDA,
    SCALE,
    Z_SCALE,
    Cell,
    Filter,
    Roots,
    choose_root,
    delta_sd,
    roots,
    unscale,
)
from bms_gateway.identify.regression import with_moving_inlet as one_root
from bms_gateway.identify.ticks import Ticks
from bms_gateway.thermal import Floats, StringModel

Root = Literal["prior", "smaller", "larger"]

P0 = 1e4
"""Start covariance in scaled units: the start is forgotten within three minutes of driving."""
QUIET = 1e-3
"""|φ|²/m² below which nothing is learnt."""
MOVED_K = 0.5
"""K: sd of the inlet over `MEMORY_S` above which s·T_f counts as excited."""
MEMORY_S = 600.0
COLOUR = 2.0 / LAMBDA
"""Steps over which the filter correlates the residual: so many samples count as one in the sd."""


class RecursiveLeastSquares:
    """Eq 5 on scaled signals.

    Parameters
    ----------
    theta : ndarray (c,)
        Start, scaled.
    P : float
        Start covariance.
    forgetting : float
        f, 1 for none.
    normalised : bool
        Divide every row by m, m² = 1 + |φ|², as the paper does: strong excitation then counts no more than weak.

    References
    ----------
    Lin et al., Eq 5, and Eq 4 for m.
    """

    def __init__(self, theta: Floats, P: float = P0, forgetting: float = 1.0, *, normalised: bool = False) -> None:
        self.theta = np.array(theta, dtype=np.float64)
        self.P = P * np.eye(len(theta))
        self.forgetting = forgetting
        self.normalised = normalised
        self.variance = 0.0
        self.count = 0

    def update(self, z: float, phi: Floats) -> bool:
        """Include one row; return False if its excitation was too small."""
        size = float(phi @ phi)
        if size / (1.0 + size) < QUIET:
            return False
        error = z - float(phi @ self.theta)
        row = self.forgetting * (1.0 + size) if self.normalised else self.forgetting
        K = self.P @ phi / (row + float(phi @ self.P @ phi))
        self.theta = self.theta + K * error
        self.P = (self.P - np.outer(K, phi @ self.P)) / self.forgetting
        self.P = 0.5 * (self.P + self.P.T)
        after = z - float(phi @ self.theta)
        self.count += 1
        self.variance += (after * after - self.variance) / min(self.count, 1000)
        return True


class RecursiveIdentifier:
    """The reference method as an `Identifier`; one cell at the coolant inlet without neighbours.

    It works one tick late: the reading at a tick is interpolated between the two readings around it.

    Parameters
    ----------
    model : StringModel
        Its medians are the start.
    P : float
        Start covariance of the scaled coefficients.
    pole : float
        λ_1 = λ_2 of the filter, 1/s.
    forgetting : float
        1 for none.
    normalised : bool
        See `RecursiveLeastSquares`. With P = 100 and a pole of 0.1 it learns at the speed that the paper shows.
    root : {"prior", "smaller", "larger"}
        Root of Eq 9 for a constant inlet: the root on the side of the medians of R_c and R_u, or a known one: the
        smaller if air is forced past the cell, the larger if the air is still.

    References
    ----------
    Lin et al., Eq 5–9.
    """

    learns = True

    def __init__(
        self,
        model: StringModel,
        *,
        P: float = P0,
        pole: float = LAMBDA,
        forgetting: float = 1.0,
        normalised: bool = False,
        root: Root = "prior",
    ) -> None:
        self._names, self._prior_mean, self._prior_sd = log_prior(model)
        self._unlike = _first_cell_from_mean(model, self._names)
        self._fits = model.sensors[:1] == (1,) and (model.cells == 1 or not model.has_conduction)
        z = lumped(self._prior_mean[:5])
        start = np.array([np.exp(z[0]), np.exp(z[1]), -np.exp(z[2]), 0.0, 0.0])
        self._three = RecursiveLeastSquares(
            (start * SCALE / Z_SCALE)[[0, 1, 2, 4]], P, forgetting, normalised=normalised
        )
        start[3] = np.exp(z[3])
        self._four = RecursiveLeastSquares(start * SCALE / Z_SCALE, P, forgetting, normalised=normalised)
        self._root = root
        self._pole = pole
        self._filter: Filter | None = None
        self._before: Tick | None = None
        self._inlet_mean, self._inlet_var, self._learnt = np.nan, 0.0, 0.0

    def add(self, tick: Tick) -> None:
        """Include one tick; never returns a job."""
        before, self._before = self._before, tick
        if not self._fits or before is None:
            return
        t1 = tick.dt - float(tick.age[0])
        t0 = -float(before.age[0])
        T_s = float(before.surface[0] + (tick.surface[0] - before.surface[0]) * -t0 / max(t1 - t0, 1e-3))
        known = np.isfinite([T_s, before.inlet, before.mean_square_current]).all() and abs(tick.dt - before.dt) < 1e-6
        if not known:
            self._filter = None
            return
        if self._filter is None:
            self._filter = Filter(tick.dt, self._pole)
            self._filter.start(T_s, before.inlet)
            for rls in (self._three, self._four):  # a new start has another T_s'(0)
                rls.P[-1, :] = rls.P[:, -1] = 0.0
                rls.P[-1, -1] = P0
                rls.theta[-1] = 0.0
            return
        z, phi = self._filter.step(before.mean_square_current, T_s, before.inlet)
        if self._four.update(z, phi):
            self._learnt += tick.dt
            self._watch_inlet(before.inlet, tick.dt)
        self._three.update(z, phi[[0, 1, 2, 4]])

    def _watch_inlet(self, inlet: float, dt: float) -> None:
        if np.isnan(self._inlet_mean):
            self._inlet_mean = inlet
        share = dt / MEMORY_S
        off = inlet - self._inlet_mean
        self._inlet_mean += share * off
        self._inlet_var += share * (off * off - self._inlet_var)

    def disbelieve(self, cell: int, seconds: float) -> None:
        """Do nothing: no readings are kept."""

    def patience(self, dt: float) -> int:  # noqa: ARG002 — the protocol
        """Return 0: every tick is needed at once."""
        return 0

    def take(self, ticks: Ticks) -> None:
        """Do nothing: no tick waits."""

    def accept(self, result: object) -> None:
        """Do nothing: no job was returned."""

    def _moving(self) -> tuple[bool, RecursiveLeastSquares]:
        """Whether the inlet moves, and the regression for this case."""
        moving = self._inlet_var > MOVED_K**2
        return moving, self._four if moving else self._three

    def _back(self, theta: Floats) -> Cell | None:
        """Find the physical cell of scaled coefficients."""
        C_c, C_s, R_c, R_u = np.exp(self._prior_mean[[C_C, C_S, R_C, R_U]])
        a, b, g = unscale(theta[:3]).tolist()
        if len(theta) == 5:
            return one_root(a, b, g, float(theta[3] * Z_SCALE / SCALE[3]), C_c + C_s)
        return self._choose(roots(a, b, g, C_c, C_s), R_c, R_u)

    def _logarithms(self, theta: Floats) -> Floats | None:
        cell = self._back(theta)
        return None if cell is None else np.log([cell.R_e, cell.R_c, cell.R_u])

    def _physical(self) -> tuple[Floats | None, Floats | None, str]:
        """ln(R_e, R_c, R_u), its sd, and the reason if there is none."""
        moving, rls = self._moving()
        ln = self._logarithms(rls.theta)
        if ln is None:
            if moving:
                return None, None, "a coefficient has the wrong sign"
            C_c, C_s = np.exp(self._prior_mean[[C_C, C_S]])
            a, b, g = unscale(rls.theta[:3]).tolist()
            return None, None, roots(a, b, g, C_c, C_s).why
        sd = delta_sd(self._logarithms, rls.theta, rls.P * rls.variance * COLOUR)
        return ln, sd, "near the fold R_u = R_u*"

    def _choose(self, both: Roots, R_c: float, R_u: float) -> Cell | None:
        if self._root == "prior":
            return choose_root(both, R_c, R_u)
        return both.smaller if self._root == "smaller" else both.larger

    def cell(self) -> Cell | None:
        """Return the cell of the present coefficients, reliable or not; None if Eq 9 has no solution.

        Use `estimates` on a vehicle: it waits until the result is reliable, and states a band.
        """
        return self._back(self._moving()[1].theta)

    def _knowledge(self) -> tuple[Posterior, list[str]]:
        mean, cov = self._prior_mean.copy(), np.diag(self._prior_sd**2)
        status = [FIXED if i not in (R_E, R_C, R_U) else LEARNING for i in range(len(self._names))]
        if not self._fits:
            text = not_identifiable("this method needs a sensed first cell without neighbours")
            status = [text if i in (R_E, R_C, R_U) else s for i, s in enumerate(status)]
        elif self._learnt >= 180.0:
            ln, sd, why = self._physical()
            for j, i in enumerate((R_E, R_C, R_U)):
                if ln is None or sd is None or sd[j] > 0.15:
                    status[i] = not_identifiable(why if sd is None else "too little current")
                    continue
                status[i], mean[i], cov[i, i] = IDENTIFIED, ln[j], sd[j] ** 2 + self._unlike[i]
        return Posterior(self._names, mean, cov), status

    def posterior(self) -> Posterior:
        """Gaussian over the logarithms; the prior for numbers that are not identified."""
        return self._knowledge()[0]

    def estimates(self) -> tuple[Estimate, ...]:
        """Every parameter with sd and status."""
        return estimates_of(*self._knowledge())

    def doubts(self) -> tuple[str, ...]:
        """Return no doubts: this method does not judge the model."""
        return ()

    def snapshot(self) -> dict[str, Any]:
        """Coefficients and covariances as JSON-able values."""
        out: dict[str, Any] = {"method": "rls", "inlet": [self._inlet_mean, self._inlet_var], "learnt": self._learnt}
        if np.isnan(self._inlet_mean):
            out["inlet"] = None
        for name, rls in (("three", self._three), ("four", self._four)):
            out[name] = [rls.theta.tolist(), rls.P.tolist(), rls.variance, rls.count]
        return out

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take a snapshot.

        Raises
        ------
        StateError
            The snapshot is another method's or not finite.
        """
        if state.get("method") != "rls":
            raise StateError("identified parameters: the stored state is of another method; starting anew")
        for name, rls in (("three", self._three), ("four", self._four)):
            theta, P, variance, count = state[name]
            theta, P = np.array(theta, dtype=np.float64), np.array(P, dtype=np.float64)
            if theta.shape != rls.theta.shape or P.shape != rls.P.shape or not np.isfinite(P).all():
                raise StateError("identified parameters: the stored state is damaged; starting anew")
            rls.theta, rls.P, rls.variance, rls.count = theta, P, float(variance), int(count)
        self._inlet_mean, self._inlet_var = state["inlet"] or (np.nan, 0.0)
        self._learnt = float(state["learnt"])
        self._filter, self._before = None, None


def _first_cell_from_mean(model: StringModel, names: tuple[str, ...]) -> Floats:
    """Variance of ln(first cell/mean of all) by the model's tolerances, per parameter: only that cell is sensed."""
    tolerance = np.array([model.tolerances.get(f"cell_{name}", 0.0) for name in names])
    return np.asarray(tolerance**2 * (1.0 - 1.0 / model.cells), dtype=np.float64)
