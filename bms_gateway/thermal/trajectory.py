r"""Free-running trajectories of a string with any effects, and their sensitivities, over a whole record at once.

The balances f (`Physics.rates`) are split at a reference Jacobian A about the record's mean. With X̄ the mean of a
state over an interval and ū the mean inputs,

.. math::
    X_{k+1} = \Phi X_k + \Gamma \bigl(f(\bar X_k, \bar u_k) - A \bar X_k\bigr), \qquad
    \Phi = e^{A \Delta t}, \; \Gamma = \int_0^{\Delta t} e^{A s} ds

is an exponential integrator of second order (Hochbruck & Ostermann 2010) that solves a linear string exactly. It is
solved by waveform relaxation: the bracket along the last trajectory, all intervals in one call, then the linear
recursion; what A does not hold (a resistance that follows its own heat, a flow that moves) shrinks with every sweep.
The recursion runs blockwise, about √N steps of large products in place of N small ones.

Sensitivities S = ∂X/∂θ follow the same recursion, driven by finite differences of f along the trajectory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.physics import Memory, Numbers, Physics

TOLERANCE = 2e-4
"""K: sweeps end when the trajectory moves by less; a hundredth of the finest thermocouple noise."""
SWEEPS = 15
LEAST_INTERVALS = 8
"""A stretch that does not settle is halved, for sweeps settle the faster the shorter they are; below this it is taken
as it is."""
COLD, HOT = -200.0, 1000.0
"""°C: no cell is beyond; a trajectory that runs away is held there so that a fit can turn back."""


class Recursion:
    """X⁺ = Φ X + Γ w over many steps and columns.

    Parameters
    ----------
    A : ndarray (D, D), 1/s
    dt : float, s
    steps : int
        Number of steps usually taken: sets the length of a block.
    """

    def __init__(self, A: Floats, dt: float, steps: int) -> None:
        D = len(A)
        F = np.zeros((2 * D, 2 * D))
        F[:D, :D], F[:D, D:] = A * dt, np.eye(D) * dt
        E = scipy.linalg.expm(F)
        self.A, self.dt = A, dt
        self.Phi, self.Gamma = E[:D, :D].copy(), E[:D, D:].copy()
        self.block = max(1, int(np.sqrt(steps)))
        powers = [self.Phi]
        for _ in range(self.block - 1):
            powers.append(powers[-1] @ self.Phi)
        self._powers = np.stack(powers)

    def run(self, x0: Floats, w: Floats) -> Floats:
        """Run from `x0` (D, P) under `w` (N, D, P): states (N + 1, D, P), the start first.

        Numbers that a fit tries on its way may run away: the result is then infinite or not a number.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self._run(x0, w)

    def _run(self, x0: Floats, w: Floats) -> Floats:
        N, D, P = w.shape
        m = self.block
        blocks = -(-N // m)
        padded = np.zeros((blocks * m, D, P))
        padded[:N] = w
        drive = np.matmul(self.Gamma, padded.reshape(blocks, m, D, P).transpose(1, 2, 0, 3).reshape(m, D, blocks * P))
        z = drive[0]
        for j in range(1, m):
            z = self.Phi @ z + drive[j]
            drive[j] = z
        ends = z.reshape(D, blocks, P)
        starts = np.empty((D, blocks, P))
        x = x0
        for b in range(blocks):
            starts[:, b] = x
            x = self._powers[-1] @ x + ends[:, b]
        drive += np.matmul(self._powers, starts.reshape(D, blocks * P))
        out = np.empty((N + 1, D, P))
        out[0] = x0
        out[1:] = drive.reshape(m, D, blocks, P).transpose(2, 0, 1, 3).reshape(blocks * m, D, P)[:N]
        return out


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a record with one start: intervals `first` to `last` (not included)."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first


@dataclass(frozen=True, slots=True)
class Variation:
    """One direction in which numbers and start may move, for `sensitivities`.

    Attributes
    ----------
    numbers : Numbers
        Those at θ + `step` e.
    memory : Memory
        The effects' memories with them.
    step : float
    start : tuple of ndarray (D,)
        Derivative of the start of each span.
    """

    numbers: Numbers
    memory: Memory
    step: float
    start: tuple[Floats, ...]


def cut(u: Drive, first: int, last: int) -> Drive:
    """Intervals `first` to `last` (not included) of a drive."""
    return _map(u, lambda x: x[first:last])


def average(u: Drive) -> Drive:
    """One interval that holds the means of all; voltage as far as it was there."""
    return _map(u, lambda x: np.atleast_1d(np.nanmean(x)) if np.isfinite(x).any() else x[:1])


def at_instants(u: Drive) -> Drive:
    """Return the inputs at the N + 1 instants between and around the intervals: means of the neighbours."""
    return _map(u, _between)


def reference(physics: Physics, u: Drive, v: Numbers, memory: Memory, X: Floats) -> Recursion:
    """Linear recursion about the mean of inputs and of a guessed state `X` (D,)."""
    mean = {key: np.mean(m, axis=0, keepdims=True) for key, m in memory.items()}
    return Recursion(physics.linearised(X, average(u), v, mean), u.dt, len(u.I))


def simulate(
    physics: Physics,
    u: Drive,
    v: Numbers,
    memory: Memory,
    starts: Sequence[Floats],
    spans: Sequence[Span],
    recursion: Recursion,
    guess: Floats | None = None,
    tolerance: float = TOLERANCE,
    *,
    halve: bool = True,
) -> tuple[Floats, bool]:
    """Run the string freely over a record.

    Parameters
    ----------
    physics, u, v, memory
        `memory` as `Physics.memory` gives it for `u` and `v`.
    starts : sequence of ndarray (D,)
        State at the start of each span, °C.
    spans : sequence of Span
        Cover the record in order.
    recursion : Recursion
        From `reference`; any near one will do, the result depends on it only in the order of dt².
    guess : ndarray (N + 1, D), optional
        A trajectory near the result saves sweeps.
    tolerance : float, K
    halve : bool
        Whether a span on which the sweeps do not settle is halved until they do. A recursion about these very numbers
        is the better thing to try first.

    Returns
    -------
    X : ndarray (N + spans, D)
        States at the instants; a span of k intervals has k + 1 of them. With one span N + 1.
    settled : bool
        Whether the sweeps converged everywhere.
    """
    parts, settled = [], True
    row = 0
    for x0, span in zip(starts, spans, strict=True):
        part_u = cut(u, span.first, span.last)
        part_memory = {k: m[span.first : span.last] for k, m in memory.items()}
        part_guess = None if guess is None else guess[row : row + len(span) + 1]
        X, ok = _relax(physics, part_u, v, part_memory, x0, recursion, part_guess, tolerance)
        if not ok and halve:
            X = _halved(physics, part_u, v, part_memory, x0, X, tolerance)
        parts.append(X)
        settled = settled and ok
        row += len(span) + 1
    return np.concatenate(parts), settled


def sensitivities(
    physics: Physics,
    u: Drive,
    v: Numbers,
    memory: Memory,
    X: Floats,
    spans: Sequence[Span],
    recursion: Recursion,
    variations: Sequence[Variation],
    refinements: int = 1,
) -> Floats:
    """Differentiate a trajectory with respect to several numbers.

    Parameters
    ----------
    X : ndarray (N + spans, D)
        From `simulate`.
    variations : sequence of Variation, P
    refinements : int
        Sweeps that add what the reference Jacobian does not hold.

    Returns
    -------
    ndarray (N + spans, D, P)
    """
    out = np.empty((*X.shape, len(variations)))
    row = 0
    for i, span in enumerate(spans):
        rows = slice(row, row + len(span) + 1)
        row = rows.stop
        part_u = cut(u, span.first, span.last)
        at = slice(span.first, span.last)
        memories = [{k: m[at] for k, m in c.memory.items()} for c in variations]
        x_mean = (X[rows][1:] + X[rows][:-1]) / 2.0
        f0 = physics.rates(x_mean, part_u, v, {k: m[at] for k, m in memory.items()})
        g = np.stack(
            [
                (physics.rates(x_mean, part_u, c.numbers, m) - f0) / c.step
                for c, m in zip(variations, memories, strict=True)
            ],
            axis=-1,
        )
        x0 = np.stack([c.start[i] for c in variations], axis=-1)
        S = recursion.run(x0, g)
        for _ in range(refinements):
            S_mean = (S[1:] + S[:-1]) / 2.0
            linear = np.matmul(recursion.A, S_mean)
            for j, (c, m) in enumerate(zip(variations, memories, strict=True)):
                moved = physics.rates(x_mean + c.step * S_mean[..., j], part_u, c.numbers, m)
                g[..., j] = (moved - f0) / c.step - linear[..., j]
            S = recursion.run(x0, g)
        out[rows] = S
    return out


def readings(physics: Physics, u: Drive, v: Numbers, memory: Memory, X: Floats, spans: Sequence[Span]) -> Floats:
    """Read thermocouples on all cells along a trajectory: ndarray (N + spans, n), °C."""
    parts = []
    row = 0
    for span in spans:
        between = {k: _between(m[span.first : span.last]) for k, m in memory.items()}
        part = X[row : row + len(span) + 1]
        parts.append(physics.readings(part, at_instants(cut(u, span.first, span.last)), v, between))
        row += len(span) + 1
    return np.concatenate(parts)


def _relax(
    physics: Physics,
    u: Drive,
    v: Numbers,
    memory: Memory,
    x0: Floats,
    recursion: Recursion,
    guess: Floats | None,
    tolerance: float,
) -> tuple[Floats, bool]:
    X = np.tile(x0, (len(u.I) + 1, 1)) if guess is None else guess
    last = np.inf
    for sweep in range(SWEEPS):
        mean = (X[1:] + X[:-1]) / 2.0
        w = physics.rates(mean, u, v, memory) - mean @ recursion.A.T
        new = np.clip(recursion.run(x0[:, None], w[..., None])[..., 0], COLD, HOT)
        change = float(np.abs(new - X).max())
        X = new
        if change < tolerance:
            return X, True
        if not np.isfinite(change) or (sweep > 3 and change > 0.8 * last):
            break
        last = change
    return X, False


def _halved(
    physics: Physics, u: Drive, v: Numbers, memory: Memory, x0: Floats, guess: Floats, tolerance: float
) -> Floats:
    """Solve the first half, then the second from where it ends, each about its own mean."""
    middle = len(u.I) // 2
    found = []
    for part in (slice(0, middle), slice(middle, len(u.I))):
        some = {k: a[part] for k, a in memory.items()}
        inputs = cut(u, part.start, part.stop)
        about = np.clip(guess[part.start : part.stop + 1].mean(axis=0), COLD, HOT)
        recursion = reference(physics, inputs, v, some, about)
        X, ok = _relax(physics, inputs, v, some, x0, recursion, None, tolerance)
        if not ok and len(inputs.I) > LEAST_INTERVALS:
            X = _halved(physics, inputs, v, some, x0, X, tolerance)
        found.append(X)
        x0 = X[-1]
    return np.concatenate([found[0][:-1], found[1]])


def _between(x: Floats) -> Floats:
    return np.concatenate([x[:1], (x[1:] + x[:-1]) / 2.0, x[-1:]])


def _map(u: Drive, change: Callable[[Floats], Floats]) -> Drive:
    return replace(
        u,
        I=change(u.I),
        I2=change(u.I2),
        I_abs=change(u.I_abs),
        T_in=change(u.T_in),
        flow=change(u.flow),
        soc=change(u.soc),
        V=change(u.V),
        IV=change(u.IV),
        hours=change(u.hours),
    )
