r"""Linear recursions X⁺ = Φ X + Γ w over many steps and columns at once, and the exponentials Φ and Γ of a Jacobian.

A recursion of N steps runs blockwise: about √N steps of large products instead of N small ones. With few numbers (one
trajectory of a few cells) the number of calls determines the time: such a recursion runs as one product of the drive
with the response of a whole block (`_Response`).
"""

from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal.parameters import Floats

CACHE = 120_000
"""Numbers in one column block of the recursion: one megabyte, which fits into the cache of one processor core."""
WIDE = 1_000
"""States times columns above which the recursion takes single steps: each product is then large enough."""
FEW, FEW_STATES = 16_000, 12
"""Numbers in a recursion, and states, up to which it is the product with a response: 128 kB, the largest array that the
C library takes from memory it already has."""
RESPONSE = 48
"""Rows of a response: the product with them takes no longer than the call."""
TERMS, LEAST_SIZE = 14, 0.5
"""Terms of the exponential's series, and the norm of a matrix up to which they are exact to the last digit."""


class Recursion:
    """X⁺ = Φ X + Γ w over many steps and columns.

    Parameters
    ----------
    A : ndarray (D, D), 1/s
    dt : float, s
    steps : int
        Usual number of steps: determines the length of a block.
    """

    def __init__(self, A: Floats, dt: float, steps: int) -> None:
        self.A, self.dt = A, dt
        self._longer: Recursion | None = None
        self._response: _Response | None = None
        self.Phi, phi = exponentials(A * dt)
        self.Gamma = phi * dt
        self.block = max(1, int(np.sqrt(steps)))

    @cached_property
    def _over_a_block(self) -> tuple[Floats, Floats]:
        """Φ to the power of a block's length, and what each step of a block adds to its end."""
        powers = [np.eye(len(self.A))]
        for _ in range(self.block):
            powers.append(self.Phi @ powers[-1])
        whole = powers.pop()
        return whole, np.concatenate(powers[::-1], axis=1)

    def with_steps(self, dt: float, steps: int) -> "Recursion":
        """Return the recursion with steps of another length; the last such recursion is stored."""
        if self._longer is None or self._longer.dt != dt:
            self._longer = Recursion(self.A, dt, steps)
        return self._longer

    def run(self, x0: Floats, w: Floats) -> Floats:
        """Run from `x0` (D, P) under `w` (N, D, P): states (N + 1, D, P), the start first.

        With parameters that a fit tries, the states may diverge: the result is then infinite or NaN. Time is the
        fastest axis of the result in memory; `w` is read fastest if it has the same layout.
        """
        N, D, P = w.shape
        out = np.empty((P, D, N + 1))
        with np.errstate(over="ignore", invalid="ignore"):
            if D <= FEW_STATES and N * D * P <= FEW:
                if self._response is None or self._response.steps < N:
                    self._response = _Response(self.Phi, self.Gamma, max(N, self.block**2))
                out[..., 0] = x0.T
                out[..., 1:] = self._response.run(x0, w).transpose(2, 1, 0)
                return out.transpose(2, 1, 0)
            w = w.transpose(2, 1, 0)
            if D * P >= WIDE:
                self._step(x0, w, out)
                return out.transpose(2, 1, 0)
            some = max(1, CACHE // (N * D))
            for first in range(0, P, some):
                columns = slice(first, first + some)
                self._run(x0[:, columns], w[columns], out[columns])
        return out.transpose(2, 1, 0)

    def _step(self, x0: Floats, w: Floats, out: Floats) -> None:
        """Run many columns of a long string in steps, using only rows of `w` that are not zero."""
        driven = np.flatnonzero(w.any(axis=(0, 2)))
        x = np.ascontiguousarray(x0)
        out[..., 0] = x.T
        for first in range(0, w.shape[2], self.block):
            some = w[:, driven, first : first + self.block].transpose(2, 1, 0)
            states = np.matmul(self.Gamma[:, driven], some)
            for state in states:
                state += self.Phi @ x
                x = state
            out[..., first + 1 : first + len(some) + 1] = states.transpose(2, 1, 0)

    def _run(self, x0: Floats, w: Floats, out: Floats) -> None:
        P, D, N = w.shape
        m = self.block
        full, rest = divmod(N, m)
        blocks = full + (rest > 0)
        drive = np.empty((m, D, P, blocks))
        drive[..., :full] = w[..., : full * m].reshape(P, D, full, m).transpose(3, 1, 0, 2)
        if rest:
            drive[rest:, ..., full] = 0.0
            drive[:rest, ..., full] = w[..., full * m :].transpose(2, 1, 0)
        drive = np.matmul(self.Gamma, drive.reshape(m, D, P * blocks))
        # the end of each block if it started from zero; then its true start; then every step of all blocks
        whole, adds = self._over_a_block
        ends = (adds @ drive.reshape(m * D, P * blocks)).reshape(D, P, blocks)
        starts = np.empty((D, P, blocks))
        x = x0
        for b in range(blocks):
            starts[..., b] = x
            x = whole @ x + ends[..., b]
        z = starts.reshape(D, P * blocks)
        for step in drive:
            step += self.Phi @ z
            z = step
        states = drive.reshape(m, D, P, blocks)
        out[..., 0] = x0.T
        out[..., 1 : full * m + 1].reshape(P, D, full, m)[...] = states[..., :full].transpose(2, 1, 3, 0)
        if rest:
            out[..., full * m + 1 :] = states[:rest, ..., full].transpose(2, 1, 0)


class _Response:
    """States of a block of m steps as one product with what drives them, for all blocks at once.

    The starts of the blocks follow the same recursion with Φ^m, and so on until one block is left.

    Parameters
    ----------
    Phi, Gamma : ndarray (D, D)
    steps : int
        Greatest number of steps.
    """

    def __init__(self, Phi: Floats, Gamma: Floats, steps: int) -> None:
        D, self.steps = len(Phi), steps
        self.m = m = min(steps, max(2, RESPONSE // D))
        powers = np.empty((m + 1, D, D))
        powers[0] = np.eye(D)
        for k in range(m):
            np.matmul(Phi, powers[k], out=powers[k + 1])
        self._from_start = powers[1:].reshape(m * D, D)
        responses = np.zeros((m + 1, D, D))  # the last one is that of a step yet to come
        np.matmul(powers[:m], Gamma, out=responses[:m])
        self._from_drive = responses[_lags(m)].transpose(0, 2, 1, 3).reshape(m * D, m * D)
        blocks = -(-steps // m)
        self._starts = _Response(powers[-1], np.eye(D), blocks - 1) if blocks > 1 else None

    def run(self, x0: Floats, w: Floats) -> Floats:
        """Return the states (N, D, P) after each step, from `x0` (D, P) under `w` (N, D, P)."""
        N, D, P = w.shape
        blocks = -(-N // self.m)
        drive = np.zeros((blocks * self.m, D, P))
        drive[:N] = w
        states = self._from_drive @ drive.reshape(blocks, self.m * D, P)
        starts = np.empty((blocks, D, P))
        starts[0] = x0
        if self._starts is not None and blocks > 1:
            starts[1:] = self._starts.run(x0, states[:-1, -D:])
        states += self._from_start @ starts
        return states.reshape(-1, D, P)[:N]


@cache
def _lags(m: int) -> NDArray[np.intp]:
    """Return by how many steps each of m steps (row) comes after each (column); m where it comes before."""
    lag = np.subtract.outer(np.arange(m), np.arange(m))
    return np.where(lag >= 0, lag, m)


def exponentials(Z: Floats) -> tuple[Floats, Floats]:
    r"""Matrix functions e^Z and φ₁(Z) = ∫₀¹ e^{Zs} ds, by the Taylor series for Z/2^k and k doublings.

    .. math:: e^{2Z} = e^Z e^Z, \qquad \varphi_1(2Z) = \tfrac{1}{2} (e^Z + 1) \varphi_1(Z)

    Examples
    --------
    >>> e, phi = exponentials(np.diag([-3.0, 0.0]))
    >>> bool(np.allclose(e, np.diag([np.exp(-3.0), 1.0])))
    True
    >>> bool(np.allclose(phi, np.diag([-np.expm1(-3.0) / 3.0, 1.0])))
    True

    References
    ----------
    Higham, Functions of Matrices, 2008, section 10.7.4.
    """
    one = np.eye(len(Z))
    size = float(np.abs(Z).sum(axis=0).max())
    if not np.isfinite(size):
        return np.full_like(Z, np.nan), np.full_like(Z, np.nan)
    doublings = max(0, int(np.ceil(np.log2(max(size, LEAST_SIZE) / LEAST_SIZE))))
    small = Z / 2.0**doublings
    phi = one
    for k in range(TERMS, 1, -1):
        phi = small @ phi
        phi /= k
        phi += one
    e = small @ phi
    e += one
    if doublings:
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(doublings):
                phi = 0.5 * (phi + e @ phi)
                e = e @ e
    return e, phi
