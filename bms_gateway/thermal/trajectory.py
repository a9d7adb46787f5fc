r"""Free-running trajectories of a string with any effects, and their sensitivities, over a whole record at once.

The balances f (`Physics.rates`) are split at a reference Jacobian A about the record's mean. With X̄ the mean of a
state over an interval and ū the mean inputs,

.. math::
    X_{k+1} = \Phi X_k + \Gamma \bigl(f(\bar X_k, \bar u_k) - A \bar X_k\bigr), \qquad
    \Phi = e^{A \Delta t}, \; \Gamma = \int_0^{\Delta t} e^{A s} ds

is an exponential integrator of second order (Hochbruck & Ostermann 2010) that solves a linear string exactly. It is
solved by waveform relaxation. Each sweep computes the bracket along the last trajectory, in one call for all intervals,
and then runs the linear recursion. The error that remains (a resistance that depends on temperature and a changing flow
are not in A) becomes smaller with every sweep. The recursion runs blockwise, with about √N steps of large products
instead of N small ones.

Sensitivities S = ∂X/∂θ follow the same recursion, driven by finite differences of f along the trajectory. With a steep
effect (a narrow melting peak multiplies the capacity) their sweeps converge too slowly, and sensitivities that have not
converged make a fit stop at wrong numbers with a narrow band. They are then stepped with the Jacobian of each interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.physics import Memory, Numbers
from bms_gateway.thermal.recursion import Recursion, exponentials
from bms_gateway.thermal.system import System

TOLERANCE = 2e-4
"""K: sweeps end when the trajectory changes by less; a hundredth of the noise of the best thermocouples."""
SWEEPS = 15
LEAST_INTERVALS = 8
"""A stretch whose sweeps do not converge is halved, because sweeps of a shorter stretch converge faster. A stretch with
fewer intervals than this is solved step by step instead."""
SUBSTEPS = 8
"""Steps of each interval that is solved step by step: a surface passes a narrow melting peak in several of them."""
NUDGE = 1e-4
"""K: step for slopes of the balances; a thousandth of the width of the narrowest peak, far above rounding."""
COLD, HOT = -200.0, 1000.0
"""°C: bounds of a trajectory. A trajectory that diverges is held there, so that a fit can go back to better numbers."""


@dataclass(frozen=True, slots=True)
class Variation:
    """One direction in which parameters and start may change, for `sensitivities`.

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


def reference(system: System, X: Floats) -> Recursion:
    """Linear recursion about the mean of inputs and of a guessed state `X` (D,)."""
    return Recursion(system.linearised(X), system.u.dt, system.u.N)


def simulate(
    system: System,
    starts: Sequence[Floats],
    recursion: Recursion,
    guess: Floats | None = None,
    tolerance: float = TOLERANCE,
    *,
    halve: bool = True,
) -> tuple[Floats, bool]:
    """Run the string freely over a record.

    Parameters
    ----------
    system : System
    starts : sequence of ndarray (D,)
        State at the start of each span, °C.
    recursion : Recursion
        From `reference`; any near one is enough, its influence on the result is of the order of dt².
    guess : ndarray (N + 1, D), optional
        A trajectory near the result saves sweeps.
    tolerance : float, K
    halve : bool
        Whether a span on which the sweeps do not converge is halved until they do. A recursion about these very numbers
        is a better first choice.

    Returns
    -------
    X : ndarray (N + spans, D)
        States at the instants; a span of k intervals has k + 1 of them. With one span N + 1.
    settled : bool
        Whether the sweeps converged everywhere.
    """
    parts, settled = [], True
    for x0, (rows, part) in zip(starts, system.parts(), strict=True):
        X, ok = _relax(part, x0, recursion, None if guess is None else guess[rows], tolerance)
        if not ok and halve:
            X = _halved(part, x0, X, tolerance)
        parts.append(X)
        settled = settled and ok
    return np.concatenate(parts), settled


