r"""The paper's filtered regression of one cell, and the conversion of its coefficients to R_e, R_c, R_u.

With T̃ the difference from the first sample and Λ(s) = (s + λ_1)(s + λ_2), exactly and for any start

.. math::
    \frac{s^2}{\Lambda} \tilde T_s = \alpha \frac{1}{\Lambda} I^2 + \beta \frac{1}{\Lambda} (T_f - T_s)
    + \gamma \frac{s}{\Lambda} \tilde T_s + \mu \frac{s}{\Lambda} \tilde T_f + \frac{1}{\Lambda} T_s'(0)

The paper keeps the first three terms (Eq 8): correct while T_f is constant and the start is an equilibrium. The fourth
is needed when T_f moves, the fifth (the filter's impulse response, coefficient T_s'(0)) when the start is no
equilibrium. Mean I² is constant over a step (zero order), temperatures are linear (first order): errors below 0.06 % at
1 s. With all inputs of zero order the error is 8 %, with the bilinear rule 20 %.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import Floats
from bms_gateway.thermal.exponential import exponential

LAMBDA = 0.05
"""1/s: both poles of the filter, between the cell's own 0.0018 and 0.11."""
SCALE = np.array([60.0**2, 10.0, 0.1, 0.1, 0.1])
"""Sizes of I², T_f − T_s, sT_s, sT_f and T_s'(0): A², K, K/s, K/s, K/s. Unscaled, I² alone determines m."""
Z_SCALE = 0.1 * LAMBDA
"""K/s²: size of s²T_s."""
FOLD = 0.005
"""Share of γ² below which the discriminant is not reliable: R_u within 15 % of R_u*."""


class Filter:
    """Filtered signals of Eq 8, one step at a time.

    Parameters
    ----------
    dt : float
        Step, s.
    pole : float
        λ_1 = λ_2, 1/s.
    """

    def __init__(self, dt: float, pole: float = LAMBDA) -> None:
        self._pole = pole
        F = np.zeros((4, 4))
        F[:2, :2] = [[0.0, 1.0], [-(pole**2), -2.0 * pole]]
        F[1, 2] = 1.0
        F[2, 3] = 1.0 / dt
        E = exponential(F * dt)
        self._A, self._held, self._slope = E[:2, :2], E[:2, 2], E[:2, 3]

    def start(self, T_s: float, T_f: float) -> None:
        """Start at the first sample, °C."""
        self._T0 = np.array([T_s, T_f])
        self._last = np.array([T_f - T_s, 0.0, 0.0])
        self._x = np.zeros((2, 5))  # I², T_f − T_s, T̃_s, T̃_f, impulse; rows: value, rate
        self._x[1, 4] = 1.0

    def step(self, square: float, T_s: float, T_f: float) -> tuple[float, Floats]:
        """Advance one step.

        Parameters
        ----------
        square : float
            Mean I² over the step, A².
        T_s, T_f : float
            °C, at its end.

        Returns
        -------
        z : float
            Left side, scaled.
        phi : ndarray (5,)
            Regressors, scaled: I², T_f − T_s, sT_s, sT_f, impulse.
        """
        now = np.array([T_f - T_s, T_s - self._T0[0], T_f - self._T0[1]])
        x = self._A @ self._x
        x[:, 0] += self._held * square
        x[:, 1:4] += np.outer(self._held, self._last) + np.outer(self._slope, now - self._last)
        self._x, self._last = x, now
        dc = self._pole**2
        z = now[1] - dc * x[0, 2] - 2.0 * self._pole * x[1, 2]
        phi = np.array([x[0, 0], x[0, 1], x[1, 2], x[1, 3], x[0, 4]])
        return float(z * dc / Z_SCALE), phi * dc / SCALE


