r"""Many strings of equal length as one stacked linear model with its disturbances.

Two errors are common to all cells of a string: heat (current sensor, R_e) and coolant (the inlet thermocouple is not at
the first cell). Each is one more state, a first-order (Ornstein–Uhlenbeck) process:

.. math::
    x = [T_{c1}, T_{s1}, \dots, T_{cn}, T_{sn}, b_f, b_q], \qquad
    \dot b = -b/\tau + w, \quad \operatorname{var} b = \sigma^2

with b_f [K] added to the measured inlet and b_q [W] to the heat of every cell. Differences between cells are white
noise on each core, of the same low-frequency intensity 2τσ². Through this correlation a sensor also informs about cells
without one: with independent noise per cell, these would be as slow as an open loop.

Where readings show that cells differ for an unknown reason (`Disturbance.cooling_cell`), the cooling of each cell has
an offset as well, a process of the same kind. These n offsets [W] act on the surfaces; in x they stand between the
temperatures and b_f.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import (
    ContinuousString,
    Disturbance,
    Floats,
    Start,
    StringModel,
    StringParameters,
    continuous,
    discretize,
    gathered_noise,
    start_spread,
)

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

OFFSETS = 2
"""States after the temperatures: inlet offset b_f at −2 and common heat offset b_q at −1."""
_INLET, _HEAT = -2, -1


@dataclass(frozen=True, slots=True)
class StackedModel:
    """x⁺ = A x + B_q q̄ + B_f0 T_f + B_f1 T_f⁺ + w for S strings of n cells, M = 2n + 2 states each, or 3n + 2.

    Attributes
    ----------
    G : ndarray (S, M, M + n + 2)
        [A, B_q, B_f0, B_f1] side by side: one product advances a string.
    Q : ndarray (S, M, M), K²
        Noise integrated over the step, exact.
    Q_unknown : ndarray (2, S, M, M), K²
        Addition while the inlet, or the current, is not measured.
    dt : float, s
    disturbance : Disturbance

    References
    ----------
    Lin et al., Eq 18; the offsets are not in the paper.
    """

    G: Floats
    Q: Floats
    Q_unknown: Floats
    dt: float
    disturbance: Disturbance

    @property
    def strings(self) -> int:
        """Number of strings S."""
        return int(self.G.shape[0])

    @property
    def states(self) -> int:
        """States per string M."""
        return int(self.G.shape[1])

    @property
    def cells(self) -> int:
        """Cells per string n."""
        return int(self.G.shape[2]) - self.states - OFFSETS

    @property
    def A(self) -> Floats:
        """Transition (S, M, M), a view."""
        return self.G[:, :, : self.states]

    def advance(self, x: Floats, heat: Floats, inlet0: Floats, inlet1: Floats) -> Floats:
        """Advance the mean one step.

        Parameters
        ----------
        x : ndarray (S, M)
        heat : ndarray (S, n), W
            Mean of the step.
        inlet0, inlet1 : ndarray (S,), °C
            Measured inlet at the start and the end of the step.

        Returns
        -------
        ndarray (S, M)
        """
        return self.moved(self.inputs(x, heat, inlet0, inlet1))

    @staticmethod
    def inputs(x: Floats, heat: Floats, inlet0: Floats, inlet1: Floats) -> Floats:
        """Put state and inputs of a step side by side: (S, M + n + 2), in the order of `G`."""
        return np.concatenate((x, heat, inlet0[:, None], inlet1[:, None]), axis=1)

    def moved(self, u: Floats) -> Floats:
        """State (S, M) at the end of a step with state and inputs `u`."""
        return np.asarray(np.matmul(self.G, u[:, :, None])[:, :, 0], dtype=np.float64)

    def noise(self, at: Ints, known: Bools) -> Floats:
        """Noise of the step for the strings `at` (s,), whose `known` (s, 2) tells if inlet and current are measured."""
        Q = self.Q[at]
        for which, unknown in enumerate(~known.T):
            if unknown.any():
                Q[unknown] += self.Q_unknown[which, at[unknown]]
        return Q

    def exchanged(self, at: Ints, part: "StackedModel") -> "StackedModel":
        """Replace the strings `at` by those of `part`."""
        G, Q, Q_unknown = self.G.copy(), self.Q.copy(), self.Q_unknown.copy()
        G[at], Q[at], Q_unknown[:, at] = part.G, part.Q, part.Q_unknown
        return StackedModel(G, Q, Q_unknown, self.dt, self.disturbance)


def augmented(p: StringParameters, disturbance: Disturbance, *, by_resistance: bool = False) -> ContinuousString:
    """Continuous system of one string with its two offset states; `B_q` has one column per cell.

    The offset of heat is the same for all cells, or in proportion to their R_e as of an unseen current.

    References
    ----------
    Lin et al., Eq 18; the offsets are not in the paper.
    """
    s = continuous(p)
    N, n = s.B_q.shape
    own = n if disturbance.cooling_cell else 0
    M = N + own + OFFSETS
    A = np.zeros((M, M))
    A[:N, :N] = s.A
    if own:
        k = np.arange(n)
        A[2 * k + 1, N + k] = 1.0 / p.C_s
        A[N + k, N + k] = -1.0 / disturbance.correlation
    A[:N, _INLET] = s.B_f
    A[:N, _HEAT] = s.B_q @ (p.R_e / np.mean(p.R_e)) if by_resistance else s.B_q.sum(axis=1)
    A[_INLET, _INLET] = A[_HEAT, _HEAT] = -1.0 / disturbance.correlation
    return ContinuousString(A, np.vstack((s.B_q, np.zeros((M - N, n)))), np.append(s.B_f, np.zeros(M - N)))


def stack(
    parameters: Sequence[StringParameters], dt: float, disturbance: Disturbance, *, by_resistance: bool = False
) -> StackedModel:
    """Discretise strings of equal length into one stacked model.

    Parameters
    ----------
    parameters : sequence of StringParameters
        S strings, each with the same number of cells.
    dt : float, s
        Step of any length, also a parked night.
    disturbance : Disturbance
    by_resistance : bool
        Whether the offset of heat is divided between the cells by their R_e.

    Returns
    -------
    StackedModel

    Raises
    ------
    ConfigError
        Bulk coolant node outside its validity (see `thermal.exchange`).

    Notes
    -----
    About 3 ms per distinct string of 12 cells; equal strings share the work.

    References
    ----------
    Lin et al., Eq 13 and 18, sampled.

    Examples
    --------
    >>> p = StringParameters.of(3, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=4, C_f=11.33)
    >>> m = stack([p, p], 1.0, Disturbance())
    >>> x = np.hstack((np.full((2, 6), 25.0), np.zeros((2, 2))))
    >>> bool(np.allclose(m.advance(x, np.zeros((2, 3)), np.full(2, 25.0), np.full(2, 25.0)), x))
    True
    """
    done: dict[tuple[object, ...], tuple[Floats, Floats, Floats]] = {}
    parts = []
    for p in parameters:
        key = (*(v.tobytes() for v in (p.C_c, p.C_s, p.R_e, p.R_c, p.R_u)), p.R_cc, p.C_f, p.coolant)
        if key not in done:
            done[key] = _discretized(augmented(p, disturbance, by_resistance=by_resistance), dt, disturbance)
        parts.append(done[key])
    G, Q, Q_unknown = (np.stack(column) for column in zip(*parts, strict=True))
    return StackedModel(G, Q, Q_unknown.swapaxes(0, 1), float(dt), disturbance)


def _discretized(s: ContinuousString, dt: float, d: Disturbance) -> tuple[Floats, Floats, Floats]:
    M = s.A.shape[0]
    step = discretize(s, dt)
    G = np.concatenate((step.A, step.B_q, step.B_f0[:, None], step.B_f1[:, None]), axis=1)
    W = noise_intensity(s.B_q, d)
    more = np.zeros((OFFSETS, M, M))
    more[0, _INLET, _INLET] = 2.0 * max(d.inlet_unknown**2 - d.inlet**2, 0.0) / d.correlation
    more[1, _HEAT, _HEAT] = 2.0 * max(d.heat_unknown**2 - d.heat_common**2, 0.0) / d.correlation
    unknown = np.stack([gathered_noise(s.A, w, dt)[1] for w in more])
    return G, gathered_noise(s.A, W, dt)[1], unknown


def noise_intensity(B_q: Floats, d: Disturbance) -> Floats:
    """Intensity (M, M) of the white noise that drives a string whose inputs are measured.

    Parameters
    ----------
    B_q : ndarray (M, n), K/J
        Rates of the states by the heat of each cell.
    d : Disturbance
    """
    W: Floats = 2.0 * d.correlation * d.heat_cell**2 * (B_q @ B_q.T)
    own = np.arange(2 * B_q.shape[1], len(B_q) - OFFSETS)
    W[own, own] = 2.0 * d.cooling_cell**2 / d.correlation
    W[_INLET, _INLET] = 2.0 * d.inlet**2 / d.correlation
    W[_HEAT, _HEAT] = 2.0 * d.heat_common**2 / d.correlation
    return W


def start_covariance(cells: int, start: Start, disturbance: Disturbance, *, inlet_known: bool = True) -> Floats:
    """Covariance of a string before its first reading; most of it is common to the cells.

    Returns
    -------
    ndarray (M, M), K² (the last row W²)
        Symmetric, positive definite.

    References
    ----------
    Lin et al., Fig 8 and 9 for what is unknown after a restart.
    """
    N = 2 * cells
    own = cells if disturbance.cooling_cell else 0
    P = np.diag(np.full(N + own + OFFSETS, disturbance.cooling_cell**2))
    P[:N, :N] = start_spread(cells, start)
    P[_INLET, _INLET] = (disturbance.inlet if inlet_known else disturbance.inlet_unknown) ** 2
    P[_HEAT, _HEAT] = disturbance.heat_common**2
    return P


def scaled(p: StringParameters, symbol: str, factor: float) -> StringParameters:
    """Multiply one number of a string."""
    return replace(p, **{symbol: getattr(p, symbol) * factor})


def usable(p: StringParameters) -> StringParameters:
    """Use the exact exchange if the flow is too low for the bulk node, which would overshoot."""
    return replace(p, coolant="ntu") if p.coolant == "bulk" and bool(np.any(p.R_u * p.C_f <= 1.0)) else p


def sensed(models: Sequence[StringModel]) -> tuple[Ints, Bools]:
    """Sensed cells (S, m) of strings, 0-based, and which of these places hold one: strings may have fewer than m."""
    widest = max(len(m.sensors) for m in models)
    sensors, fitted = np.zeros((len(models), widest), np.int64), np.zeros((len(models), widest), np.bool_)
    for s, m in enumerate(models):
        sensors[s, : len(m.sensors)] = np.array(m.sensors, np.int64) - 1
        fitted[s, : len(m.sensors)] = True
    return sensors, fitted
