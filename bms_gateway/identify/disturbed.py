r"""A string with its disturbances, and the Kalman filter that turns residuals into white innovations.

States: [T_c1, T_s1, …, T_cn, T_sn, b_f, b_q, d_1 … d_n, s_1 … s_m]: an offset of the inlet, a heat common to the cells
and one heat per cell, all first-order (Ornstein–Uhlenbeck) processes, and the constant offsets of the m sensors.

Readings minus the undisturbed response are Gaussian. The filter factors their covariance without forming it:

.. math::
    S^{-1/2} (y - f) = \nu, \qquad
    -2 \ln p(y) = \sum_j |\nu_j|^2 + \ln \det S_j + m_j \ln 2\pi

As the filter is linear, it whitens the slopes ∂f/∂θ along with the residuals, one column each, with one covariance
recursion. Slow disturbances need no 1 Hz filter: readings are first averaged over blocks of some seconds.

The string is that of Lin et al., Eq 16-18; its disturbances are not in the paper.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bms_gateway.thermal import Disturbance, Floats, Start, StringParameters, continuous, gathered_noise, start_spread


@dataclass(frozen=True, slots=True)
class DisturbedString:
    """x⁺ = A x + w over one block; readings see C x.

    Attributes
    ----------
    A, Q, P0 : ndarray (M, M)
        Transition and noise of a block; covariance at the first block's middle.
    C : ndarray (m, M)
    """

    A: Floats
    Q: Floats
    P0: Floats
    C: Floats


class Blocks(NamedTuple):
    """Equal times over which readings are averaged.

    Attributes
    ----------
    length_s : float, s
    first_s : float, s
        From the record's first instant to the middle of the first block.
    """

    length_s: float
    first_s: float


def disturbed(
    p: StringParameters,
    sensed: tuple[int, ...],
    blocks: Blocks,
    disturbance: Disturbance,
    offset_sd: float,
    start: Start,
) -> DisturbedString:
    """Build the disturbed string.

    Parameters
    ----------
    p : StringParameters
    sensed : tuple of int
        0-based cells whose surface is read.
    blocks : Blocks
    disturbance : Disturbance
    offset_sd : float, K
        Of each sensor's constant offset.
    start : Start
        Uncertainty at the record's first instant.
    """
    s = continuous(p)
    (N, n), m = s.B_q.shape, len(sensed)
    M = N + 2 + n + m
    inlet, heat, own = N, N + 1, np.arange(N + 2, N + 2 + n)
    A = np.zeros((M, M))
    A[:N, :N], A[:N, inlet], A[:N, heat], A[:N, own] = s.A, s.B_f, s.B_q.sum(axis=1), s.B_q
    slow = np.arange(N, N + 2 + n)
    A[slow, slow] = -1.0 / disturbance.correlation
    sd = np.r_[disturbance.inlet, disturbance.heat_common, np.full(n, disturbance.heat_cell)]
    W, P = np.zeros((M, M)), np.zeros((M, M))
    W[slow, slow] = 2.0 * sd**2 / disturbance.correlation
    P[slow, slow] = sd**2
    P[:N, :N] = start_spread(n, start)
    P[N + 2 + n :, N + 2 + n :] = offset_sd**2 * np.eye(m)
    Phi, Q = gathered_noise(A, W, blocks.length_s)
    Phi_0, Q_0 = gathered_noise(A, W, blocks.first_s)
    C = np.zeros((m, M))
    C[np.arange(m), 2 * np.asarray(sensed) + 1] = 1.0
    C[np.arange(m), N + 2 + n + np.arange(m)] = 1.0
    return DisturbedString(Phi, Q, Phi_0 @ P @ Phi_0.T + Q_0, C)


def whiten(d: DisturbedString, columns: Floats, count: Floats, sensor_sd: float) -> tuple[Floats, float]:
    """Whiten columns of block means.

    Parameters
    ----------
    d : DisturbedString
    columns : ndarray (B, m, q)
        Residuals and other columns to be filtered alike; ignored where `count` is 0.
    count : ndarray (B, m)
        Readings in each mean.
    sensor_sd : float, K
        White noise of one reading.

    Returns
    -------
    white : ndarray (B, m, q)
        Innovations in units of their sd; 0 where there was no reading.
    log_det : float
        ln det of the readings' covariance.
    """
    blocks, m, q = columns.shape
    M = len(d.A)
    white = np.zeros((blocks, m, q))
    log_det = 0.0
    x, P = np.zeros((M, q)), d.P0
    noise = sensor_sd**2 / np.maximum(count, 1.0)
    there = count > 0
    for b in range(blocks):
        if there[b].any():
            rows = there[b].nonzero()[0]
            C = d.C[rows]
            U = P @ C.T
            S = C @ U
            S[np.diag_indices_from(S)] += noise[b, rows]
            L = np.linalg.cholesky(S)
            both = np.linalg.solve(L, np.concatenate([U.T, columns[b, rows] - C @ x], axis=1))
            W, nu = both[:, :M], both[:, M:]
            white[b, rows] = nu
            log_det += 2.0 * float(np.log(np.diag(L)).sum())
            x = x + W.T @ nu
            P = P - W.T @ W
        x = d.A @ x
        P = d.A @ P @ d.A.T + d.Q
        P = (P + P.T) / 2.0
    return white, log_det
