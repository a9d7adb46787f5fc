"""The inlet sensor reads a constant too much or too little."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class InletOffset(Effect):
    r"""The coolant enters colder than recorded by a constant.

    .. math:: T_{f,in} \to T_{f,in} - b
    """

    name = "inlet_offset"
    title = "inlet sensor has an offset"
    equation = "T_in -> T_in - b"
    signature = "the same constant error at all sensors that fades in after the start"
    needs = "at least two sensors; steps of the coolant flow"
    node = "coolant"
    warms = -1
    confused_with = ("thermocouple_offset", "neighbour_heat", "ambient_loss")
    parameters = (EffectParameter("b", "offset of the inlet sensor", "K", 1.0, 0.0, 1.0, -5.0, 5.0, probe=0.3),)

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Subtract the offset."""
        z.T_in = z.T_in - p["b"]
