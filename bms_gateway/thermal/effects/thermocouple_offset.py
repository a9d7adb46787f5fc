"""One thermocouple reads a constant too much or too little."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class ThermocoupleOffset(Effect):
    r"""A constant on one reading.

    .. math:: y_k = T_{s,k} + b
    """

    name = "thermocouple_offset"
    title = "one thermocouple has an offset"
    equation = "y = T_s + b, one sensor"
    signature = "constant error of one sensor from the first second on"
    needs = "a soak at one temperature"
    node = "reading"
    place = "sensor"
    confused_with = ("neighbour_heat", "inlet_offset", "cell_cooling")
    parameters = (EffectParameter("b", "offset", "K", 1.0, 0.0, 1.0, -8.0, 8.0, probe=0.3),)

    def reading(self, z: Point, p: Values, at: Floats) -> None:
        """Shift that sensor's reading."""
        z.y = z.y + p["b"] * at
