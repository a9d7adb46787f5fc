r"""Many steps of the covariance at once, exactly, while the same readings come.

Let the readings of a step be functions of the state one step before, H = (1−w) C A + w C, with the part of their noise
that they share with the state removed. One step of the filter is then

.. math::
    P' = N + E\,P\,(I + G\,P)^{-1} E^T

with E the closed loop's transition, G the information of the readings and N the remaining noise. Two such steps have
the same form, so that 2^k steps cost k products instead of 2^k.

References
----------
S. Särkkä, Á. F. García-Fernández, Temporal parallelization of Bayesian smoothers, IEEE TAC 66 (2021), eqs 10 and 13;
the doubling is that of B. D. O. Anderson, J. B. Moore, Optimal Filtering (1979), ch. 6.7.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import Bools, Ints
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Stride:
    """The same number of steps for S strings.

    Attributes
    ----------
    E, G, N : ndarray (S, M, M)
        `G` and `N` symmetric, positive semidefinite.
    """

    E: Floats
    G: Floats
    N: Floats

    @classmethod
    def one(cls, A: Floats, Q: Floats, surface: Ints, there: Bools, w: Floats, sd: float) -> "Stride":
        """One step.

        Parameters
        ----------
        A, Q : ndarray (S, M, M)
            Transition and noise of the step.
        surface : ndarray of int (S, m)
            States that are read.
        there : ndarray of bool (S, m)
            Which readings come.
        w : ndarray (S, m)
            Their lag as a share of the step.
        sd : float, K
            Noise of a reading.
        """
        row, m = np.arange(len(A))[:, None], np.arange(surface.shape[1])
        v = np.where(there, 1.0 - w, 0.0)[:, :, None]
        H = v * A[row, surface]
        H[row, m, surface] += np.where(there, w, 0.0)
        shared = v * Q[row, surface]
        R = shared[row[:, :, None], m[:, None], surface[:, None, :]] * v.swapaxes(1, 2)
        R[:, m, m] += sd**2
        both = np.linalg.solve(R, np.concatenate((H, shared), axis=2))
        M = A.shape[1]
        E = A - np.matmul(shared.swapaxes(1, 2), both[:, :, :M])
        N = Q - np.matmul(shared.swapaxes(1, 2), both[:, :, M:])
        return cls(E, _symmetric(np.matmul(H.swapaxes(1, 2), both[:, :, :M])), _symmetric(N))

    def doubled(self) -> "Stride":
        """Return a stride of twice as many steps."""
        E, M = self.E, self.E.shape[1]
        # with M or more right sides, the inverse and a product cost half of a solve
        X = np.linalg.inv(np.eye(M) + np.matmul(self.N, self.G))
        EX, XE, transposed = np.matmul(E, X), np.matmul(X, E), E.swapaxes(1, 2)
        N = self.N + np.matmul(np.matmul(EX, self.N), transposed)
        G = self.G + np.matmul(np.matmul(transposed, self.G), XE)
        return Stride(np.matmul(E, XE), _symmetric(G), _symmetric(N))

    def advance(self, P: Floats) -> Floats:
        """Covariances `P` (S, M, M) after the steps of the stride."""
        closed = np.linalg.solve(np.eye(P.shape[1]) + np.matmul(P, self.G), P)
        return _symmetric(self.N + np.matmul(np.matmul(self.E, closed), self.E.swapaxes(1, 2)))


class Ladder:
    """Strides of 2^k steps that are kept: they are needed again while the same readings come.

    All its content could be made anew, bit for bit.

    Parameters
    ----------
    strings, states, readings : int
        S, M and the length of a pattern.
    """

    def __init__(self, strings: int, states: int, readings: int) -> None:
        self._made = Stride(*(np.zeros((strings, states, states)) for _ in range(3)))
        self._level, self._pattern = np.full(strings, -1), np.zeros((strings, readings), np.int64)

    def forget(self, at: Ints) -> None:
        """Discard the strides of the strings `at`, whose parameters have changed."""
        self._level[at] = -1

    def advanced(self, P: Floats, at: Ints, pattern: Ints, count: Ints, one: Callable[[Ints, Ints], Stride]) -> Floats:
        """Covariances after `count` steps, in as many products as `count` has bits.

        Parameters
        ----------
        P : ndarray (s, M, M)
        at, count : ndarray of int (s,)
            Which strings, and the number of steps of each, at least 1.
        pattern : ndarray of int (s, m + 2)
            Readings in these steps.
        one : callable
            Makes a single step for some strings and their patterns.
        """
        self._level[at[(self._pattern[at] != pattern).any(axis=1)]] = -1
        self._pattern[at] = pattern
        P = P.copy()
        for level in range(int(count.max()).bit_length()):
            now = np.flatnonzero(count >> level & 1)
            if len(now):
                self._climb(at[now], level, one)
                P[now] = self._of(at[now]).advance(P[now])
        return P

    def _climb(self, at: Ints, level: int, one: Callable[[Ints, Ints], Stride]) -> None:
        anew = at[(self._level[at] < 0) | (self._level[at] > level)]
        if len(anew):
            self._put(anew, one(self._pattern[anew], anew))
            self._level[anew] = 0
        while len(low := at[self._level[at] < level]):
            self._put(low, self._of(low).doubled())
            self._level[low] += 1

    def _of(self, at: Ints) -> Stride:
        if len(at) == len(self._level):  # all strings in their order: no copies
            return self._made
        return Stride(self._made.E[at], self._made.G[at], self._made.N[at])

    def _put(self, at: Ints, stride: Stride) -> None:
        self._made.E[at], self._made.G[at], self._made.N[at] = stride.E, stride.G, stride.N


def _symmetric(a: Floats) -> Floats:
    return (a + a.swapaxes(1, 2)) / 2.0
