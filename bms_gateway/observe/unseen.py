"""Uncertainty after an unseen time: the gateway was off, and the vehicle may have driven on or stood.

While the bus sleeps no current flows; while the gateway is off it may. Most restarts come while driving, and most long
gaps from parking. Therefore the heat of the last minutes is expected to continue and to decay with the correlation time
of heat errors. Its standard deviation covers both no heat and a hard climb.

If even the length of the time is unknown, because the clock cannot be trusted, two strings are equally likely: one that
was just left and one that has rested. The estimate is their mean, and half their distance is a standard deviation in
addition to those of both.
"""

from collections.abc import Mapping
from math import exp, expm1
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Disturbance, Floats

JUST_LEFT_S = 60.0
"""Shortest unknown time: a state is saved once a minute."""
SPREAD, BURST, BURST_S = 1.2, 0.6, 120.0
"""Standard deviation of the heat of an unseen time, as a share of its mean over ten minutes, and its increase over a
shorter time. Over 20 s the error of the heat is 0.8 to 1.8 of that mean (root mean square; four trips of an electric
car, three cycles), but 5 in one of a hundred times: a Gaussian band has to allow for that. Over ten minutes it is 0.5
to 1.2."""
RESTED_S = 86_400.0
"""After a day any string is at rest."""


FULL = 0.999
"""A mean over this share of its time counts as full."""


MOST_USUAL = 1e7
"""A² of 3 kA, more than any current sensor shows, and far above any heat, W, of a string."""


class Usual(NamedTuple):
    """Usual heat or current: the mean over the last minutes, or over the time seen so far if that is shorter.

    A mean that started from zero would be far too small at a restart in the first minutes of a drive.

    Attributes
    ----------
    mean : ndarray (S, …)
        Heat or currents of S strings; 0 before the first step.
    weight : ndarray (S, 1)
        Seen share of the averaging time, 0 to 1.
    full : bool
        Whether all of it was seen, in every string.
    """

    mean: Floats
    weight: Floats
    full: bool = False

    @classmethod
    def nothing(cls, strings: int, width: int) -> "Usual":
        """Return a mean of `width` numbers per string before the first step."""
        return cls(np.zeros((strings, width)), np.zeros((strings, 1)))

    def after(self, now: Floats, share: float, known: ArrayLike = True) -> "Usual":
        """Include a step.

        Parameters
        ----------
        now : ndarray (S, …)
        share : float
            Length of the step over the averaging time.
        known : bool or array of bool (S, 1)
                Where False, the mean is kept.
        """
        if self.full and known is True:
            return Usual(self.mean + share * (now - self.mean), self.weight, True)
        seen = np.where(known, share, 0.0)
        weight = (1.0 - share) * self.weight + seen
        weight = np.where(weight < FULL, weight, 1.0)
        mean = self.mean + seen / np.maximum(weight, share) * np.where(known, now - self.mean, 0.0)
        return Usual(mean, weight, bool((weight == 1.0).all()))

    def aged(self, share: float) -> "Usual":
        """Let a time pass whose current is not known: the earlier mean then counts less than what follows."""
        return Usual(self.mean, (1.0 - share) * self.weight)

    def snapshot(self) -> dict[str, Any]:
        """Return it as lists of numbers."""
        return {"usual": plain(self.mean), "usual_weight": plain(self.weight)}

    def restored(self, own: Mapping[str, Any]) -> "Usual":
        """Return the mean of a snapshot; states of older versions have no weights: the weight is then full.

        Raises
        ------
        KeyError, TypeError, ValueError
            It has another shape, or holds values that are not numbers.
        """
        weight = own.get("usual_weight", np.ones_like(self.weight).tolist())
        mean, weight = like(own["usual"], self.mean), like(weight, self.weight)
        if not ((np.abs(mean) <= MOST_USUAL).all() and (weight >= 0.0).all() and (weight <= 1.0).all()):
            raise ValueError("usual: holds what is no mean")
        return Usual(mean, weight, bool((weight == 1.0).all()))


def faded(elapsed_s: float, correlation_s: float) -> float:
    """Share of earlier knowledge that is lost after this time, 0 to 1."""
    return -expm1(-elapsed_s / correlation_s)


def at_work(usual: Floats | float, disturbance: Disturbance) -> Floats:
    """Heat of cells in a drive, W: the usual one of the last minutes, at least that of a cell at work.

    After a calm stretch, or while the vehicle stands, the last minutes do not show what may begin at any moment.
    """
    return np.maximum(usual, disturbance.heat_unknown)


def spread(usual: Floats | float, gap_s: float, disturbance: Disturbance) -> Floats:
    """Return the sd, W, of a cell's mean heat over an unseen time about that of the last minutes."""
    return (SPREAD + BURST * exp(-gap_s / BURST_S)) * at_work(usual, disturbance)


def opened(
    x: Floats, P: Floats, J: Floats, gap_s: float, usual: Floats | float, disturbance: Disturbance
) -> tuple[Floats, Floats, Floats]:
    """Set the common heat offset, the last state, to the usual heat with the uncertainty of a drive.

    Parameters
    ----------
    x : ndarray (…, M)
        °C; the last W per cell.
    P : ndarray (…, M, M)
    J : ndarray (…, M, p)
        Sensitivities of `x`.
    gap_s : float, s
        Length of the unseen time.
    usual : ndarray (…), W
        Mean heat of a cell in the last minutes.
    disturbance : Disturbance

    Returns
    -------
    x, P, J : ndarray
        New arrays.
    """
    x, P, J = x.copy(), P.copy(), J.copy()
    x[..., -1] = usual
    P[..., -1, :] = P[..., :, -1] = 0.0
    P[..., -1, -1] = spread(usual, gap_s, disturbance) ** 2
    J[..., -1, :] = 0.0
    return x, P, J


def either(a: Floats, P_a: Floats, b: Floats, P_b: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance if either of two states may be true.

    Parameters
    ----------
    a, b : ndarray (…, M)
    P_a, P_b : ndarray (…, M, M)

    Returns
    -------
    x, P : ndarray
        Moments of the mixture with equal weights.

    Examples
    --------
    >>> one = np.ones((1, 1, 1))
    >>> x, P = either(np.array([[20.0]]), one, np.array([[30.0]]), one)
    >>> float(x[0, 0]), float(P[0, 0, 0])
    (25.0, 26.0)
    """
    half = (a - b) / 2.0
    return (a + b) / 2.0, (P_a + P_b) / 2.0 + half[..., :, None] * half[..., None, :]
