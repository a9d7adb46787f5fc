r"""Steady standard deviation of each core, for any set of surface sensors of a string.

The covariance of a Kalman filter converges to the solution P of a Riccati equation. This module solves it for many sets
of sensors of one string with up to a thousand cells. Little of the work depends on the set: the covariance P_0 without
any sensor is computed once, and the reduction by m sensors has few dimensions. The Chandrasekhar recursion sums it up,

.. math::
    P_{i+1} = P_i + L_i M_i L_i^T, \qquad L_i \in R^{2n \times m},

from P_0 on, for all sets at once and without a 2n × 2n matrix per set. Steps of a second would need thousands of steps,
because of the slow poles. Therefore the equation is first transformed by z = (w + a)/(1 + a w), which maps the unit
circle onto itself and leaves P exactly unchanged. About a hundred steps are then enough for a string of any length. If
cells differ by orders of magnitude, or if P is nearly lost in the difference from P_0, sets that have not converged by
then are solved by doubling, one by one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Disturbance, Floats, StringParameters, continuous, gathered_noise
from bms_gateway.thermal.exponential import exponential

Indices = NDArray[np.intp]

SETTLED = 1e-8
"""Share of a core's variance that all further steps together may still remove."""
BLOCK = 8
"""Steps after which convergence is judged, from their effect and that of the eight before: single steps vary in
waves."""
SLOWEST = 0.999
"""Ratio of a block to the previous one above which the rest is not extrapolated: convergence has not begun."""
PATIENCE = 1_000
"""Steps after which a set is solved by doubling."""
LOST = 1e-6
"""Share of its variance without sensors below which a core's variance has too few digits as a difference."""
DENSE = 100
"""Cells up to which a set can be solved by doubling: half a second there."""
MAX_STEPS = 20_000
"""The same for longer strings, which have no other method; the remaining error is then small."""
DOUBLINGS = 60
"""Number of doublings beyond the range of a double."""
LONG = 150
"""Number of cells above which the coolant is slower along the string than a cell warms up."""
AT_ONCE = 2_000_000
"""Numbers in the L of the sets that are computed together: 16 MB."""


