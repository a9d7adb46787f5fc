r"""Kalman filter of stacked strings: readings may be late, missing or back again; less work when nothing changes.

A reading of age a belongs between the previous state and this one. With the lag w = a/dt the predicted reading is
ŷ = (1−w) C x_k + w C x_{k−1}, and because x_k = A x_{k−1} + …, with P the covariance before the step and
P⁻ = A P Aᵀ + Q after it,

.. math::
    U &= (1-w)\, P^- C^T + w\, A P\, C^T \\
    S &= (1-w)^2 C P^- C^T + w(1-w)\, C (A P + P A^T) C^T + w^2 C P C^T + R \\
    K &= U S^{-1}, \qquad P^+ = P^- - U S^{-1} U^T

which is the exact filter of the interpolated output. The last product is formed as WᵀW with W = L⁻¹Uᵀ, S = LLᵀ, so
that P stays symmetric.

Gain and covariance do not depend on the values of the readings, only on which readings come. While the same readings
come (same lag to a fifth of a step), changes become ever slower. After `EVERY` steps the covariance is therefore
updated exactly in strides (`strides`), which grow with the time since the last change and with calm
(`covariance_steps`). Between strides, gain and covariance are those of the last stride, late by at most 1/32 of that
time. A variance that grows from zero in proportion to time is thus stated 3 % too small, its band 1.5 %, others by
less; a shrinking variance is stated too large by as little.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from bms_gateway.observe.covariance_steps import EVERY, LAG_HOLD, LAG_STEPS, Calm, due, stilled
from bms_gateway.observe.innovation_check import possible
from bms_gateway.observe.model import OFFSETS, Bools, Ints, StackedModel
from bms_gateway.observe.strides import Ladder, Stride
from bms_gateway.thermal import Floats

NONE = -1
"""Lag quarter of a reading that is missing."""


@dataclass(frozen=True, slots=True)
class KalmanState:
    """All that the filter carries from one step to the next.

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
        Steps for which the pattern has held; strides in which nothing moved count twice.
    since : ndarray of int (S,)
        Steps with this pattern that `P` has not made yet.
    """

    x: Floats
    P: Floats
    K: Floats
    S: Floats
    pattern: Ints
    held: Ints
    since: Ints

    def begun(self, at: Ints, x: Floats, P: Floats) -> "KalmanState":
        """Return the state with `x` (S, M) and `P` in which the strings `at` begin now."""
        held, pattern, since = self.held.copy(), self.pattern.copy(), self.since.copy()
        held[at], pattern[at], since[at] = 0, NONE, 0
        return replace(self, x=x, P=P, held=held, pattern=pattern, since=since)


@dataclass(frozen=True, slots=True)
class Predicted:
    """A state carried to the next instant, before that instant's readings.

    Attributes
    ----------
    before : KalmanState
        One step ago.
    u : ndarray (S, M + n + 2)
        Mean of `before` with the inputs of the step, in the order of `StackedModel.inputs`.
    x : ndarray (S, M)
    known : ndarray of bool (S, 2)
        Whether inlet and current were measured.
    """

    before: KalmanState
    u: Floats
    x: Floats
    known: Bools


@dataclass(frozen=True, slots=True)
class Innovation:
    """Innovations of the readings.

    Attributes
    ----------
    value : ndarray (S, m), K
        y − ŷ; NaN where there was no reading.
    sd : ndarray (S, m), K
        Standard deviation of `value`; `value / sd` is white with unit variance while the model holds.
    lag : ndarray (S, m)
        Age of the reading as a share of the step; 0 where there was none.
    """

    value: Floats
    sd: Floats
    lag: Floats


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
    strides : bool
        Whether the covariance may advance in strides; False gives the reference.
    ladder : Ladder
        Strides that are already computed; not part of the state.
    cell, surface : ndarray of int (S, m)
        Places of the sensed cells among (S, n) values in one row, and of their surfaces among (S, M) states.
    calm : Calm
        Kind of the newest step; not part of the state.

    References
    ----------
    In place of the constant gain of Lin et al., Fig 5 and 9.
    """

    model: StackedModel
    sensors: Ints
    fitted: Bools
    strides: bool = True
    ladder: Ladder = field(init=False, repr=False, compare=False)
    cell: Ints = field(init=False, repr=False, compare=False)
    surface: Ints = field(init=False, repr=False, compare=False)
    calm: Calm = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        row = np.arange(self.model.strings)[:, None]
        object.__setattr__(self, "cell", row * self.model.cells + self.sensors)
        object.__setattr__(self, "surface", row * self.model.states + 2 * self.sensors + 1)
        object.__setattr__(self, "calm", Calm())
        ladder = Ladder(self.model.strings, self.model.states, self.sensors.shape[1] + OFFSETS)
        object.__setattr__(self, "ladder", ladder)

    def exchanged(self, at: Ints, part: StackedModel) -> "Kalman":
        """Replace the models of the strings `at` by those of `part`; none of their steps may be outstanding."""
        new = replace(self, model=self.model.exchanged(at, part))
        self.ladder.forget(at)
        object.__setattr__(new, "ladder", self.ladder)
        return new

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
            np.zeros(strings, np.int64),
        )

    def turned(self, state: KalmanState, known: Bools) -> Bools | None:
        """Return the inputs (S, 2) that the coming step gains or loses against the last one; None for none.

        A string's first step is compared with a step in which all inputs are measured.
        """
        if self.calm.knew(state.held, known):
            return None
        news = known != ((state.pattern[:, -OFFSETS:] != NONE) | (state.held == 0)[:, None])
        return news if news.any() else None

    def predict(
        self, state: KalmanState, heat: Floats, inlet0: Floats, inlet1: Floats, known: Bools | None = None
    ) -> Predicted:
        """Advance one step.

        Parameters
        ----------
        state : KalmanState
        heat : ndarray (S, n), W
        inlet0, inlet1 : ndarray (S,), °C
            Finite: where an inlet is not known, the caller gives its last value.
        known : ndarray of bool (S, 2), optional
            Whether inlet and current are measured (all, by default). False widens their noise. The caller has changed
            the state for an input that is back or lost (`turned`), because its offset belongs to the measurement.

        Returns
        -------
        Predicted
        """
        if known is None:
            known = np.ones((len(state.x), OFFSETS), np.bool_)
        u = self.model.inputs(state.x, heat, inlet0, inlet1)
        return Predicted(state, u, self.model.moved(u), known)

    def update(self, predicted: Predicted, y: Floats, age: Floats) -> tuple[KalmanState, Innovation]:
        """Use the readings; without any reading the covariance still advances.

        Parameters
        ----------
        predicted : Predicted
        y : ndarray (S, n), °C
            NaN where there is no new reading.
        age : ndarray (S, n), s
            Instant of the state minus instant of the reading, 0…dt; greater ages count as dt.

        Returns
        -------
        KalmanState, Innovation
        """
        before = predicted.before
        reading = y.take(self.cell)
        there = np.isfinite(reading) & self.fitted
        lag = np.where(there, self.lag(age), 0.0)
        calm = self.calm
        if calm.goes_on(before.held, before.since, there, predicted.known, lag):
            state, held, since = before, before.held + 1, before.since + 1
            calm.passed(held, since)
        else:
            state = self._changed(before, there, lag, predicted.known)
            held, since, calm.sd = state.held, state.since, np.where(there, np.sqrt(state.S), np.nan)
        assert calm.sd is not None  # noqa: S101 - set with every change
        now = predicted.x.take(self.surface)
        r = reading - (now + lag * (before.x.take(self.surface) - now))
        x = predicted.x + np.matmul(state.K, np.where(there, r, 0.0)[:, :, None])[:, :, 0]
        state = KalmanState(x, state.P, state.K, state.S, state.pattern, held, since)
        return state, Innovation(np.where(there, r, np.nan), calm.sd, lag)

    def _changed(self, before: KalmanState, there: Bools, lag: Floats, known: Bools) -> KalmanState:
        """Update covariance and gain, not the mean, if the set of readings has changed or a stride is due."""
        pattern = self._pattern(before.pattern, there, lag, known)
        same = (pattern == before.pattern).all(axis=1)
        held = np.where(same, before.held + 1, 1)
        now = due(held, before.since) if self.strides else np.ones(len(held), np.bool_)
        since = np.where(now, 0, before.since + 1)
        state = KalmanState(before.x, before.P, before.K, before.S, pattern, held, since)
        if now.any():
            live = np.flatnonzero(now)
            state = self._covariance(before, state, live)
            stride = live[same[live] & (before.since[live] > 0)]
            state = replace(state, held=_put(held, stride, stilled(held[stride], before.P[stride], state.P[stride])))
        if self.strides:
            self.calm.begin(state.held, since, there, known, pattern)
        return state

    def lag(self, age: Floats) -> Floats:
        """Ages (S, n) s of the sensed cells as shares of the step, (S, m), 0…1; an unknown age counts as zero."""
        return np.fmin(np.fmax(age.take(self.cell) / self.model.dt, 0.0), 1.0)

    @staticmethod
    def _pattern(old: Ints, there: Bools, lag: Floats, known: Bools) -> Ints:
        quarter = old[:, :-OFFSETS]
        keep = (quarter != NONE) & (np.abs(lag - quarter / LAG_STEPS) <= LAG_HOLD)
        quarter = np.where(keep, quarter, np.rint(lag * LAG_STEPS).astype(np.int64))
        new = np.full(old.shape, NONE)
        np.copyto(new[:, :-OFFSETS], quarter, where=there)
        np.copyto(new[:, -OFFSETS:], 0, where=known)
        return new

    def loosened(self, state: KalmanState, grown: Floats) -> KalmanState:
        """Increase the variances of the cores under the sensors by `grown` (S, m), K², after a step."""
        at = np.flatnonzero(grown.any(axis=1))
        if not len(at):
            return state
        state = self.caught_up(state, at)
        P, held = state.P.copy(), state.held.copy()
        core = 2 * self.sensors[at]
        where = at[:, None], core, core
        np.add.at(P, where, np.where(self.fitted[at], possible(grown[at], P[where]), 0.0))
        held[at] = np.minimum(held[at], EVERY - 1)  # the next steps are computed one by one
        return replace(state, P=P, held=held)

    def caught_up(self, state: KalmanState, at: Ints) -> KalmanState:
        """Make the outstanding steps of the covariances of the strings `at`."""
        at = at[state.since[at] > 0]
        if not len(at):
            return state
        P = self.ladder.advanced(state.P[at], at, state.pattern[at], state.since[at], self._one)
        P = _put(state.P, at, P)
        return replace(state, P=P, since=_put(state.since, at, np.zeros(len(at), np.int64)))

    def _one(self, pattern: Ints, at: Ints) -> Stride:
        quarter, known = pattern[:, :-OFFSETS], pattern[:, -OFFSETS:] != NONE
        there = quarter != NONE
        w = np.where(there, quarter, 0) / LAG_STEPS
        Q = self.model.noise(at, known)
        return Stride.one(self.model.A[at], Q, 2 * self.sensors[at] + 1, there, w, self.model.disturbance.sensor)

    def _covariance(self, before: KalmanState, state: KalmanState, live: Ints) -> KalmanState:
        """Advance and update the covariance of the strings `live`."""
        A, P0 = self.model.A[live], self.caught_up(before, live).P[live]
        AP = np.matmul(A, P0)
        P = np.matmul(AP, A.swapaxes(1, 2)) + self.model.noise(live, state.pattern[live, -OFFSETS:] != NONE)
        P = (P + P.swapaxes(1, 2)) / 2.0
        P, K, S = _condition(
            P, AP, P0, 2 * self.sensors[live] + 1, state.pattern[live, :-OFFSETS], self.model.disturbance.sensor
        )
        return replace(state, P=_put(state.P, live, P), K=_put(state.K, live, K), S=_put(state.S, live, S))

    def propagate(
        self, state: KalmanState, gap: StackedModel, inlet0: Floats, inlet1: Floats, *, unseen: bool = False
    ) -> KalmanState:
        """Carry the state over a gap in one exact step, with no heat but the state's own and no readings.

        Parameters
        ----------
        state : KalmanState
        gap : StackedModel
            The same strings, discretised with the length of the gap (`stack(parameters, gap_s, …)`).
        inlet0, inlet1 : ndarray (S,), °C
            Inlet before and after; it may have strayed from the straight line between them by up to
            `Disturbance.inlet_unknown`.
        unseen : bool
            Whether current may have flowed.

        Returns
        -------
        KalmanState
            Long gaps end in the covariance of a rested string.
        """
        strings, n = len(state.x), self.model.cells
        state = self.caught_up(state, np.arange(strings))
        x = gap.advance(state.x, np.zeros((strings, n)), inlet0, inlet1)
        Q = gap.noise(np.arange(strings), np.tile([False, True], (strings, 1)))
        P = np.matmul(np.matmul(gap.A, state.P), gap.A.swapaxes(1, 2)) + Q
        fresh = self.init(x, (P + P.swapaxes(1, 2)) / 2.0)
        if not unseen:
            fresh.pattern[:, -1] = 0
        return replace(fresh, held=np.ones(strings, np.int64))


def _put(array: np.ndarray, at: Ints, values: np.ndarray) -> np.ndarray:
    if len(at) == len(array):
        return values
    changed = array.copy()
    changed[at] = values
    return changed


def _condition(
    P: Floats, AP: Floats, P0: Floats, surface: Ints, quarter: Ints, sd: float
) -> tuple[Floats, Floats, Floats]:
    """Condition `P` on the present readings; return it with the gain and the variance of the innovations."""
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
    # in the memory order that a restored state also has: the last bits of a product depend on it
    K = np.ascontiguousarray(np.linalg.solve(L.swapaxes(1, 2), W).swapaxes(1, 2))
    return P - np.matmul(W.swapaxes(1, 2), W), K, S[:, m, m]
