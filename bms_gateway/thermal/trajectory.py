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

Sensitivities S = ∂X/∂θ follow the same recursion, driven by finite differences of f along the trajectory. Where an
effect is steep (a capacity that a narrow melting peak multiplies) their sweeps settle too slowly: half wrong, they hold
a fit fast at wrong numbers with a narrow band. They are then stepped with the Jacobian of every interval.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.physics import Memory, Numbers, Physics

TOLERANCE = 2e-4
"""K: sweeps end when the trajectory moves by less; a hundredth of the finest thermocouple noise."""
SWEEPS = 15
LEAST_INTERVALS = 8
"""A stretch that does not settle is halved, for sweeps settle the faster the shorter they are; below this it is marched
through."""
SUBSTEPS = 8
"""Steps of an interval that is marched through: a surface then passes a narrow melting peak in several of them."""
CACHE = 120_000
"""Numbers of one column block of the recursion: a megabyte of them stays in the cache of one core."""
TERMS, LEAST_SIZE = 14, 0.5
"""Of the exponential's series: what is left of a matrix of this size lies below the last digit."""
NUDGE = 1e-4
"""K: for slopes of the balances; a thousandth of the narrowest peak's width, far above the last digit."""
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
        self.A, self.dt = A, dt
        self._longer: Recursion | None = None
        self.Phi, phi = exponentials(A * dt)
        self.Gamma = phi * dt
        self.block = max(1, int(np.sqrt(steps)))
        powers = [np.eye(len(A))]
        with np.errstate(over="ignore", invalid="ignore"):  # as in `run`: numbers tried on the way
            for _ in range(self.block):
                powers.append(self.Phi @ powers[-1])
        self._whole = powers.pop()
        self._ends = np.concatenate(powers[::-1], axis=1)

    def with_steps(self, dt: float, steps: int) -> "Recursion":
        """Return the same with steps of another length; the last one asked for is kept."""
        if self._longer is None or self._longer.dt != dt:
            self._longer = Recursion(self.A, dt, steps)
        return self._longer

    def run(self, x0: Floats, w: Floats) -> Floats:
        """Run from `x0` (D, P) under `w` (N, D, P): states (N + 1, D, P), the start first.

        Numbers that a fit tries on its way may run away: the result is then infinite or not a number. The result's
        time runs fastest in memory; `w` is read quickest when its does too.
        """
        N, D, P = w.shape
        out = np.empty((P, D, N + 1))
        w = w.transpose(2, 1, 0)
        with np.errstate(over="ignore", invalid="ignore"):
            some = max(1, CACHE // (N * D))
            for first in range(0, P, some):
                columns = slice(first, first + some)
                self._run(x0[:, columns], w[columns], out[columns])
        return out.transpose(2, 1, 0)

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
        # where each block would end if it started from zero; then where it starts; then every step of all blocks
        ends = (self._ends @ drive.reshape(m * D, P * blocks)).reshape(D, P, blocks)
        starts = np.empty((D, P, blocks))
        x = x0
        for b in range(blocks):
            starts[..., b] = x
            x = self._whole @ x + ends[..., b]
        z = starts.reshape(D, P * blocks)
        for step in drive:
            step += self.Phi @ z
            z = step
        states = drive.reshape(m, D, P, blocks)
        out[..., 0] = x0.T
        out[..., 1 : full * m + 1].reshape(P, D, full, m)[...] = states[..., :full].transpose(2, 1, 3, 0)
        if rest:
            out[..., full * m + 1 :] = states[:rest, ..., full].transpose(2, 1, 0)


def exponentials(Z: Floats) -> tuple[Floats, Floats]:
    r"""Matrix functions e^Z and φ₁(Z) = ∫₀¹ e^{Zs} ds, by Taylor's series of a share of Z that is doubled back.

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
        phi = one + small @ phi / k
    e = one + small @ phi
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(doublings):
            phi = 0.5 * (phi + e @ phi)
            e = e @ e
    return e, phi


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
    only_start : bool
        Whether the balances stay as they are.
    """

    numbers: Numbers
    memory: Memory
    step: float
    start: tuple[Floats, ...]
    only_start: bool = False


def cut(u: Drive, first: int, last: int) -> Drive:
    """Intervals `first` to `last` (not included) of a drive."""
    if first == 0 and last == u.N:
        return u
    return _map(u, lambda x: x[first:last])


def average(u: Drive) -> Drive:
    """One interval that holds the means of all; voltage as far as it was there."""
    return _map(u, lambda x: np.atleast_1d(np.nanmean(x)) if np.isfinite(x).any() else x[:1])


def at_instants(u: Drive) -> Drive:
    """Return the inputs at the N + 1 instants between and around the intervals: means of the neighbours."""
    return _map(u, _between)


def every_second(u: Drive, spans: Sequence[Span]) -> tuple[Drive, tuple[Span, ...], NDArray[np.intp]]:
    """Join the intervals of each span two by two; an odd last one is left out.

    Returns
    -------
    u : Drive
        Means over the pairs.
    spans : tuple of Span
    rows : ndarray of int
        Rows of a trajectory under the old drive at the instants of the new one.
    """
    pairs, new, rows, row, last = [], [], [], 0, 0
    for s in spans:
        half = len(s) // 2
        pairs.append(s.first + 2 * np.arange(half))
        rows.append(row + 2 * np.arange(half + 1))
        new.append(Span(last, last + half))
        row, last = row + len(s) + 1, last + half
    k = np.concatenate(pairs)
    return replace(_map(u, lambda x: 0.5 * (x[k] + x[k + 1])), dt=2.0 * u.dt), tuple(new), np.concatenate(rows)


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
        Sweeps that add what the reference Jacobian does not hold; none are needed where an effect is steep.

    Returns
    -------
    ndarray (N + spans, D, P)
    """
    D, P = X.shape[1], len(variations)
    parts = []
    row = 0
    for i, span in enumerate(spans):
        rows = slice(row, row + len(span) + 1)
        row = rows.stop
        part_u = cut(u, span.first, span.last)
        at = slice(span.first, span.last)
        memories = [{k: m[at] for k, m in c.memory.items()} for c in variations]
        x_mean = _means(X[rows])
        f0 = physics.rates(x_mean, part_u, v, {k: m[at] for k, m in memory.items()})
        g = np.empty((P, D, len(span)))  # time runs fastest, as in a column of the recursion
        for j, (c, m) in enumerate(zip(variations, memories, strict=True)):
            if c.only_start:
                g[j] = 0.0
            else:
                np.subtract(physics.rates(x_mean, part_u, c.numbers, m).T, f0.T, out=g[j])
                g[j] /= c.step
        x0 = np.stack([c.start[i] for c in variations], axis=-1)
        if physics.steep:
            here = {k: m[at] for k, m in memory.items()}
            parts.append(_stepped(x0, g, _slopes(physics, x_mean, part_u, v, here, f0), recursion))
            continue
        S = recursion.run(x0, g.transpose(2, 1, 0)).transpose(2, 1, 0)
        for _ in range(refinements):
            for j, (c, m) in enumerate(zip(variations, memories, strict=True)):
                S_mean = (S[j, :, 1:] + S[j, :, :-1]) / 2.0
                np.subtract(physics.rates(x_mean + c.step * S_mean.T, part_u, c.numbers, m).T, f0.T, out=g[j])
                g[j] /= c.step
                g[j] -= recursion.A @ S_mean
            S = recursion.run(x0, g.transpose(2, 1, 0)).transpose(2, 1, 0)
        parts.append(S)
    return (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)).transpose(2, 1, 0)


def readings(physics: Physics, u: Drive, v: Numbers, memory: Memory, X: Floats, spans: Sequence[Span]) -> Floats:
    """Read thermocouples on all cells along a trajectory: ndarray (N + spans, n), °C."""
    if not physics.reads:
        return physics.surfaces(X, v)
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
        mean = _means(X)
        w = physics.rates(mean, u, v, memory) - (recursion.A @ mean.T).T
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
        if not ok:
            short = len(inputs.I) <= LEAST_INTERVALS
            X = _marched(physics, inputs, v, some, x0) if short else _halved(physics, inputs, v, some, x0, X, tolerance)
        found.append(X)
        x0 = X[-1]
    return np.concatenate([found[0][:-1], found[1]])


def _marched(physics: Physics, u: Drive, v: Numbers, memory: Memory, x0: Floats) -> Floats:
    r"""Step through a stretch by :math:`X \leftarrow X + h \varphi_1(hJ) f(X)`, J where the step begins.

    Stable however steep the balances are, where sweeps run away: a capacity that a narrow melting peak multiplies.

    References
    ----------
    Hochbruck & Ostermann, Exponential integrators, Acta Numerica 2010, section 2.4 (exponential Rosenbrock-Euler).
    """
    h = u.dt / SUBSTEPS
    X = [x0]
    for k in range(len(u.I)):
        now, some = cut(u, k, k + 1), {key: m[k : k + 1] for key, m in memory.items()}
        x = X[-1]
        for _ in range(SUBSTEPS):
            _, phi = exponentials(physics.linearised(x, now, v, some) * h)
            x = x + h * (phi @ physics.rates(x[None], now, v, some)[0])
        X.append(np.clip(x, COLD, HOT))
    return np.stack(X)


def _slopes(physics: Physics, X: Floats, u: Drive, v: Numbers, memory: Memory, f: Floats) -> Floats:
    """Jacobians (N, D, D) of the balances at states X (N, D), where they are `f`."""
    D = X.shape[1]
    moves = NUDGE * np.eye(D)
    return np.stack([(physics.rates(X + moves[d], u, v, memory) - f) / NUDGE for d in range(D)], axis=-1)


def _stepped(x0: Floats, g: Floats, J: Floats, recursion: Recursion) -> Floats:
    r"""Solve for sensitivities (P, D, N + 1) without sweeps.

    .. math:: (1 - B_k) S_{k+1} = (\Phi + B_k) S_k + \Gamma g_k, \qquad B_k = \tfrac{1}{2} \Gamma (J_k - A)

    Parameters
    ----------
    x0 : ndarray (D, P)
    g : ndarray (P, D, N)
        Derivatives of the balances at fixed states.
    J : ndarray (N, D, D)
        Jacobians of the balances.
    recursion : Recursion
    """
    D, P = x0.shape
    B = 0.5 * recursion.Gamma @ (J - recursion.A)
    with np.errstate(over="ignore", invalid="ignore"):
        right = np.concatenate([recursion.Phi + B, recursion.Gamma @ g.transpose(2, 1, 0)], axis=2)
        solved = np.linalg.solve(np.eye(D) - B, right)
        S = np.empty((len(J) + 1, D, P))
        S[0] = x0
        for k, (M, b) in enumerate(zip(solved[..., :D], solved[..., D:], strict=True)):
            S[k + 1] = M @ S[k] + b
    return S.transpose(2, 1, 0)


def _means(X: Floats) -> Floats:
    """Means over the intervals (N, D) of states at the instants (N + 1, D), time running fastest in memory."""
    return np.asarray((X[1:] + X[:-1]).T / 2.0, order="C").T


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
