"""One tick as health takes it in."""

import numpy as np

from bms_gateway.identify import Tick


def tick(dt: float = 1.0, square: float = 3600.0, inlet: float = 20.0) -> Tick:
    surface = np.array([25.0, np.nan, 26.0])
    return Tick(0, dt, square, float("nan"), inlet, surface, np.zeros(3))
