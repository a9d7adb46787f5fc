"""Consecutive regular ticks of one string as columns, for identifiers that collect windows."""

from dataclasses import dataclass

from bms_gateway.thermal import Floats

ENDLESS = 1 << 60
"""Patience of an identifier that uses no ticks."""


@dataclass(frozen=True, slots=True)
class Ticks:
    """K ticks one period apart, each with a current and an inlet; see `Tick` for units.

    Attributes
    ----------
    dt : float
    square, heat, inlet, current, soc : ndarray (K,)
        Mean square current and heat as in `Tick`; also the mean current, A, and the state of charge, 0…1.
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
    """Count the ticks that may be added to `gathered` without filling a window, whose length is `len · dt`."""
    return max(0, int(window_s / dt - 1e-3) - gathered - 1)
