r"""Matrices that carry a string some minutes ahead: made once per set of parameters, used in every forecast.

With the rates A (M, M) of a string and its offsets (`model`), z' = A z + g for a constant g,

.. math::
    z(h) = \Phi_h z + \Gamma_h g, \quad \Phi_h = e^{A h}, \quad \Gamma_h = \int_0^h e^{A s} ds, \quad
    Q_h = \int_0^h e^{A s} W e^{A^T s} ds

for the steps of `ahead.PATH`; longer steps are composed of shorter ones,
:math:`\Gamma_{a+b} = \Gamma_a + \Phi_a \Gamma_b`, :math:`Q_{a+b} = \Phi_b Q_a \Phi_b^T + Q_b`.

References
----------
Lin et al., Eq 13 and 18, sampled. C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23
(1978).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bms_gateway.observe.ahead import ENDS, PATH, PATH_S, STEP_S, Course
from bms_gateway.thermal import Floats, gathered_noise
from bms_gateway.thermal.exponential import exponential

SEGMENTS = tuple(zip((0, *ENDS), ENDS, strict=False))
"""Steps over which sensitivities are carried at once."""


@dataclass(frozen=True, slots=True)
class Span:
    """One length of time: transition, its integral, and the integrated noise, (M, M) each."""

    Phi: Floats
    Gamma: Floats
    Q: Floats

    @classmethod
    def of(cls, A: Floats, W: Floats, dt: float) -> "Span":
        """Discretise the rates `A` with white noise of intensity `W` over `dt` s."""
        M = len(A)
        F = np.zeros((2 * M, 2 * M))
        F[:M, :M], F[:M, M:] = A * dt, np.eye(M) * dt
        E = exponential(F)
        return cls(E[:M, :M].copy(), E[:M, M:].copy(), gathered_noise(A, W, dt)[1])

    def then(self, other: "Span") -> "Span":
        """Append another span."""
        Q = other.Phi @ self.Q @ other.Phi.T + other.Q
        return Span(other.Phi @ self.Phi, self.Gamma + self.Phi @ other.Gamma, (Q + Q.T) / 2.0)


@dataclass(frozen=True, slots=True)
class Reach:
    """All matrices of one string's forecast.

    Attributes
    ----------
    path : ndarray (K, M, M + g)
        State at the steps of `PATH` by the present state and the g inputs.
    Phi : ndarray (H, N, M)
        Temperatures at `ENDS` by the present state; N = 2n.
    Q : ndarray (3, H, n), K²
        Variances of cores and surfaces, and their covariance, integrated from now on.
    carry, gather : ndarray (H, M, M)
        Φ and Γ of the segments between `ENDS`.
    by_path, by_now : ndarray (n, K, K + 1), (n, K)
        Lag of the rolls' profiles at `PATH` by the differences core to surface on the way, and by the present lag.
    """

    path: Floats
    Phi: Floats
    Q: Floats
    carry: Floats
    gather: Floats
    by_path: Floats
    by_now: Floats

    @classmethod
    def of(cls, A: Floats, B: Floats, W: Floats, tau: Floats) -> "Reach":
        """Build it from rates `A` (M, M), inputs `B` (M, g), noise `W` (M, M), and time constants of rolls (n,), s."""
        n, M = len(tau), len(A)
        made = {1: Span.of(A, W, STEP_S)}

        def of_steps(k: int) -> Span:
            if k not in made:
                half = k // 2
                made[k] = of_steps(half).then(of_steps(k - half))
            return made[k]

        at = {0: Span(np.eye(M), np.zeros((M, M)), np.zeros((M, M)))}
        for a, b in pairwise((0, *PATH)):
            at[b] = at[a].then(of_steps(b - a)) if a else of_steps(b)
        path = np.stack([np.hstack((at[k].Phi, at[k].Gamma @ B)) for k in PATH])
        Q = np.stack([at[k].Q for k in ENDS])
        core, surface = np.arange(0, 2 * n, 2), np.arange(1, 2 * n, 2)
        noise = np.stack((Q[:, core, core], Q[:, surface, surface], Q[:, core, surface]))
        segments = [of_steps(b - a) for a, b in SEGMENTS]
        return cls(
            path,
            np.stack([at[k].Phi[: 2 * n] for k in ENDS]),
            noise,
            np.stack([s.Phi for s in segments]),
            np.stack([s.Gamma for s in segments]),
            *_lags(tau),
        )


def _lags(tau: Floats) -> tuple[Floats, Floats]:
    """Weights of a first-order lag with time constants `tau` (n,), for an input linear between the instants of a path.

    Returns
    -------
    by_path, by_now : ndarray (n, K, K + 1), (n, K)
    """
    K = len(PATH)
    by_path, by_now = np.zeros((len(tau), K, K + 1)), np.zeros((len(tau), K))
    weights, left = np.zeros((len(tau), K + 1)), np.ones(len(tau))
    for k, h in enumerate(np.diff(PATH_S)):
        a = np.exp(-h / np.maximum(tau, 1e-6))
        ramp = 1.0 - np.maximum(tau, 1e-6) / h * (1.0 - a)
        weights = weights * a[:, None]
        weights[:, k] += (1.0 - a) - ramp
        weights[:, k + 1] += ramp
        left = left * a
        by_path[:, k], by_now[:, k] = weights, left
    return by_path, by_now


def course(path: Floats, now: Floats, lag: Floats, by_path: Floats, by_now: Floats) -> Course:
    """Cores, surfaces and lags of S strings from their states ahead.

    Parameters
    ----------
    path : ndarray (S, K, M)
    now : ndarray (S, M)
    lag : ndarray (S, n), K
        Present lag.
    by_path, by_now : ndarray (S, n, K, K + 1), (S, n, K)
    """
    n = lag.shape[1]
    T = np.concatenate((now[:, None], path), axis=1)[:, :, : 2 * n]
    core, surface = T[:, :, 0::2].swapaxes(0, 1), T[:, :, 1::2].swapaxes(0, 1)
    gap = (core - surface).transpose(1, 2, 0)
    later = np.matmul(by_path, gap[..., None])[..., 0] + by_now * lag[..., None]
    lags = np.concatenate((lag[None], later.transpose(2, 0, 1)))
    return Course(core, surface, lags)
