r"""Kalman filter of stacked strings: readings that are late, missing or back again; a steady gain once it is steady.

A reading of age a belongs between the previous state and this one. With the lag w = a/dt the predicted reading is
ŷ = (1−w) C x_k + w C x_{k−1}, and because x_k = A x_{k−1} + …, with P the covariance before the step and
P⁻ = A P Aᵀ + Q after it,

.. math::
    U &= (1-w)\, P^- C^T + w\, A P\, C^T \\
    S &= (1-w)^2 C P^- C^T + w(1-w)\, C (A P + P A^T) C^T + w^2 C P C^T + R \\
    K &= U S^{-1}, \qquad P^+ = P^- - U S^{-1} U^T

which is the exact filter of the interpolated output. The last product is formed as WᵀW with W = L⁻¹Uᵀ, S = LLᵀ, so
that P stays symmetric.

The gain does not depend on the readings, only on which there are. After `MARK` steps with the same readings present
(same lag to a fifth of a step) the change of the covariance is compared with the change over the `MARK` steps before;
when the geometric rest is below `STEADY` the string keeps its gain and its covariance until something changes.
"""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.observe.model import OFFSETS, Bools, Ints, StackedModel
from bms_gateway.observe.open_loop import predicted_surface
from bms_gateway.thermal import Floats

MARK = 64
"""Steps between looks at the covariance: long against the fast pole (9 s), short against the slow one (557 s)."""
STEADY = 0.01
"""Rest of any variance, as a share of it, that is given up when the gain is frozen: half a per cent of a band."""
LAG_STEPS = 4
"""The covariance sees lags in quarters of a step: jitter of the bus then does not make another filter."""
LAG_HOLD = 0.2
"""A quarter is kept until the lag is further from it than this: more than half a quarter, so that it cannot flap."""
NONE = -1
"""Lag quarter of a reading that is missing."""


@dataclass(frozen=True, slots=True)
class KalmanState:
    """Everything the filter carries from one step to the next.

    Attributes
    ----------
    x : ndarray (S, M)
        Estimate, °C; the two offsets last (K and W).
    P : ndarray (S, M, M)
    K : ndarray (S, M, m)
        Gain of the last update.
    S : ndarray (S, m)
        Variance of the innovations at the last update, K²; NaN before the first.
    pattern : ndarray of int (S, m + 2)
        Lag quarter of each sensor or `NONE`; then the same for inlet and current, 0 where measured.
    held : ndarray of int (S,)
        Steps for which the pattern has held.
    mark, drift : ndarray (S, M), (S,)
        Variances at the last look and their greatest relative change between the last two looks.
    steady : ndarray of bool (S,)
    """

    x: Floats
    P: Floats
    K: Floats
    S: Floats
    pattern: Ints
    held: Ints
    mark: Floats
    drift: Floats
    steady: Bools


@dataclass(frozen=True, slots=True)
class Predicted:
    """A state carried to the next instant, before that instant's readings.

    Attributes
    ----------
    before : KalmanState
        One step ago.
    x : ndarray (S, M)
    known : ndarray of bool (S, 2)
        Whether inlet and current were measured.
    """

    before: KalmanState
    x: Floats
    known: Bools


@dataclass(frozen=True, slots=True)
class Innovation:
    """What the readings said beyond the prediction.

    Attributes
    ----------
    value : ndarray (S, m), K
        y − ŷ; NaN where there was no reading.
    sd : ndarray (S, m), K
        What it should be; `value / sd` is white with unit variance while the model holds.
    """

    value: Floats
    sd: Floats


