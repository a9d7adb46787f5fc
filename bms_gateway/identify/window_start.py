r"""Shared by all fits of windows: the start of a window, its inlet, and the instants of its readings.

A start is given by surfaces T_s and e in

.. math:: T_c = T_s + R_c \phi \,(T_s - T_f + e)

with φ the film's conductance: the heat that leaves a casing came from its core, except the little that the casing
stores. So a hot start during a drive favours no set of parameters, and R_c moves the core with it.

For Lin et al., Eq 1 and 16-18.
"""

from collections.abc import Sequence

import numpy as np

from bms_gateway.thermal import Floats, StringParameters, coolant_path, film

EARLY_S = 10.0
"""Readings of this time determine the start of the surfaces."""

Spread = tuple[float, float, float]
"""sd, K: common to all cells, linear along the string, of each cell by itself."""
FRESH: tuple[Spread, Spread] = ((5.0, 6.0, 1.0), (4.0, 4.0, 1.0))
"""For surfaces and cores if only the first readings are known."""
INLET_SD = 0.1
"""K: difference between the inlet's reading and the inlet at the cells while it moves."""
SWING_SD = 0.5
"""Largest sd of the gain of the inlet's swing."""


def start_map(p: StringParameters, inlet: float) -> tuple[Floats, Floats]:
    """Return E (2n, 2n) and c (2n,) of X = E (T_s, e) + c at an instant with the inlet at `inlet`, °C."""
    n = p.cells
    M, m = coolant_path(p)
    over = (p.R_c * film(p))[:, None]
    E, c = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    E[1::2, :n] = np.eye(n)
    E[0::2, :n] = np.eye(n) + over * (np.eye(n) - M)
    E[0::2, n:] = over * np.eye(n)
    c[0::2] = -over[:, 0] * m * inlet
    return E, c


def start_information(n: int, surfaces: Spread, cores: Spread) -> Floats:
    """Inverse covariance (2n, 2n) of (T_s, e) of n cells, 1/K²; e has the spread of the cores."""
    along, out = np.linspace(-1.0, 1.0, n), np.zeros((2 * n, 2 * n))
    for part, (common, ends, own) in ((slice(0, n), surfaces), (slice(n, 2 * n), cores)):
        P = common**2 + ends**2 * np.outer(along, along) + own**2 * np.eye(n)
        out[part, part] = np.linalg.inv(P)
    return out


def swing_information(inlet: Floats) -> float:
    """1/sd² of the gain of the swing of the inlet (K + 1,), °C, at the cells: small if it hardly moves."""
    return float((np.std(inlet) / INLET_SD) ** 2 + SWING_SD**-2)


def first_start(y: Floats, dt: float, inlet: float, n: int) -> Floats:
    """Guess (T_s, e) (2n,), °C and K: surfaces from the first readings in y (K, m), without readings the inlet."""
    early = y[: max(1, round(EARLY_S / dt))]
    seen = early[np.isfinite(early)]
    start = np.zeros(2 * n)
    start[:n] = seen.mean() if seen.size else inlet
    return start


def lateness(age: Floats, dt: float, sensed: Sequence[int]) -> Floats:
    """Share (K, m) of a tick by which readings of the sensed cells are older than its end."""
    return np.clip(np.nan_to_num(age[:, list(sensed)]) / dt, 0.0, 1.0)


def at_readings(Y: Floats, late: Floats) -> Floats:
    """Interpolate values at the instants (K + 1, m, …) to the readings' times (K, m, …); `late` as of `lateness`."""
    late = late.reshape(*late.shape, *(1,) * (Y.ndim - 2))
    return np.asarray((1.0 - late) * Y[1:] + late * Y[:-1], dtype=np.float64)
