r"""Free-running trajectories of a string with any effects, and their sensitivities, over a whole record at once.

The balances f (`Physics.rates`) are split at a reference Jacobian A about the record's mean. With X̄ the mean of a
state over an interval and ū the mean inputs,

.. math::
    X_{k+1} = \Phi X_k + \Gamma \bigl(f(\bar X_k, \bar u_k) - A \bar X_k\bigr), \qquad
    \Phi = e^{A \Delta t}, \; \Gamma = \int_0^{\Delta t} e^{A s} ds

is an exponential integrator of second order (Hochbruck & Ostermann 2010) that solves a linear string exactly. It is
solved by waveform relaxation. Each sweep computes the bracket along the last trajectory, in one call for all intervals,
and then runs the linear recursion. The error that remains (a resistance that depends on temperature and a changing flow
are not in A) becomes smaller with every sweep. A span whose sweeps do not converge as a whole is solved in pieces.

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
DIVERGING, SLOW = 1.5, 0.8
"""Sweeps end without a result where a change is larger than the one before by the first factor; from the fifth sweep on
by the second. Of the sweeps that converge, one in a hundred has grown so at the third."""
EDGE = 0.25
"""Share of the tolerance below which a part of a trajectory is settled if the rest of it is not."""
LEAST_INTERVALS, LEAST_NEAR = 8, 32
"""A span whose sweeps do not converge is solved in pieces, because sweeps of a shorter stretch converge faster. A
stretch with fewer intervals than the first is solved step by step instead, and one with fewer than the second begins
without the guess: near a peak, a guess from other numbers can be on its other side."""
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
    pieces: bool = True,
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
    pieces : bool
        Whether a span on which the sweeps do not converge is solved in pieces on which they do. A recursion about these
        very numbers is a better first choice.

    Returns
    -------
    X : ndarray (N + spans, D)
        States at the instants; a span of k intervals has k + 1 of them. With one span N + 1.
    settled : bool
        Whether the sweeps converged everywhere.
    """
    parts, settled = [], True
    for x0, (rows, part) in zip(starts, system.parts(), strict=True):
        X, of_it = _relax(part, x0, recursion, None if guess is None else guess[rows], tolerance)
        whole = of_it == part.u.N
        if not whole and pieces:
            X = _piecewise(part, x0, X if guess is None else guess[rows], tolerance, near=guess is not None)
        parts.append(X)
        settled = settled and whole
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
) -> tuple[Floats, int]:
    """Sweep until the trajectory (N + 1, D) is settled; return it and for how many intervals it is."""
    N = system.u.N
    X = np.tile(x0, (N + 1, 1)) if guess is None else guess
    last, moved = np.inf, np.empty((N + 1, len(x0)))
    for sweep in range(SWEEPS):
        mean = _means(X)
        w = system.rates(mean) - (recursion.A @ mean.T).T
        new = recursion.run(x0[:, None], w[..., None])[..., 0]
        np.minimum(np.maximum(new, COLD, out=new), HOT, out=new)
        moved = np.abs(new - X)
        change = float(moved.max())
        X = new
        if change < tolerance:
            return X, N
        if not np.isfinite(change) or (sweep > 1 and change > (SLOW if sweep > 3 else DIVERGING) * last):
            break
        last = change
    # what an interval does depends on those before it alone, so the first ones are settled while later ones are not
    unsettled = ~(moved < EDGE * tolerance).all(axis=1)
    return X, max(0, int(np.argmax(unsettled)) - 1)


def _piecewise(system: System, x0: Floats, guess: Floats, tolerance: float, *, near: bool) -> Floats:
    """Solve stretch after stretch, each from the end of the one before it and about its own mean.

    A stretch is as long as its sweeps allow: it ends where they have not settled, and the next one is twice as long as
    what was settled. Sweeps of a long stretch begin with the guess if it is `near` the result.
    """
    N = system.u.N
    found, around = np.empty_like(guess), guess.copy()
    found[0] = x0
    first, length = 0, N // 2
    while first < N:
        last = min(first + length, N)
        part, rows = system.cut(first, last), slice(first, last + 1)
        recursion = reference(part, np.clip(around[rows].mean(axis=0), COLD, HOT))
        X, settled = _relax(
            part, found[first], recursion, guess[rows] if near and part.u.N > LEAST_NEAR else None, tolerance
        )
        if settled < min(part.u.N, LEAST_INTERVALS):
            if part.u.N > LEAST_INTERVALS:
                length, around[rows] = part.u.N // 2, X
                continue
            X, settled = _marched(part, found[first]), part.u.N
        found[first : first + settled + 1] = X[: settled + 1]
        first, length = first + settled, max(2 * settled, LEAST_INTERVALS)
    return found


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
        for M, b, now, after in zip(solved[..., :D], solved[..., D:], S[:-1], S[1:], strict=True):
            np.matmul(M, now, out=after)
            after += b
    return S.transpose(2, 1, 0)


def _means(X: Floats) -> Floats:
    """Means over the intervals (N, D) of states at the instants (N + 1, D), time running fastest in memory."""
    return np.asarray((X[1:] + X[:-1]).T / 2.0, order="C").T