@dataclass(frozen=True, slots=True)
class Kalman:
    """Filter with full covariance.

    Attributes
    ----------
    model : StackedModel
    sensors : ndarray of int (S, m)
        0-based cells that can have a reading; `fitted` tells which columns count.
    fitted : ndarray of bool (S, m)
        False where a string has fewer than m sensors.
    cache : bool
        Whether a steady string skips its covariance; False gives the reference.
    """

    model: StackedModel
    sensors: Ints
    fitted: Bools
    cache: bool = True

    def init(self, x: Floats, P: Floats) -> KalmanState:
        """Start from `x` (S, M) with covariance `P` (S, M, M)."""
        (strings, M), m = x.shape, self.sensors.shape[1]
        return KalmanState(
            x.copy(),
            P.copy(),
            np.zeros((strings, M, m)),
            np.full((strings, m), np.nan),
            np.full((strings, m + OFFSETS), NONE),
            np.zeros(strings, np.int64),
            np.zeros((strings, M)),
            np.full(strings, np.inf),
            np.zeros(strings, np.bool_),
        )

    def predict(
        self, state: KalmanState, heat: Floats, inlet0: Floats, inlet1: Floats, known: Bools | None = None
    ) -> Predicted:
        """Advance one step.

        Parameters
        ----------
        state : KalmanState
        heat : ndarray (S, n), W
        inlet0, inlet1 : ndarray (S,), °C
            Finite: the caller holds the last one where it is not known.
        known : ndarray of bool (S, 2), optional
            Whether inlet and current are measured (all, by default). False widens their noise; when one comes back its
            offset starts anew, because it belongs to the new measurement.

        Returns
        -------
        Predicted
        """
        if known is None:
            known = np.ones((len(state.x), OFFSETS), np.bool_)
        back = known & (state.pattern[:, -OFFSETS:] == NONE) & (state.held > 0)[:, None]
        if back.any():
            d = self.model.disturbance
            state = _restarted(state, back, (d.inlet, d.heat_common))
        return Predicted(state, self.model.advance(state.x, heat, inlet0, inlet1), known)

    def update(self, predicted: Predicted, y: Floats, age: Floats) -> tuple[KalmanState, Innovation]:
        """Take the readings in; with none at all the covariance still advances.

        Parameters
        ----------
        predicted : Predicted
        y : ndarray (S, n), °C
            NaN where there is no new reading.
        age : ndarray (S, n), s
            Instant of the state less instant of the reading, 0…dt; what is older counts as dt.

        Returns
        -------
        KalmanState, Innovation
        """
        before = predicted.before
        reading = np.take_along_axis(y, self.sensors, 1)
        there = np.isfinite(reading) & self.fitted
        lag = np.where(there, self.lag(age), 0.0)
        pattern = self._pattern(before.pattern, there, lag, predicted.known)
        same = (pattern == before.pattern).all(axis=1)
        steady = before.steady & same
        state = replace(before, x=predicted.x, pattern=pattern, held=np.where(same, before.held + 1, 1), steady=steady)
        if not steady.all():
            state = self._covariance(before, state, np.flatnonzero(~steady))
        r = reading - predicted_surface(predicted.x, before.x, self.sensors, lag)
        r = np.where(there, r, np.nan)
        x = predicted.x + np.matmul(state.K, np.where(there, r, 0.0)[:, :, None])[:, :, 0]
        return replace(state, x=x), Innovation(r, np.sqrt(np.where(there, state.S, np.nan)))

    def lag(self, age: Floats) -> Floats:
        """Ages (S, n) s of the sensed cells as shares of the step, (S, m), 0…1; an unknown age counts as none."""
        return np.fmin(np.fmax(np.take_along_axis(age, self.sensors, 1) / self.model.dt, 0.0), 1.0)

    @staticmethod
    def _pattern(old: Ints, there: Bools, lag: Floats, known: Bools) -> Ints:
        quarter = old[:, :-OFFSETS]
        keep = (quarter != NONE) & (np.abs(lag - quarter / LAG_STEPS) <= LAG_HOLD)
        quarter = np.where(keep, quarter, np.rint(lag * LAG_STEPS).astype(np.int64))
        return np.concatenate((np.where(there, quarter, NONE), np.where(known, 0, NONE)), axis=1)

    def _covariance(self, before: KalmanState, state: KalmanState, live: Ints) -> KalmanState:
        """Advance and update the covariance of the strings `live`, and look whether it has become steady."""
        A, P0 = self.model.A[live], before.P[live]
        AP = np.matmul(A, P0)
        P = np.matmul(AP, A.swapaxes(1, 2)) + self.model.noise(live, state.pattern[live, -OFFSETS:] != NONE)
        P = (P + P.swapaxes(1, 2)) / 2.0
        P, K, S = _condition(
            P, AP, P0, 2 * self.sensors[live] + 1, state.pattern[live, :-OFFSETS], self.model.disturbance.sensor
        )
        new = replace(
            state,
            P=_put(state.P, live, P),
            K=_put(state.K, live, K),
            S=_put(state.S, live, S),
        )
        return self._look(before, new, live) if self.cache else new

    @staticmethod
    def _look(before: KalmanState, state: KalmanState, live: Ints) -> KalmanState:
        at = live[state.held[live] % MARK == 0]
        first = live[state.held[live] == 1]
        if not len(at) and not len(first):
            return state
        drift = _put(before.drift, first, np.full(len(first), np.inf))
        var = np.einsum("sii->si", state.P[at])
        change = (np.abs(var - before.mark[at]) / np.maximum(var, np.finfo(np.float64).tiny)).max(axis=1, initial=0.0)
        last = drift[at]
        shrink = np.where(np.isfinite(last) & (last > 0.0), change / np.where(last > 0.0, last, 1.0), np.inf)
        rest = np.where(shrink < 1.0, change * shrink / np.where(shrink < 1.0, 1.0 - shrink, 1.0), np.inf)
        settled = (state.held[at] >= 3 * MARK) & ((rest <= STEADY) | (change <= 1e-3 * STEADY))
        return replace(
            state,
            mark=_put(before.mark, at, var),
            drift=_put(drift, at, change),
            steady=_put(state.steady, at, settled),
        )

    def propagate(self, state: KalmanState, gap: StackedModel, inlet0: Floats, inlet1: Floats) -> KalmanState:
        """Carry the state over a gap with no heat and no readings, in one exact step.

        Parameters
        ----------
        state : KalmanState
        gap : StackedModel
            The same strings, discretised with the length of the gap (`stack(parameters, gap_s, …)`).
        inlet0, inlet1 : ndarray (S,), °C
            Inlet before and after; a straight line between them, from which it may have strayed unseen up to
            `Disturbance.inlet_unknown`.

        Returns
        -------
        KalmanState
            Long gaps end in the covariance of a rested string. The gain is not steady.
        """
        strings, n = len(state.x), self.model.cells
        x = gap.advance(state.x, np.zeros((strings, n)), inlet0, inlet1)
        unseen = np.tile([False, True], (strings, 1))
        Q = gap.noise(np.arange(strings), unseen)
        P = np.matmul(np.matmul(gap.A, state.P), gap.A.swapaxes(1, 2)) + Q
        fresh = self.init(x, (P + P.swapaxes(1, 2)) / 2.0)
        fresh.pattern[:, -1] = 0
        return replace(fresh, held=np.ones(strings, np.int64))


