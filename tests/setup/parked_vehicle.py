"""A vehicle that rests before it is driven."""

import numpy as np

from bms_gateway.setup.resting import REST_S
from tests.setup.vehicles import drive, plain

N = 4000
T = np.arange(N) / 10


def parked(cooling_K: float = 0.0, level: float = 18.0, rest: float = REST_S + 20.0):
    """A car that rests at first, at 0.5 A of its electronics, with four cells that differ, and is driven then."""
    still = rest > T
    heat = np.where(still, 0.0, (T - rest) * 8.0 / (T[-1] - rest))
    cool = cooling_K * np.where(still, 1.0 - T / rest, 0.0)
    vehicle = plain({f"CellTemp{k + 1}": level + 0.2 * k + heat + cool for k in range(4)}, unit="degC")
    vehicle.values["Elec.PackCurrent"] = np.where(still, 0.5, drive(8).current)
    return vehicle