@dataclass(frozen=True, slots=True)
class Steady:
    """The part of the steady state of one string that does not depend on its sensors: reused for every set.

    Attributes
    ----------
    open : ndarray (2n, 2n), K²
        Error covariance P_0 with no sensor, states [T_c1, T_s1, …].
    Phi, Q : ndarray (2n, 2n)
        Transition from reading to reading, and the integrated noise.
    J, noise : ndarray (2n, 2n)
        (I − aΦ)⁻¹ and J Q Jᵀ.
    a : float
        Of the transformation, 0…1.
    sensor : float, K
        White noise of a reading.
    """

    open: Floats
    Phi: Floats
    Q: Floats
    J: Floats
    noise: Floats
    a: float
    sensor: float

    @classmethod
    def of(cls, p: StringParameters, disturbance: Disturbance | None = None, *, dt: float = 1.0) -> "Steady":
        """Prepare a string whose sensors are read every `dt` seconds.

        Notes
        -----
        Every disturbance is white here, with the low-frequency intensity 2τσ² of the slow disturbance that it replaces.
        This ranks placements by one Riccati equation of 2n states and is on the safe side: an observer with states for
        the slow errors is better by a sixth (two sensors on twelve cells) to a half (one cell). The cost is some thirty
        products of 2n × 2n matrices: half a minute for 1,000 cells.
        """
        d = disturbance or Disturbance()
        s = continuous(p)
        common = s.B_q.sum(axis=1)
        W = d.heat_common**2 * np.outer(common, common) + d.heat_cell**2 * (s.B_q @ s.B_q.T)
        W = 2.0 * d.correlation * (W + d.inlet**2 * np.outer(s.B_f, s.B_f))
        slow = 1.0 / float(np.max(p.C_c * p.R_c + (p.C_c + p.C_s) * p.R_u))
        middle = np.sqrt(slow * float(-np.diag(s.A).min()))  # geometric mean of a cell's two poles
        P_0 = _stationary(s.A, W, 2.0 / middle)
        if p.cells <= DENSE:
            Phi, Q = gathered_noise(s.A, W, dt)
        else:  # the same in a tenth of the time
            Phi = exponential(s.A * dt)
            Q = P_0 - Phi @ P_0 @ Phi.T
        # Any a gives the same P; this one needs the fewest steps. Readings make the fast poles faster, hence above the
        # middle; the coolant along a long string is slow.
        swift = 3.0 if p.cells <= LONG else 1.5
        a = float(np.exp(-np.clip(swift * middle * dt, 1e-4, 2.0)))
        J = np.linalg.inv(np.eye(len(Phi)) - a * Phi).astype(np.float64, copy=False)
        return cls(P_0, Phi, Q, J, J @ Q @ J.T, a, d.sensor)

    def core_sd(self, sets: Sequence[Sequence[int]]) -> Floats:
        """Compute the steady standard deviation of each core, right after a reading.

        Parameters
        ----------
        sets : sequence of sequences of int
            Sets of 1-based cells read in every step; the empty set is allowed.

        Returns
        -------
        ndarray (len(sets), n), K
            For exact parameters.

        References
        ----------
        T. Kailath, Some new algorithms for recursive estimation in constant linear systems, IEEE TIT 19 (1973).
        """
        sd = np.empty((len(sets), len(self.open) // 2))
        by_size = sorted(range(len(sets)), key=lambda i: len(sets[i]))
        for m, members in groupby(by_size, key=lambda i: len(sets[i])):
            which = list(members)
            step = max(1, AT_ONCE // (len(self.open) * max(m, 1)))
            for i in range(0, len(which), step):
                part = which[i : i + step]
                measured = 2 * np.array([list(sets[j]) for j in part], np.intp).reshape(len(part), m) - 1
                variance, sound = self._core_variance(measured)
                if len(self.open) <= 2 * DENSE:
                    for j in np.flatnonzero(~sound):
                        variance[j] = self._doubled(measured[j])
                sd[part] = np.sqrt(variance)
        return sd

    def _core_variance(self, measured: Indices) -> tuple[Floats, NDArray[np.bool_]]:
        """Variance of the cores (S, n) for sets (S, m) of measured states, and whether it is sound (S,)."""
        S, m = measured.shape
        variance = np.tile(np.diag(self.open)[0::2], (S, 1))
        sound = np.ones(S, bool)
        if not m:
            return variance, sound
        a, b = self.a, np.sqrt(1.0 - self.a**2)
        white = self.sensor**2 * np.eye(m)
        # After the transformation, a reading C x is b C J x + a C J u, with u the noise that drives x: the two are
        # correlated.
        crossed = _columns(self.noise, measured)
        PC = b * _product(self.open, self.J[measured].swapaxes(1, 2))
        JPC = _product(self.J, PC)
        E = white + a * a * _rows(crossed, measured) + b * _rows(JPC, measured)
        K = self._onward(PC, JPC) + a * b * crossed
        E_inverse = np.linalg.inv(E)
        L, M = K, -E_inverse
        read = _columns(self.open, measured)  # P Cᵀ before the transformation, for the last reading
        settled, at, going = np.empty_like(read), measured, np.arange(S)
        before, block = np.zeros_like(variance), np.zeros_like(variance)
        for step in range(1, (PATIENCE if len(self.open) <= 2 * DENSE else MAX_STEPS) + 1):
            LM = L @ M
            block += np.einsum("snm,snm->sn", LM[:, 0::2], L[:, 0::2])
            read += LM @ _rows(L, at).swapaxes(1, 2)
            if step % BLOCK == 0:
                variance[going] += block
                ratio = np.divide(block, before, out=np.full_like(block, SLOWEST), where=before < 0.0)
                ratio = ratio.clip(0.0, SLOWEST)
                on = (-block * ratio > (1.0 - ratio) * SETTLED * variance[going]).any(axis=1)
                settled[going] = read
                if not on.any():
                    going = going[:0]
                    break
                before, block = block[on], np.zeros_like(block[on])
                going, at = going[on], at[on]
                read, L, M, K, E, E_inverse = (x[on] for x in (read, L, M, K, E, E_inverse))
            JL = _product(self.J, L)
            CL, FL = b * _rows(JL, at), self._onward(L, JL)
            D = M @ CL.swapaxes(1, 2)
            L = FL - K @ (E_inverse @ CL)
            K = K + FL @ D
            E = E + CL @ D
            E_inverse = np.linalg.inv(E)
            M = M - D @ E_inverse @ D.swapaxes(1, 2)
        taken = settled * np.linalg.solve(_rows(settled, measured) + white, settled.swapaxes(1, 2)).swapaxes(1, 2)
        left: Floats = variance - taken[:, 0::2].sum(axis=2)
        sound[going] = False
        sound &= (left >= LOST * np.diag(self.open)[0::2]).all(axis=1)
        return left, sound

    def _doubled(self, measured: Indices) -> Floats:
        """Variance of the cores (n,) by the structure-preserving doubling algorithm, for one set of states."""
        one, C = np.eye(len(self.open)), np.eye(len(self.open))[measured]
        white = self.sensor**2 * np.eye(len(measured))
        A, G, P = self.Phi.T, C.T @ C / self.sensor**2, self.Q
        for _ in range(DOUBLINGS):
            W = np.linalg.inv(one + G @ P)
            V = W @ A
            more = A.T @ P @ V
            P = P + more
            if not (np.diag(more) > SETTLED**2 * np.diag(P)).any():
                break
            A, G = A @ V, G + A @ W @ G @ A.T
        left = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + white, C @ P)
        return np.diag(left)[0::2].copy()

    def _onward(self, X: Floats, JX: Floats) -> Floats:
        """Transition after the transformation, J(Φ − a), applied to X whose product J X is known."""
        after: Floats = (1.0 / self.a - self.a) * JX - X / self.a
        return after


def steady_core_sd(p: StringParameters, sensors: Sequence[int], disturbance: Disturbance | None = None) -> Floats:
    """Compute the steady standard deviation of each core, with the parameters taken as true.

    Parameters
    ----------
    p : StringParameters
    sensors : sequence of int
        1-based cells, read every second.
    disturbance : Disturbance, optional

    Returns
    -------
    ndarray (n,), K

    Notes
    -----
    See `Steady`, which is better for several sets of one string.

    References
    ----------
    The string of Lin et al., Eq 16–18 and 21, corrected, under `Disturbance`; the paper itself has no such measure.

    Examples
    --------
    >>> p = StringParameters.of(12, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79, R_cc=32, C_f=11.33)
    >>> for sensors in [(), (12,), (1, 12), (3, 6, 9, 12)]:
    ...     print(sensors, round(float(steady_core_sd(p, sensors).max()), 3))
    () 1.411
    (12,) 0.732
    (1, 12) 0.483
    (3, 6, 9, 12) 0.493
    """
    (sd,) = Steady.of(p, disturbance).core_sd([sensors])
    return np.asarray(sd)


def _stationary(A: Floats, W: Floats, h: float) -> Floats:
    """Solve A P + P Aᵀ + W = 0 by doubling (Smith), in steps of `h` s of the bilinear rule, which does not change P."""
    one = np.eye(len(A))
    J = np.linalg.inv(one - h / 2.0 * A)
    F, P = 2.0 * J - one, h * (J @ W @ J.T)
    for _ in range(DOUBLINGS):
        more = F @ P @ F.T
        P = P + more
        if not (np.diag(more) > 1e-12 * np.diag(P)).any():
            break
        F = F @ F
    return (P + P.T) / 2.0


def _product(X: Floats, Y: Floats) -> Floats:
    """Multiply X (N, N) with every Y (S, N, m) at once: numpy would read all of X once per set."""
    S, N, m = Y.shape
    flat = X @ np.moveaxis(Y, 1, 0).reshape(N, S * m)
    return np.ascontiguousarray(np.moveaxis(flat.reshape(N, S, m), 0, 1))


def _columns(X: Floats, at: Indices) -> Floats:
    """Columns of X (N, N) by sets (S, m): (S, N, m)."""
    return np.ascontiguousarray(np.moveaxis(X[:, at], 0, 1))


def _rows(X: Floats, at: Indices) -> Floats:
    """Rows of each X (S, N, m) by sets (S, m): (S, m, m)."""
    return np.take_along_axis(X, at[:, :, None], axis=1)
