"""Free response of a string to its measured inputs for many parameter sets at once, block by block.

A window has a thousand steps; stepping them one by one costs a thousand small products per parameter set. Within a
block of L steps the response is one Toeplitz matrix times the inputs, the same for every block, so only the blocks'
first states are stepped. The result equals the step-by-step simulation to rounding.

Lin et al., Eq 16-18, corrected as `thermal.string` says.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import Floats, StringParameters, continuous, discretize

BLOCK = 32  # steps; near the square root of a window, where Toeplitz and stepping cost the same


@dataclass(frozen=True, slots=True)
class Inputs:
    """K steps of equal length.

    Attributes
    ----------
    mean_square_current : ndarray (K,)
        A²; 0 where `heat` holds.
    heat : ndarray (K,)
        Mean heat per cell from voltage, W; 0 where it is taken as I²R_e.
    inlet : ndarray (K + 1,)
        °C, at the instants.
    dt : float
        s.
    drift : ndarray (K, J)
        Shapes in time by which R_e may depart from its value within the window.
    departure : ndarray (J,)
        How far it does, relative.
    swing : float
        Gain of the inlet's departures from its mean: 1 where the reading is what the cells feel.
    """

    mean_square_current: Floats
    heat: Floats
    inlet: Floats
    dt: float
    drift: Floats
    departure: Floats
    swing: float = 1.0

    def stacked(self) -> Floats:
        """(K, 4): I², heat, inlet at the start and at the end of each step."""
        gain = 1.0 + self.drift @ self.departure
        inlet = self.inlet + (self.swing - 1.0) * (self.inlet - self.inlet.mean())
        return np.column_stack([gain * self.mean_square_current, gain * self.heat, inlet[:-1], inlet[1:]])

    def variations(self) -> Floats:
        """(K, 4, J + 1): inputs by `departure` and by `swing`."""
        K, J = self.drift.shape
        out = np.zeros((K, 4, J + 1))
        out[:, 0, :J] = self.mean_square_current[:, None] * self.drift
        out[:, 1, :J] = self.heat[:, None] * self.drift
        moved = self.inlet - self.inlet.mean()
        out[:, 2, J], out[:, 3, J] = moved[:-1], moved[1:]
        return out


@dataclass(frozen=True, slots=True)
class Response:
    """Surfaces and the last state of S parameter sets; derivatives of the surfaces for set 0.

    Attributes
    ----------
    surface : ndarray (S, K + 1, m)
    last : ndarray (S, 2n)
    surface_by_start : ndarray (K + 1, m, 2n)
    surface_by_input : ndarray (K + 1, m, J + 1)
        By `departure` and `swing`.
    """

    surface: Floats
    last: Floats
    surface_by_start: Floats
    surface_by_input: Floats


def respond(sets: Sequence[StringParameters], inputs: Inputs, x0: Floats, sensed: Sequence[int]) -> Response:
    """Simulate S parameter sets.

    Parameters
    ----------
    sets : sequence of StringParameters
        S sets of strings of n cells.
    inputs : Inputs
    x0 : ndarray (S, 2n)
        Starts, °C.
    sensed : sequence of int
        0-based cells whose surface is wanted (m of them).

    Returns
    -------
    Response

    References
    ----------
    Lin et al., Eq 1 and 18, solved for many parameter sets.
    """
    A, B = _discrete(sets, inputs.dt)
    u = inputs.stacked()
    K, r = u.shape
    S, N, _ = A.shape
    m, L = len(sensed), min(BLOCK, K)
    C = np.zeros((m, N))
    C[np.arange(m), 2 * np.asarray(sensed) + 1] = 1.0
    reach = np.empty((L, S, N, r))  # A^j B
    see = np.empty((L, S, m, N))  # C A^(j+1)
    step = np.broadcast_to(np.eye(N), A.shape)
    G = B
    for j in range(L):
        reach[j] = G
        G = A @ G
        step = A @ step
        see[j] = step[:, 1::2][:, list(sensed)]
    kernel = reach[:, :, 1::2][:, :, list(sensed)]  # (L, S, m, r)
    toeplitz = np.zeros((S, L, m, L, r))
    for i in range(L):
        toeplitz[:, i:, :, i] = kernel[: L - i].transpose(1, 0, 2, 3)
    blocks = -(-K // L)
    padded = np.zeros((blocks * L, r))
    padded[:K] = u
    U = padded.reshape(blocks, L * r).T
    inside = toeplitz.reshape(S, L * m, L * r) @ U  # (S, L m, blocks)
    jump = reach[::-1].transpose(1, 2, 0, 3).reshape(S, N, L * r) @ U
    X = np.empty((S, N, blocks))
    Phi = np.empty((blocks, N, N))
    x = x0
    P = np.eye(N)
    for b in range(blocks):
        X[:, :, b], Phi[b] = x, P
        if b < blocks - 1:
            x = (step @ x[:, :, None])[:, :, 0] + jump[:, :, b]
            P = step[0] @ P
    observe = see.transpose(1, 0, 2, 3).reshape(S, L * m, N)
    surface = np.empty((S, K + 1, m))
    surface[:, 0] = x0[:, 1::2][:, list(sensed)]
    surface[:, 1:] = (observe @ X + inside).transpose(0, 2, 1).reshape(S, blocks * L, m)[:, :K]
    by_start = np.empty((K + 1, m, N))
    by_start[0] = C
    by_start[1:] = (observe[0] @ Phi).reshape(blocks * L, m, N)[:K]
    by_input = _by_input(
        toeplitz[0].reshape(L * m, L * r),
        reach[::-1, 0].transpose(1, 0, 2).reshape(N, L * r),
        step[0],
        observe[0],
        inputs,
        L,
        m,
    )
    for k in range((blocks - 1) * L, K):  # the last block may be short
        x = (A @ x[:, :, None])[:, :, 0] + B @ u[k]
    return Response(surface, x, by_start, by_input)


def _by_input(inside: Floats, jump: Floats, step: Floats, see: Floats, inputs: Inputs, L: int, m: int) -> Floats:
    """Surfaces by the variations of the inputs (K + 1, m, J + 1): the same blocks, from zero."""
    V = inputs.variations()
    K, r, J = V.shape
    blocks = -(-K // L)
    padded = np.zeros((blocks * L, r, J))
    padded[:K] = V
    U = padded.reshape(blocks, L * r, J)
    x = np.zeros((jump.shape[0], J))
    out = np.zeros((blocks * L + 1, m, J))
    for b in range(blocks):
        out[b * L + 1 : (b + 1) * L + 1] = (see @ x + inside @ U[b]).reshape(L, m, J)
        x = step @ x + jump @ U[b]
    return out[: K + 1]


def _discrete(sets: Sequence[StringParameters], dt: float) -> tuple[Floats, Floats]:
    """Discretise: A (S, 2n, 2n) and B (S, 2n, 4) for the inputs I², mean heat, inlet at start and end."""
    A, B = [], []
    for p in sets:
        d = discretize(continuous(p), dt)
        share = p.R_e / np.mean(p.R_e)
        A.append(d.A)
        B.append(np.column_stack([d.B_q @ p.R_e, d.B_q @ share, d.B_f0, d.B_f1]))
    return np.array(A), np.array(B)
