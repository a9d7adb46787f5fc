"""What the fit of a window found, in the numbers of an observer that carries no effects but reversible heat.

Beyond Lin et al., Eq 1.
"""

import numpy as np

from bms_gateway.identify.carried import NAMES, WARMTH_AT
from bms_gateway.identify.identifiable import R_E, R_U
from bms_gateway.identify.window_problem import Problem
from bms_gateway.thermal import Floats
from bms_gateway.thermal.entropy import ENTROPIC, PRIOR_SD
from bms_gateway.thermal.warmth import WARMTH, WARMTH_SD

MOST_SHARE = 0.5
"""Largest share of a window's heat that one unit of a carried effect may have: above, the window has hardly any
heat."""
APART = (*ENTROPIC, WARMTH)
"""Carried effects that an observer knows as numbers of its own."""
APART_SD = (*PRIOR_SD, WARMTH_SD)
"""Of these: mV/K of reversible heat, 1000 K of B."""
APART_AT = np.array([NAMES.index(name) for name in APART])


def effective(problem: Problem, mean: Floats, cov: Floats, warmth: float) -> tuple[Floats, Floats]:
    """Include the carried effects' heat and cooling in the numbers for an observer without these effects.

    Parameters
    ----------
    problem : Problem
        Of the window, at its mode.
    mean, cov : ndarray (P,), (P, P)
        Of (φ, v), with R_e at 25 °C.
    warmth : float
        At which R_e is stated (`thermal.warmth`).

    Returns
    -------
    ndarray (p + 1,), ndarray (p + 1, p + 1)
        Of φ and of the logarithm of the gain of heat from voltage; 0 without such heat.
    """
    A = _in_shares(problem, warmth)
    return A @ mean, A @ cov @ A.T


def apart(problem: Problem, mean: Floats, cov: Floats, warmth: float) -> tuple[Floats, Floats]:
    """As `effective`, but the effects `APART` are in no share and follow as numbers of their own.

    Their mean over a window says little about the time after it, when the current may have the other sign and the
    cores another temperature.

    Returns
    -------
    ndarray (p + 4,), ndarray (p + 4, p + 4)
        With the numbers `APART` at the end, the first at the mean charge of the window.
    """
    A, at = _in_shares(problem, warmth), problem.p + APART_AT
    A[:, at[: len(ENTROPIC)]] = 0.0
    own = np.zeros((len(APART), problem.P))
    own[np.arange(len(APART)), at] = problem.size * np.array(APART_SD)
    A = np.vstack([A, own])
    return A @ mean, A @ cov @ A.T


def _in_shares(problem: Problem, warmth: float) -> Floats:
    """Slopes (p + 1, P) of an observer's numbers by (φ, v)."""
    p, shares = problem.p, np.clip(problem.effects.shares, -MOST_SHARE, MOST_SHARE)
    A = np.zeros((p + 1, problem.P))
    A[:p, :p] = np.eye(p)
    A[p if np.any(problem.inputs.heat != 0.0) else R_E, p:], A[R_U, p:] = shares
    A[R_E, p + WARMTH_AT] = problem.B_unit * warmth
    A[np.setdiff1d(np.arange(p), problem.sought.free), p:] = 0.0
    return A
