"""Coolant leaves the channel between two cells: the cells after them get less."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CoolantBypass(Effect):
    r"""The stream loses a share b of its heat-capacity flow after cell j.

    .. math:: C_{f,k} \to C_{f,k} (1 - b), \qquad k > j
    """

    name = "coolant_bypass"
    title = "coolant leaks away after a cell"
    equation = "C_f -> C_f * (1 - b) for the cells after cell j"
    signature = "error begins after one cell and grows downstream"
    needs = "at least three sensors along the string, two of them downstream"
    node = "coolant"
    warms = 1
    place = "gap"
    least_cells = 3
    confused_with = ("cell_resistance", "cell_cooling")
    parameters = (EffectParameter("b", "share that leaves", "1", 1.0, 0.0, 0.3, -0.3, 0.9, probe=0.1, least=0.0),)

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Reduce the stream at the cells after the leak; the cell before it still gets all."""
        z.C_f = z.C_f * (1.0 - p["b"] * (np.cumsum(at) - at))
