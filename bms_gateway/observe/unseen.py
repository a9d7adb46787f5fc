"""What is not known of a time in which nobody looked: the gateway was off, and the vehicle may have driven on or stood.

While the bus sleeps no current flows; while the gateway is off it may. As most restarts come while driving, and most
long gaps from parking, the heat of the last minutes is expected to go on and to die away with the correlation time of
heat errors, with a standard deviation within which both nothing at all and a hard climb lie.

Where even the length of the time is not known, because the clock is not to be believed, a string that was just left and
one that has rested are taken for equally likely: their mean, and half their distance as standard deviation beside what
either leaves open.
"""

from collections.abc import Mapping
from math import exp, expm1
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Disturbance, Floats

JUST_LEFT_S = 60.0
"""Shortest time to be reckoned with where it is not known: a state is saved once a minute."""
SPREAD, BURST, BURST_S = 1.2, 0.6, 120.0
"""Spread of the heat of a time unseen, as a share of its mean over ten minutes, and how much wider it is over a
shorter one. Over 20 s the heat is off by 0.8 to 1.8 of that mean (root mean square; four trips of an electric car,
three cycles), but one time in a hundred by 5: a band of Gaussian shape has to allow for that. Over ten minutes it is
off by 0.5 to 1.2."""
RESTED_S = 86_400.0
"""After a day any string is at rest."""


FULL = 0.999
"""A mean that rests on so much of its time is taken to rest on all of it."""


MOST_USUAL = 1e7
"""A² of 3 kA, more than any current sensor shows, and far beyond any heat, W, of a string."""


class Usual(NamedTuple):
    """What usually flows: the mean over the last minutes, and over all there is while that is less.

    Did it slide from nothing, a restart in the first minutes of a drive would take its heat for a fraction of what it
    is.

    Attributes
    ----------
    mean : ndarray (S, …)
        Heat or currents of S strings; 0 before anything was seen.
    weight : ndarray (S, 1)
        How much of the time that the mean stands for was seen, 0 to 1.
    full : bool
        Whether all of it was, in every string.
    """

    mean: Floats
    weight: Floats
    full: bool = False

    @classmethod
    def nothing(cls, strings: int, width: int) -> "Usual":
        """Give the mean of `width` numbers of each string of which nothing was seen yet."""
        return cls(np.zeros((strings, width)), np.zeros((strings, 1)))

    def after(self, now: Floats, share: float, known: ArrayLike = True) -> "Usual":
        """Take in a step.

        Parameters
        ----------
        now : ndarray (S, …)
        share : float
            Of the mean's time that the step is.
        known : bool or array of bool (S, 1)
                Where nothing is known the mean stays.
        """
        if self.full and known is True:
            return Usual(self.mean + share * (now - self.mean), self.weight, True)
        seen = np.where(known, share, 0.0)
        weight = (1.0 - share) * self.weight + seen
        weight = np.where(weight < FULL, weight, 1.0)
        mean = self.mean + seen / np.maximum(weight, share) * np.where(known, now - self.mean, 0.0)
        return Usual(mean, weight, bool((weight == 1.0).all()))

    def aged(self, share: float) -> "Usual":
        """Let pass a time in which nobody saw what flowed: it counts for less, against what comes next."""
        return Usual(self.mean, (1.0 - share) * self.weight)

    def snapshot(self) -> dict[str, Any]:
        """Return it as lists of numbers."""
        return {"usual": plain(self.mean), "usual_weight": plain(self.weight)}

    def restored(self, own: Mapping[str, Any]) -> "Usual":
        """Return what `snapshot` told of a mean of this shape; states of before there were weights have seen it all.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is of another shape, or holds what is not a number.
        """
        weight = own.get("usual_weight", np.ones_like(self.weight).tolist())
        mean, weight = like(own["usual"], self.mean), like(weight, self.weight)
        if not ((np.abs(mean) <= MOST_USUAL).all() and (weight >= 0.0).all() and (weight <= 1.0).all()):
            raise ValueError("usual: holds what is no mean")
        return Usual(mean, weight, bool((weight == 1.0).all()))


def faded(elapsed_s: float, correlation_s: float) -> float:
    """Tell how much of what was known has faded in so long, 0 to 1."""
    return -expm1(-elapsed_s / correlation_s)


def at_work(usual: Floats | float, disturbance: Disturbance) -> Floats:
    """Heat of cells in a drive, W: what it was in the last minutes, and no less than that of a cell at work.

    After a calm stretch, or while the vehicle stands, little was seen of what may begin at any moment.
    """
    return np.maximum(usual, disturbance.heat_unknown)


def spread(usual: Floats | float, gap_s: float, disturbance: Disturbance) -> Floats:
    """Tell by how much a cell's mean heat over a time unseen is off that of the last minutes, W (sd)."""
    return (SPREAD + BURST * exp(-gap_s / BURST_S)) * at_work(usual, disturbance)


def opened(
    x: Floats, P: Floats, J: Floats, gap_s: float, usual: Floats | float, disturbance: Disturbance
) -> tuple[Floats, Floats, Floats]:
    """Let the common heat, the last of a state's numbers, be what it usually was, give or take that of a drive.

    Parameters
    ----------
    x : ndarray (…, M)
        °C; the last W per cell.
    P : ndarray (…, M, M)
    J : ndarray (…, M, p)
        Sensitivities of `x`.
    gap_s : float, s
        How long nobody looked.
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
    """Mean and covariance where either of two states may be true.

    Parameters
    ----------
    a, b : ndarray (…, M)
    P_a, P_b : ndarray (…, M, M)

    Returns
    -------
    x, P : ndarray
        Moments of the even mixture.

    Examples
    --------
    >>> one = np.ones((1, 1, 1))
    >>> x, P = either(np.array([[20.0]]), one, np.array([[30.0]]), one)
    >>> float(x[0, 0]), float(P[0, 0, 0])
    (25.0, 26.0)
    """
    half = (a - b) / 2.0
    return (a + b) / 2.0, (P_a + P_b) / 2.0 + half[..., :, None] * half[..., None, :]
