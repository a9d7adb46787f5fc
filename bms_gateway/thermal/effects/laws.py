"""Laws that several effects use: activation, a factor that stays positive, curves by knots, first-order lags."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.warmth import inverse

FEW = 4_000
"""Number of intervals up to which plain floats are used: a fit's thousand lags of a record of that length take 0.2 s,
loading scipy's filter half a second, and the live gateway with its single intervals need not load it."""
LEAST_FACTOR = 0.05
"""A resistance never falls below this share of its value, so that a trial of a fit cannot change its sign."""


def activation(T: Floats, kelvin: float) -> Floats:
    """Arrhenius factor exp(kelvin·(1/T − 1/298.15 K)) of temperatures in °C: 1 at 25 °C.

    Examples
    --------
    >>> import numpy as np
    >>> float(activation(np.array(25.0), 3000.0))
    1.0
    """
    return np.asarray(np.exp(kelvin * inverse(T)), dtype=np.float64)


def factor(change: Floats) -> Floats:
    """1 + change, kept positive."""
    return np.maximum(1.0 + change, LEAST_FACTOR)


def ends(cells: int) -> Floats:
    """Ones on the first and the last cell: ndarray (n,)."""
    at = np.zeros(cells)
    at[[0, -1]] = 1.0
    return at


def by_knots(soc: Floats, knots: Floats, values: Sequence[float]) -> Floats:
    """Curve over the state of charge: linear between the knots, constant beyond them."""
    return np.asarray(np.interp(soc, knots, values), dtype=np.float64)


def lag(x: Floats, dt: float, tau: float, before: float) -> tuple[Floats, Floats]:
    r"""First-order lag of an input with known interval means.

    .. math:: \tau \dot y = x - y

    Parameters
    ----------
    x : (N,)
        Means over intervals of `dt` seconds, taken as constant within each.
    tau : float
        s; 0 is no lag.
    before : float
        y at the start.

    Returns
    -------
    y : (N + 1,)
        At the instants that bound the intervals.
    mean : (N,)
        Over each interval; no heat is lost: τ (y_end − y_start) = dt (x − mean).

    Notes
    -----
    Single intervals give the same numbers as all intervals at once, bit for bit.
    """
    kept = float(np.exp(-dt / tau)) if tau > 0.0 else 0.0
    if len(x) <= FEW:
        stepped = [before]
        for fed in ((1.0 - kept) * x).tolist():
            before = fed + kept * before
            stepped.append(before)
        y = np.array(stepped, dtype=np.float64)
    else:
        from scipy.signal import lfilter  # slow to load: only long records need it

        end, _ = lfilter([1.0 - kept], [1.0, -kept], x, zi=np.array([kept * before]))
        y = np.concatenate([[before], end])
    return y, x + (y[:-1] - x) * (tau / dt * (1.0 - kept))