def _put(array: np.ndarray, at: Ints, values: np.ndarray) -> np.ndarray:
    if len(at) == len(array):
        return values
    changed = array.copy()
    changed[at] = values
    return changed


def _restarted(state: KalmanState, back: Bools, sd: tuple[float, float]) -> KalmanState:
    x, P = state.x.copy(), state.P.copy()
    for which in range(OFFSETS):
        s, at = back[:, which], which - OFFSETS
        x[s, at] = 0.0
        P[s, at, :] = 0.0
        P[s, :, at] = 0.0
        P[s, at, at] = sd[which] ** 2
    return replace(state, x=x, P=P, steady=state.steady & ~back.any(axis=1))


def _condition(
    P: Floats, AP: Floats, P0: Floats, surface: Ints, quarter: Ints, sd: float
) -> tuple[Floats, Floats, Floats]:
    """Condition `P` on the readings present; returns it with the gain and the variance of the innovations."""
    there = quarter != NONE
    w = np.where(there, quarter, 0) / LAG_STEPS
    v = 1.0 - w
    row = np.arange(len(P))[:, None]
    i, j, s = surface[:, :, None], surface[:, None, :], row[:, :, None]
    U = (v[:, :, None] * P[row, surface] + w[:, :, None] * AP.swapaxes(1, 2)[row, surface]) * there[:, :, None]
    cross = v[:, :, None] * w[:, None, :] * AP[s, i, j]
    S = v[:, :, None] * v[:, None, :] * P[s, i, j] + cross + cross.swapaxes(1, 2)
    S += w[:, :, None] * w[:, None, :] * P0[s, i, j]
    S = np.where(there[:, :, None] & there[:, None, :], S, 0.0)
    m = np.arange(S.shape[1])
    S[:, m, m] = np.where(there, S[:, m, m] + sd**2, 1.0)
    L = np.linalg.cholesky(S)
    W = np.linalg.solve(L, U)
    K = np.linalg.solve(L.swapaxes(1, 2), W).swapaxes(1, 2)
    return P - np.matmul(W.swapaxes(1, 2), W), K, S[:, m, m]
