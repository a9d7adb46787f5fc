r"""Sensitivities in blocks: while gain and matrices stand still, J runs many steps at once.

With one gain K, one lag w and the forcing of the steps' mean, a step of `sensitivity` is J⁺ = E J + V F with

.. math::
    E = (I - (1-w) K C) A - w K C, \qquad V = \tfrac{\Delta t}{2} (I - (1-w) K C)(A + I)

and many steps are one of the same form: after n of them m more make E ← E_m E_n, V ← V_m + E_m V_n. Steps wait, their
means gathered, until `BLOCK` of them are there or something changes; the next one is then made by itself. A band is as
late as the steps that wait.

Beyond Lin et al., whose observer holds its parameters for exact.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bms_gateway.observe.covariance_steps import EVERY, LAG_STEPS
from bms_gateway.observe.kalman import NONE, Kalman, KalmanState, Predicted
from bms_gateway.observe.model import OFFSETS, Bools, Ints
from bms_gateway.observe.sensitivity import PARAMETERS, Flows, carried, corrected
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats

DOUBLINGS = 3
BLOCK = 2 ** (DOUBLINGS + 1) - 1
"""Steps that may wait: far fewer than the time constants of a core, and enough to make them cheap. With the one that
is made by itself they are a power of two, as strides of the covariance are: where these end, none waits."""


class Blocks:
    """Sensitivities of S strings and the steps that they have not made yet.

    Parameters
    ----------
    strings, cells, sensors : int
        Sensors: columns of a gain.

    Attributes
    ----------
    J : ndarray (S, M, p)
        Without the steps that wait.
    waiting : ndarray of int (S,)
        How many those are.
    """

    def __init__(self, strings: int, cells: int, sensors: int) -> None:
        M = 2 * cells + OFFSETS
        self._cells = cells
        self.J = np.zeros((strings, M, len(PARAMETERS)))
        self.waiting = np.zeros(strings, np.int64)
        # sums over the steps that wait: states and inputs before each, states after it, heat that was given
        self._before, self._after = np.zeros((strings, M + cells + OFFSETS)), np.zeros((strings, M))
        self._given = np.zeros((strings, cells))
        # gains that blocks are made with, and how long readings had held when these were taken
        self._K, self._since = np.zeros((strings, M, sensors)), np.zeros(strings, np.int64)
        # of a whole block, made when first wanted; no part of the state
        self._made: Bools = np.zeros(strings, np.bool_)
        self._E, self._V = np.zeros((2, 0, M, M))

    def wait(self, step: Predicted, given: Floats | None) -> None:
        """Let one more step wait, of all strings."""
        self._before += step.u
        self._after += step.x
        if given is not None:
            self._given += given
        self.waiting += 1

    def forget(self, at: Ints, state: KalmanState | None = None) -> None:
        """Strings `at` have other matrices from now on, or other gains than blocks were made with.

        With a state: its gains; between a change of readings and the time when strides have doubled they move too
        little to be made new blocks of.
        """
        if state is not None:
            held = state.held[at]
            at = at[(held <= EVERY) | (held >= 2 * self._since[at]) | (held < self._since[at])]
            self._since[at], self._K[at] = state.held[at], state.K[at]
        self._made[at] = False

    def put(self, at: Ints, J: Floats) -> None:
        """Give the strings `at` sensitivities with no step waiting."""
        self.J[at] = J
        self.waiting[at] = 0
        for total in (self._before, self._after, self._given):
            total[at] = 0.0

    def caught_up(self, at: Ints, flows: Flows, kalman: Kalman, state: KalmanState) -> Floats:
        """Sensitivities (s, M, p) of the strings `at` with the steps that wait made; nothing changes.

        Parameters
        ----------
        at : ndarray of int (s,)
        flows : Flows
        kalman, state : Kalman, KalmanState
            With the matrices, gain and pattern that these steps had.
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
        """Mean forcing (s, M, p) of the steps that wait; each is taken in its middle."""
        M, n = self._after.shape[1], self._cells
        share = 1.0 / self.waiting[at][:, None]
        before, after, given = self._before[at] * share, self._after[at] * share, self._given[at] * share
        inlet = (before[:, -2] + before[:, -1]) / 2.0
        electric = before[:, M : M + n] - given
        return flows.of_strings(at).forcing((before[:, :M] + after) / 2.0, electric, given, inlet)

    def _block(self, at: Ints, kalman: Kalman, state: KalmanState) -> tuple[Floats, Floats]:
        if not len(self._E):
            self._E, self._V = np.zeros((2, len(self.J), *self._E.shape[1:]))
        new = at[~self._made[at]]
        if len(new):
            self._E[new], self._V[new] = _doubled(new, kalman, state, self._K)
            self._made[new] = True
        return chosen(self._E, at), chosen(self._V, at)

    def snapshot(self) -> dict[str, Any]:
        """Return the steps that wait and what they wait for, as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _KEPT}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Take up a snapshot of as many strings of this length.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of them, or holds no numbers.
        """
        taken = {name: like(snapshot[name.strip("_")], getattr(self, name)) for name in _KEPT}
        waiting = taken["waiting"]
        if not all(np.isfinite(a).all() for a in taken.values()) or waiting.min() < 0 or waiting.max() > BLOCK:
            raise ValueError("steps that wait are no numbers")
        for name, value in taken.items():
            setattr(self, name, value)
        self._made[:] = False


def chosen(a: np.ndarray, at: Ints) -> np.ndarray:
    """Take the rows `at`, ascending and each once, of `a`: no copy where these are all."""
    return a if len(at) == len(a) else a[at]


def _lag(state: KalmanState, at: Ints) -> Floats:
    """Lags (s, m) that the pattern stands for, as shares of the step."""
    quarter = state.pattern[at, :-OFFSETS]
    return np.asarray(np.where(quarter == NONE, 0, quarter) / LAG_STEPS, dtype=np.float64)


_KEPT = ("J", "waiting", "_before", "_after", "_given", "_K", "_since")


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
    for _ in range(DOUBLINGS):  # 1, 3, 7, 15 steps: as many again, and one more
        E, V = np.matmul(E, E), V + np.matmul(E, V)
        E, V = np.matmul(one, E), V_one + np.matmul(one, V)
    return E, V
