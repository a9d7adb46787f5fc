"""One thermocouple has bad contact: it reads partly the coolant."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class ThermocoupleContact(Effect):
    r"""One reading lies between the surface and the coolant at its cell.

    .. math:: y_k = (1 - g) T_{s,k} + g T_{f,k}
    """

    name = "thermocouple_contact"
    title = "one thermocouple has bad contact"
    equation = "y = (1 - g)*T_s + g*T_f, one sensor"
    signature = "error of one sensor in proportion to its distance from the coolant"
    needs = "warm phases and cold ones; sensors on the neighbours"
    node = "reading"
    place = "sensor"
    confused_with = ("cell_cooling", "thermocouple_offset", "cell_resistance")
    parameters = (EffectParameter("g", "share of the coolant", "1", 1.0, 0.0, 0.2, -0.2, 0.8, probe=0.06, least=0.0),)

    def reading(self, z: Point, p: Values, at: Floats) -> None:
        """Move that sensor's reading towards the coolant."""
        z.y = z.y + p["g"] * at * (z.T_f - z.T_s)