def sensitivities(
    system: System,
    X: Floats,
    recursion: Recursion,
    variations: Sequence[Variation],
    refinements: int = 1,
) -> Floats:
    """Differentiate a trajectory with respect to several numbers.

    Parameters
    ----------
    system : System
    X : ndarray (N + spans, D)
        From `simulate`.
    recursion : Recursion
    variations : sequence of Variation, P
    refinements : int
        Sweeps that add what the reference Jacobian lacks; not needed if an effect is steep.

    Returns
    -------
    ndarray (N + spans, D, P)
    """
    D, P = X.shape[1], len(variations)
    varied = [list(replace(system, v=c.numbers, memory=c.memory).parts()) for c in variations]
    parts = []
    for i, (rows, part) in enumerate(system.parts()):
        moved = [v[i][1] for v in varied]
        x_mean = _means(X[rows])
        f0 = part.rates(x_mean)
        g = np.empty((P, D, part.u.N))  # time runs fastest, as in a column of the recursion
        for j, (c, s) in enumerate(zip(variations, moved, strict=True)):
            if c.only_start:
                g[j] = 0.0
            else:
                np.subtract(s.rates(x_mean).T, f0.T, out=g[j])
                g[j] /= c.step
        x0 = np.stack([c.start[i] for c in variations], axis=-1)
        if system.physics.steep:
            parts.append(_stepped(x0, g, _slopes(part, x_mean, f0), recursion))
            continue
        S = recursion.run(x0, g.transpose(2, 1, 0)).transpose(2, 1, 0)
        for _ in range(refinements):
            for j, (c, s) in enumerate(zip(variations, moved, strict=True)):
                S_mean = (S[j, :, 1:] + S[j, :, :-1]) / 2.0
                np.subtract(s.rates(x_mean + c.step * S_mean.T).T, f0.T, out=g[j])
                g[j] /= c.step
                g[j] -= recursion.A @ S_mean
            S = recursion.run(x0, g.transpose(2, 1, 0)).transpose(2, 1, 0)
        parts.append(S)
    return (parts[0] if len(parts) == 1 else np.concatenate(parts, axis=2)).transpose(2, 1, 0)


def readings(system: System, X: Floats) -> Floats:
    """Read thermocouples on all cells along a trajectory: ndarray (N + spans, n), °C."""
    if not system.physics.reads:
        return system.physics.surfaces(X, system.v)
    return np.concatenate([part.at_instants().readings(X[rows]) for rows, part in system.parts()])


def _relax(
    system: System, x0: Floats, recursion: Recursion, guess: Floats | None, tolerance: float
) -> tuple[Floats, bool]:
    X = np.tile(x0, (system.u.N + 1, 1)) if guess is None else guess
    last = np.inf
    for sweep in range(SWEEPS):
        mean = _means(X)
        w = system.rates(mean) - (recursion.A @ mean.T).T
        new = np.clip(recursion.run(x0[:, None], w[..., None])[..., 0], COLD, HOT)
        change = float(np.abs(new - X).max())
        X = new
        if change < tolerance:
            return X, True
        if not np.isfinite(change) or (sweep > 3 and change > 0.8 * last):
            break
        last = change
    return X, False


def _halved(system: System, x0: Floats, guess: Floats, tolerance: float) -> Floats:
    """Solve the first half, then the second half from its end, each about its own mean."""
    N = system.u.N
    found = []
    for first, last in ((0, N // 2), (N // 2, N)):
        half = system.cut(first, last)
        recursion = reference(half, np.clip(guess[first : last + 1].mean(axis=0), COLD, HOT))
        X, ok = _relax(half, x0, recursion, None, tolerance)
        if not ok:
            X = _marched(half, x0) if half.u.N <= LEAST_INTERVALS else _halved(half, x0, X, tolerance)
        found.append(X)
        x0 = X[-1]
    return np.concatenate([found[0][:-1], found[1]])


def _marched(system: System, x0: Floats) -> Floats:
    r"""Step through a stretch by :math:`X \leftarrow X + h \varphi_1(hJ) f(X)`, with J at the start of each step.

    It is stable for any steepness where sweeps diverge: a capacity that a narrow melting peak multiplies.

    References
    ----------
    Hochbruck & Ostermann, Exponential integrators, Acta Numerica 2010, section 2.4 (exponential Rosenbrock-Euler).
    """
    h = system.u.dt / SUBSTEPS
    X = [x0]
    for k in range(system.u.N):
        now = system.cut(k, k + 1)
        x = X[-1]
        for _ in range(SUBSTEPS):
            _, phi = exponentials(now.physics.linearised(x, now.u, now.v, now.memory) * h)
            x = x + h * (phi @ now.rates(x[None])[0])
        X.append(np.clip(x, COLD, HOT))
    return np.stack(X)


def _slopes(system: System, X: Floats, f: Floats) -> Floats:
    """Jacobians (N, D, D) of the balances at states X (N, D), where their rates are `f`."""
    D = X.shape[1]
    moves = NUDGE * np.eye(D)
    return np.stack([(system.rates(X + moves[d]) - f) / NUDGE for d in range(D)], axis=-1)


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
