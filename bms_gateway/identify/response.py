"""Free response of a string to its measured inputs for many parameter sets at once, block by block.

A window has a thousand steps; single steps cost a thousand small products per parameter set. Within a block of L steps
the response is one Toeplitz matrix times the inputs, equal for every block, so only the blocks' first states are
stepped. The result equals the step-by-step simulation to rounding.

Lin et al., Eq 16-18, corrected as in `thermal.string`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import ContinuousString, Floats, StringParameters, continuous, discretize
from bms_gateway.thermal.roll import resting, with_roll

BLOCK = 32  # steps; near the square root of a window, where Toeplitz and stepping cost the same
TOGETHER = 8
"""Parameter sets simulated at once if there are many, as for a string's single cells."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """K steps of equal length.

    Attributes
    ----------
    mean_square_current : ndarray (K,)
        A²; 0 where `heat` is used.
    heat : ndarray (K,)
        Mean heat per cell from voltage, W; 0 where heat is I²R_e.
    inlet : ndarray (K + 1,)
        °C, at the instants.
    dt : float
        s.
    drift : ndarray (K, J)
        Shapes in time of the relative change of R_e within the window.
    departure : ndarray (J,)
        Size of each shape, relative.
    swing : float
        Gain of the inlet's deviations from its mean: 1 if the cells feel the measured inlet.
    warmth : Warmth or None
        Of the cores; None if R_e does not follow them.
    B : float, 1000 K
        With which R_e follows the warmth (`thermal.warmth`); heat from voltage does not.
    """

    mean_square_current: Floats
    heat: Floats
    inlet: Floats
    dt: float
    drift: Floats
    departure: Floats
    swing: float = 1.0
    warmth: "Warmth | None" = None
    B: float = 0.0

    def stacked(self) -> Floats:
        """(K, 4 or 5): I², heat, inlet at the start and at the end of each step; with a warmth, I² times its course."""
        gain = self.gain
        inlet = self.inlet + (self.swing - 1.0) * (self.inlet - self.inlet.mean())
        some = [gain * self._warmed, gain * self.heat, inlet[:-1], inlet[1:]]
        return np.column_stack(some if self.warmth is None else [*some, some[0] * self.warmth.course])

    @property
    def gain(self) -> Floats:
        """Heat (K,) over that of a constant R_e."""
        return np.asarray(1.0 + self.drift @ self.departure, dtype=np.float64)

    @property
    def _warmed(self) -> Floats:
        """Mean square current (K,) that would make the same heat at 25 °C, A²."""
        if self.warmth is None:
            return self.mean_square_current
        return np.asarray(self.mean_square_current * np.exp(self.B * self.warmth.mean), dtype=np.float64)

    def variations(self) -> Floats:
        """(K, 4 or 5, J + 1 or 2): inputs by `departure`, by `swing`, and by `B` of the mean if there is a warmth."""
        K, J = self.drift.shape
        more, warmed = 0 if self.warmth is None else 1, self._warmed
        out = np.zeros((K, 4 + more, J + 1 + more))
        out[:, 0, :J] = warmed[:, None] * self.drift
        out[:, 1, :J] = self.heat[:, None] * self.drift
        moved = self.inlet - self.inlet.mean()
        out[:, 2, J], out[:, 3, J] = moved[:-1], moved[1:]
        if self.warmth is not None:
            out[:, 4, :J] = out[:, 0, :J] * self.warmth.course[:, None]
            out[:, 0, J + 1] = self.gain * warmed * self.warmth.mean
            out[:, 4, J + 1] = out[:, 0, J + 1] * self.warmth.course
        return out


@dataclass(frozen=True, slots=True)
class Warmth:
    """Warmth of n cores over K steps (`thermal.warmth`), as their mean and one pattern of their differences from it.

    Attributes
    ----------
    mean, course : ndarray (K,)
    profile : ndarray (n,)
        Warmth of cell i at step k: mean[k] + course[k] profile[i].
    """

    mean: Floats
    course: Floats
    profile: Floats

    @classmethod
    def nothing(cls, steps: int, cells: int) -> "Warmth":
        """Cores at 25 °C."""
        return cls(np.zeros(steps), np.zeros(steps), np.zeros(cells))


@dataclass(frozen=True, slots=True)
class Response:
    """Surfaces and the last state of S parameter sets; derivatives of the surfaces for set 0.

    Attributes
    ----------
    surface : ndarray (S, K + 1, m)
    last : ndarray (S, 2n)
    surface_by_start : ndarray (K + 1, m, 2n)
    surface_by_input : ndarray (K + 1, m, J + 1 or 2)
        As of `Inputs.variations`.
    """

    surface: Floats
    last: Floats
    surface_by_start: Floats
    surface_by_input: Floats


def respond(
    sets: Sequence[StringParameters],
    inputs: Inputs,
    x0: Floats,
    sensed: Sequence[int],
    share: float | Sequence[float] = 0.0,
    B: float | Sequence[float] = 0.0,
) -> Response:
    """Simulate S parameter sets.

    Parameters
    ----------
    sets : sequence of StringParameters
        S sets of strings of n cells.
    inputs : Inputs
    x0 : ndarray (S, 2n)
        Starts, °C.
    sensed : sequence of int
        0-based cells whose surface is returned (m of them).
    share : float or sequence of float
        Share of R_c within the jelly roll (`thermal.roll`), for all sets or for each. If it is 0, in all sets or in
        none, a core is one node. A roll starts with the profile of steady heating.
    B : float or sequence of float, 1000 K
        With which R_e follows the differences of the cores' warmth, for all sets or for each.

    References
    ----------
    Lin et al., Eq 1 and 18, solved for many parameter sets.
    """
    shares = np.broadcast_to(share, len(sets)).tolist()
    w = _Blocks.of(sets, inputs, sensed, shares, np.broadcast_to(B, len(sets)).tolist())
    K, L, m = len(w.u), len(w.reach), len(sensed)
    N, n = w.step.shape[1], sets[0].cells
    X, x = w.starts(np.array([resting(n, own) @ x for own, x in zip(shares, x0, strict=True)]))
    by_start = np.empty((K + 1, m, 2 * n))
    by_start[0] = 0.0
    by_start[0, np.arange(m), 2 * np.asarray(sensed) + 1] = 1.0
    Phi = np.empty((X.shape[2], N, 2 * n))
    P = resting(n, shares[0])
    for b in range(len(Phi)):
        Phi[b] = P
        P = w.step[0] @ P
    by_start[1:] = (w.observe[0] @ Phi).reshape(-1, m, 2 * n)[:K]
    by_input = w.by_input(inputs)
    for k in range((len(Phi) - 1) * L, K):  # the last block may be short
        x = (w.A @ x[:, :, None])[:, :, 0] + w.B @ w.u[k]
    return Response(w.surface(X), x[:, : 2 * n], by_start, by_input)


def surfaces(
    sets: Sequence[StringParameters], inputs: Inputs, x0: Floats, sensed: Sequence[int]
) -> Iterator[tuple[slice, Floats]]:
    """Simulate the surfaces of many parameter sets, a few at a time: the memory use does not grow with their number.

    Parameters
    ----------
    sets, inputs, x0, sensed
        As of `respond`.

    Yields
    ------
    slice
        Which of the sets.
    ndarray (·, K + 1, m)
        `Response.surface` of these, to the last bit.
    """
    for first in range(0, len(sets), TOGETHER):
        some = slice(first, min(first + TOGETHER, len(sets)))
        nothing = [0.0] * len(sets[some])
        w = _Blocks.of(sets[some], inputs, sensed, nothing, nothing)
        yield some, w.surface(w.starts(x0[some])[0])


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Responses of S parameter sets within a block of L steps, for any state at its start.

    Attributes
    ----------
    A, B : ndarray (S, N, N), (S, N, r)
        One step. The first 2n of the N states are the cores and casings, in turn.
    u : ndarray (K, r)
    U : ndarray (L r, blocks)
        The inputs of each block.
    reach : ndarray (L, S, N, r)
        A^j B.
    step : ndarray (S, N, N)
        A^L.
    observe : ndarray (S, L m, N)
        C A^(j+1).
    toeplitz : ndarray (S, L, m, L, r)
    read : list of int (m)
        States of the sensed casings.
    """

    A: Floats
    B: Floats
    u: Floats
    U: Floats
    reach: Floats
    step: Floats
    observe: Floats
    toeplitz: Floats
    read: list[int]

    @classmethod
    def of(
        cls,
        sets: Sequence[StringParameters],
        inputs: Inputs,
        sensed: Sequence[int],
        shares: Sequence[float],
        B: Sequence[float],
    ) -> "_Blocks":
        own = None if inputs.warmth is None else np.outer(B, inputs.warmth.profile)
        A, by_input = _discrete(sets, inputs.dt, shares, own)
        read = [2 * k + 1 for k in sensed]
        u = inputs.stacked()
        K, r = u.shape
        S, N, _ = A.shape
        m, L = len(sensed), min(BLOCK, K)
        reach = np.empty((L, S, N, r))
        see = np.empty((L, S, m, N))
        G, seen = by_input, A[:, read]
        for j in range(L):  # narrow products: powers of A would cost as many times more as a string has states
            reach[j], see[j] = G, seen
            G, seen = A @ G, seen @ A
        step = np.linalg.matrix_power(A, L)
        kernel = reach[:, :, read]  # (L, S, m, r)
        toeplitz = np.zeros((S, L, m, L, r))
        for i in range(L):
            toeplitz[:, i:, :, i] = kernel[: L - i].transpose(1, 0, 2, 3)
        blocks = -(-K // L)
        padded = np.zeros((blocks * L, r))
        padded[:K] = u
        observe = see.transpose(1, 0, 2, 3).reshape(S, L * m, N)
        return cls(A, by_input, u, padded.reshape(blocks, L * r).T, reach, step, observe, toeplitz, read)

    def starts(self, x0: Floats) -> tuple[Floats, Floats]:
        """States at the start of each block (S, N, blocks), and of the last one (S, N)."""
        S, N, _ = self.A.shape
        jump = self.reach[::-1].transpose(1, 2, 0, 3).reshape(S, N, -1) @ self.U
        X = np.empty((S, N, self.U.shape[1]))
        x = x0
        for b in range(X.shape[2]):
            if b:
                x = (self.step @ x[:, :, None])[:, :, 0] + jump[:, :, b - 1]
            X[:, :, b] = x
        return X, x

    def surface(self, X: Floats) -> Floats:
        """Surfaces (S, K + 1, m) from the states at the start of each block."""
        (S, _, blocks), K, L, m = X.shape, len(self.u), len(self.reach), len(self.read)
        inside = self.toeplitz.reshape(S, L * m, -1) @ self.U  # (S, L m, blocks)
        inside += self.observe @ X
        out = np.empty((S, K + 1, m))
        out[:, 0] = X[:, self.read, 0]
        out[:, 1:] = inside.transpose(0, 2, 1).reshape(S, blocks * L, m)[:, :K]
        return out

    def by_input(self, inputs: Inputs) -> Floats:
        """Return the slopes of set 0's surfaces by `Inputs.variations` (K + 1, m, ·): same blocks, from zero."""
        V = inputs.variations()
        K, r, J = V.shape
        N, L, m = self.step.shape[1], len(self.reach), len(self.read)
        inside, jump = self.toeplitz[0].reshape(L * m, -1), self.reach[::-1, 0].transpose(1, 0, 2).reshape(N, -1)
        blocks = -(-K // L)
        padded = np.zeros((blocks * L, r, J))
        padded[:K] = V
        U = padded.reshape(blocks, L * r, J)
        x = np.zeros((N, J))
        out = np.zeros((blocks * L + 1, m, J))
        for b in range(blocks):
            out[b * L + 1 : (b + 1) * L + 1] = (self.observe[0] @ x + inside @ U[b]).reshape(L, m, J)
            x = self.step[0] @ x + jump @ U[b]
        return out[: K + 1]


def _discrete(
    sets: Sequence[StringParameters], dt: float, shares: Sequence[float], own: Floats | None
) -> tuple[Floats, Floats]:
    """Discretise: A (S, N, N) and B (S, N, r) for the inputs I², mean heat, inlet at start and end.

    With `own` (S, n), there is a fifth input, I² times the course of the cores' differences in warmth: it makes heat in
    each cell by its R_e times `own`.
    """
    rolled = [with_roll(continuous(p), p, share) for p, share in zip(sets, shares, strict=True)]
    heats = [np.column_stack([p.R_e, p.R_e / np.mean(p.R_e)]) for p in sets]
    if own is not None:
        heats = [np.column_stack([heat, p.R_e * mine]) for heat, p, mine in zip(heats, sets, own, strict=True)]
    d = discretize(
        ContinuousString(
            np.array([s.A for s in rolled]),
            np.array([s.B_q @ heat for s, heat in zip(rolled, heats, strict=True)]),
            np.array([s.B_f for s in rolled]),
        ),
        dt,
    )
    B = [d.B_q[:, :, :2], d.B_f0[:, :, None], d.B_f1[:, :, None], d.B_q[:, :, 2:]]
    return d.A, np.concatenate(B, axis=2)
