"""Regular ticks of one string in a row, as identifiers that gather windows take them in: columns, not objects."""

from dataclasses import dataclass

from bms_gateway.thermal import Floats

ENDLESS = 1 << 60
"""Patience of what takes no ticks in at all."""


@dataclass(frozen=True, slots=True)
class Ticks:
    """K ticks one period apart, each with a current and an inlet; see `Tick` for units.

    Attributes
    ----------
    dt : float
    square, heat, inlet, current, soc : ndarray (K,)
        Mean square current and heat as in `Tick`; beside them the mean current, A, and the state of charge, 0…1.
    surface, age : ndarray (K, n)
    """

    dt: float
    square: Floats
    heat: Floats
    inlet: Floats
    current: Floats
    soc: Floats
    surface: Floats
    age: Floats


def before_full(window_s: float, gathered: int, dt: float) -> int:
    """How many ticks may surely be added to so many without filling a window, which counts them by `len · dt`."""
    return max(0, int(window_s / dt - 1e-3) - gathered - 1)
