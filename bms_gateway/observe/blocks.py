r"""Sensitivities in blocks: while gain and matrices stay the same, J makes many steps at once.

With one gain K, one lag w and the mean forcing of the steps, a step of `sensitivity` is J⁺ = E J + V F with

.. math::
    E = (I - (1-w) K C) A - w K C, \qquad V = \tfrac{\Delta t}{2} (I - (1-w) K C)(A + I)

Many steps have the same form: m steps after n steps give E ← E_m E_n, V ← V_m + E_m V_n. Steps wait, and only their
sums are kept, until `BLOCK` of them wait or something changes. The step after them is computed singly. The steps that
wait are not yet in the band.

Beyond Lin et al., whose observer treats its parameters as exact.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bms_gateway.observe.covariance_steps import EVERY, LAG_STEPS
from bms_gateway.observe.kalman import NONE, Kalman, KalmanState, Predicted
from bms_gateway.observe.model import OFFSETS, Bools, Ints
from bms_gateway.observe.reversible import reversible
from bms_gateway.observe.sensitivity import PARAMETERS, Flows, carried, corrected
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats
from bms_gateway.thermal.entropy import ENTROPIC

DOUBLINGS = 3
BLOCK = 2 ** (DOUBLINGS + 1) - 1
"""Steps that may wait: far fewer than the time constants of a core, and enough to make them cheap. Together with the
single step after them they are a power of two, like the strides of the covariance. At the end of a stride, no step
waits."""


class Heat(NamedTuple):
    """What makes the heat of a step in S strings of n cells.

    Attributes
    ----------
    electric : ndarray (S, n), W
        From I²R_e.
    given : ndarray (S, n) or None, W
        Measured otherwise.
    amps : ndarray (S, 2) or None, A
        As of `Reversible.pass_step`.
    """

    electric: Floats
    given: Floats | None
    amps: Floats | None

    @property
    def whole(self) -> Floats:
        """Heat (S, n), W, without the reversible one."""
        return self.electric if self.given is None else self.electric + self.given


class Blocks:
    """Sensitivities of S strings and the steps that they have not made yet (the steps that wait).

    Parameters
    ----------
    strings, states, cells, sensors : int
        S, M, n, and the columns of a gain.

    Attributes
    ----------
    J : ndarray (S, M, p)
        Without the steps that wait.
    waiting : ndarray of int (S,)
        Number of steps that wait.
    """

    def __init__(self, strings: int, states: int, cells: int, sensors: int) -> None:
        M, self._cells = states, cells
        self.J = np.zeros((strings, M, len(PARAMETERS)))
        self.waiting = np.zeros(strings, np.int64)
        # sums over the steps that wait: states and inputs before each, states after it, measured heat, currents
        self._before, self._after = np.zeros((strings, M + cells + OFFSETS)), np.zeros((strings, M))
        self._given, self._amps = np.zeros((strings, cells)), np.zeros((strings, len(ENTROPIC)))
        # gains of the blocks, and for how many steps the pattern of readings had held when they were taken
        self._K, self._since = np.zeros((strings, M, sensors)), np.zeros(strings, np.int64)
        # E and V of a whole block, made when first used; not part of the snapshot
        self._made: Bools = np.zeros(strings, np.bool_)
        self._E, self._V = np.zeros((2, 0, M, M))

    def wait(self, step: Predicted, heat: Heat) -> None:
        """Add one more waiting step to all strings."""
        self._before += step.u
        self._after += step.x
        if heat.given is not None:
            self._given += heat.given
        if heat.amps is not None:
            self._amps += heat.amps
        self.waiting += 1

    def forget(self, at: Ints, state: KalmanState | None = None) -> None:
        """Discard the blocks of the strings `at`, whose matrices or gains have changed.

        With a state, its gains are taken. Until the pattern of readings has held twice as long as at the last time, the
        gains move too little to make new blocks.
        """
        if state is not None:
            held = state.held[at]
            at = at[(held <= EVERY) | (held >= 2 * self._since[at]) | (held < self._since[at])]
            self._since[at], self._K[at] = state.held[at], state.K[at]
        self._made[at] = False

    def put(self, at: Ints, J: Floats) -> None:
        """Set the sensitivities of the strings `at`, with no step waiting."""
        self.J[at] = J
        self.waiting[at] = 0
        for total in (self._before, self._after, self._given, self._amps):
            total[at] = 0.0

    def caught_up(self, at: Ints, flows: Flows, kalman: Kalman, state: KalmanState) -> Floats:
        """Sensitivities (s, M, p) of the strings `at` after the steps that wait; nothing changes.

        Parameters
        ----------
        at : ndarray of int (s,)
        flows : Flows
        kalman, state : Kalman, KalmanState
            With the matrices, gain and pattern of these steps.
        """
        J = self.J[at]  # a copy
        late = np.flatnonzero(self.waiting[at])
        if not len(late):
            return J
        where = at[late]
        count = self.waiting[where]
        F = self._forcing(where, flows)
        whole = np.flatnonzero(count == BLOCK)
        if len(whole):
            E, V = self._block(where[whole], kalman, state)
            J[late[whole]] = np.matmul(E, J[late[whole]]) + np.matmul(V, F[whole])
        part = np.flatnonzero(count < BLOCK)
        for k in range(int(count[part].max(initial=0))):
            now = part[count[part] > k]
            s, before = where[now], J[late[now]]
            on = carried(before, chosen(kalman.model.A, s), F[now], kalman.model.dt)
            J[late[now]], _ = corrected(on, before, chosen(state.K, s), kalman.sensors[s], _lag(state, s))
        return J

    def _forcing(self, at: Ints, flows: Flows) -> Floats:
        """Mean forcing (s, M, p) of the steps that wait; each is evaluated in its middle."""
        M, n = self._after.shape[1], self._cells
        share = 1.0 / self.waiting[at][:, None]
        before, after, given = self._before[at] * share, self._after[at] * share, self._given[at] * share
        inlet, amps, mine = (before[:, -2] + before[:, -1]) / 2.0, self._amps[at] * share, flows.of_strings(at)
        electric = before[:, M : M + n] - given - reversible(mine.entropic, amps, before[:, 0 : 2 * n : 2])
        return mine.forcing((before[:, :M] + after) / 2.0, electric, given, inlet, amps)

    def _block(self, at: Ints, kalman: Kalman, state: KalmanState) -> tuple[Floats, Floats]:
        if not len(self._E):
            self._E, self._V = np.zeros((2, len(self.J), *self._E.shape[1:]))
        new = at[~self._made[at]]
        if len(new):
            self._E[new], self._V[new] = _doubled(new, kalman, state, self._K)
            self._made[new] = True
        return chosen(self._E, at), chosen(self._V, at)

    def snapshot(self) -> dict[str, Any]:
        """Return the steps that wait and the sensitivities, as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _KEPT}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Restore a snapshot of as many strings of this length.

        Raises
        ------
        KeyError, TypeError, ValueError
            `snapshot` is not a snapshot of such blocks, or holds no numbers.
        """
        taken = {name: like(snapshot[name.strip("_")], getattr(self, name)) for name in _KEPT}
        waiting = taken["waiting"]
        if not all(np.isfinite(a).all() for a in taken.values()) or waiting.min() < 0 or waiting.max() > BLOCK:
            raise ValueError("steps that wait are no numbers")
        for name, value in taken.items():
            setattr(self, name, value)
        self._made[:] = False


def chosen(a: np.ndarray, at: Ints) -> np.ndarray:
    """Take the rows `at` (ascending, each once) of `a`, without a copy if these are all rows."""
    return a if len(at) == len(a) else a[at]


def _lag(state: KalmanState, at: Ints) -> Floats:
    """Lags (s, m) of the pattern, as shares of the step."""
    quarter = state.pattern[at, :-OFFSETS]
    return np.asarray(np.where(quarter == NONE, 0, quarter) / LAG_STEPS, dtype=np.float64)


_KEPT = ("J", "waiting", "_before", "_after", "_given", "_amps", "_K", "_since")


def _doubled(at: Ints, kalman: Kalman, state: KalmanState, gain: Floats) -> tuple[Floats, Floats]:
    """Make E and V of a whole block."""
    A, K, w = chosen(kalman.model.A, at), chosen(gain, at), _lag(state, at)[:, None, :]
    surface = 2 * kalman.sensors[at] + 1
    row = np.arange(len(at))[:, None]
    eye = np.eye(A.shape[1])
    late = K * (1.0 - w)
    E = A - np.matmul(late, A[row, surface])
    V = (kalman.model.dt / 2.0) * (A + eye - np.matmul(late, (A + eye)[row, surface]))
    for k in range(surface.shape[1]):
        E[row[:, 0], :, surface[:, k]] -= K[:, :, k] * w[:, :, k]
    one, V_one = E, V
    for _ in range(DOUBLINGS):  # 1, 3, 7, 15 steps: twice as many and one more
        E, V = np.matmul(E, E), V + np.matmul(E, V)
        E, V = np.matmul(one, E), V_one + np.matmul(one, V)
    return E, V