def unscale(theta: Floats) -> Floats:
    """Coefficients (α, β, γ, μ, T_s'(0)) in SI from scaled ones (as many as given).

    References
    ----------
    Lin et al., Eq 8.
    """
    return np.asarray(theta * Z_SCALE / SCALE[: len(theta)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Cell:
    """R_e Ω, R_c K/W, R_u K/W of one root.

    References
    ----------
    Lin et al., Eq 9.
    """

    R_e: float
    R_c: float
    R_u: float


@dataclass(frozen=True, slots=True)
class Roots:
    """Both solutions of Eq 9.

    Attributes
    ----------
    smaller, larger : Cell or None
        By R_u; None where the discriminant is not clearly positive or a coefficient has the wrong sign.
    why : str
        Empty, or why there is no solution.
    """

    smaller: Cell | None
    larger: Cell | None
    why: str


def roots(alpha: float, beta: float, gamma: float, C_c: float, C_s: float) -> Roots:
    """Physical cells of the three-regressor form.

    Parameters
    ----------
    alpha, beta, gamma : float
        K/(s² A²), 1/s², 1/s.
    C_c, C_s : float
        J/K.

    References
    ----------
    Lin et al., Eq 9; both roots are positive, and the flow decides which is right.

    Examples
    --------
    >>> both = roots(5.487085e-7, 1.984479e-4, -0.1122937, 268.0, 18.8)
    >>> round(both.smaller.R_u, 2), round(both.larger.R_u, 2)
    (0.79, 1.18)
    >>> roots(5.487085e-7, 1.984479e-4, -0.1100, 268.0, 18.8).why
    'near the fold R_u = R_u*'
    """
    share = 1.0 - 4.0 * beta * (C_c + C_s) / (C_s * gamma**2)
    if not (alpha > 0.0 and beta > 0.0 and gamma < 0.0):
        return Roots(None, None, "a coefficient has the wrong sign")
    if share < FOLD:
        return Roots(None, None, "near the fold R_u = R_u*")
    cells = []
    for sign in (-1.0, 1.0):
        R_u = -gamma * (1.0 + sign * np.sqrt(share)) / (2.0 * beta * (C_c + C_s))
        cells.append(Cell(float(alpha / beta / R_u), float(1.0 / (beta * C_c * C_s * R_u)), float(R_u)))
    return Roots(cells[0], cells[1], "")


def choose_root(both: Roots, R_c: float, R_u: float) -> Cell | None:
    """Choose the root on the side of R_u = R_u* of rough values of R_c, R_u (K/W): nearest in ln(R_u/R_c).

    References
    ----------
    Lin et al., Eq 9, whose "rough estimate" this is.
    """
    if both.smaller is None or both.larger is None:
        return None
    return min((both.smaller, both.larger), key=lambda c: abs(np.log(c.R_u / c.R_c) - np.log(R_u / R_c)))


def with_moving_inlet(alpha: float, beta: float, gamma: float, mu: float, C: float) -> Cell | None:
    """Solve for the one physical cell of the four-regressor form; only C = C_c + C_s (J/K) is assumed.

    R_e R_c does not depend on the division of C. None if a coefficient has the wrong sign.

    References
    ----------
    Lin et al., Eq 7 with its term in s·T_f, which Eq 8 drops.

    Examples
    --------
    >>> c = with_moving_inlet(5.487085e-7, 1.984479e-4, -0.1122937, 0.0673310, 286.8)
    >>> round(c.R_e * 1e3, 2), round(c.R_c, 2), round(c.R_u, 2)
    (3.5, 1.27, 0.79)
    """
    total = -(gamma + mu)  # −γ'
    if not (alpha > 0.0 and beta > 0.0 and mu > 0.0 and total > 0.0):
        return None
    R_u = total / (beta * C)
    C_c = C - 1.0 / (mu * R_u)
    if C_c <= 0.0:
        return None
    return Cell(float(alpha / beta / R_u), float(mu / (beta * C_c)), float(R_u))


def delta_sd(f: Callable[[Floats], Floats | None], theta: Floats, cov: Floats) -> Floats | None:
    """Propagate a covariance: sd of f(θ) to first order; None if f has no value at θ or nearby.

    References
    ----------
    Lin et al., Eq 9, linearised; the paper states no uncertainty.
    """
    here = f(theta)
    if here is None:
        return None
    J = np.empty((len(here), len(theta)))
    for i, x in enumerate(theta):
        moved = theta.copy()
        moved[i] += 1e-5 * max(abs(x), 1e-9)
        there = f(moved)
        if there is None:
            return None
        J[:, i] = (there - here) / (moved[i] - x)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, cov, J), 0.0)), dtype=np.float64)
