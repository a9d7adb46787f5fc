"""What is not known of a time in which nobody looked: the gateway was off, and the vehicle may have driven on or stood.

While the bus sleeps no current flows; while the gateway is off it may. As most restarts come while driving, and most
long gaps from parking, the heat of the last minutes is expected to go on and to die away with the correlation time of
heat errors, with a standard deviation within which both nothing at all and a hard climb lie.

Where even the length of the time is not known, because the clock is not to be believed, a string that was just left and
one that has rested are taken for equally likely: their mean, and half their distance as standard deviation beside what
either leaves open.
"""

import numpy as np

from bms_gateway.thermal import Disturbance, Floats

JUST_LEFT_S = 60.0
"""Shortest time to be reckoned with where it is not known: a state is saved once a minute."""
PHASES = 1.5
"""Spread of a minute's heat in a drive, as a share of its mean over ten: a climb makes two and a half times as much."""
RESTED_S = 86_400.0
"""After a day any string is at rest."""


def at_work(usual: Floats | float, disturbance: Disturbance) -> Floats:
    """Heat of cells in a drive, W: what it was in the last minutes, and no less than that of a cell at work.

    After a calm stretch, or while the vehicle stands, little was seen of what may begin at any moment.
    """
    return np.maximum(usual, disturbance.heat_unknown)


def opened(
    x: Floats, P: Floats, J: Floats, usual: Floats | float, disturbance: Disturbance
) -> tuple[Floats, Floats, Floats]:
    """Let the common heat, the last of a state's numbers, be what it usually was, give or take that of a drive.

    Parameters
    ----------
    x : ndarray (…, M)
        °C; the last W per cell.
    P : ndarray (…, M, M)
    J : ndarray (…, M, p)
        Sensitivities of `x`.
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
    P[..., -1, -1] = (PHASES * at_work(usual, disturbance)) ** 2
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
