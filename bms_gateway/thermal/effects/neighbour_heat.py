"""A heat source or sink beside one cell: a converter, a bracket, a leak of cold air."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class NeighbourHeat(Effect):
    r"""Constant heat at the surface of one cell.

    .. math:: s_k \to s_k + P
    """

    name = "neighbour_heat"
    title = "constant heat at one cell's surface"
    equation = "surface heat -> surface heat + P, one cell"
    signature = "constant error at one cell and its neighbours that fades in after the start"
    needs = "sensors on the neighbours, or steps of the coolant flow"
    node = "surface"
    warms = 1
    place = "cell"
    confused_with = ("thermocouple_offset", "inlet_offset", "ambient_loss")
    parameters = (EffectParameter("P", "heat", "W", 1.0, 0.0, 0.8, -8.0, 8.0, probe=0.25),)

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Heat that cell's surface."""
        z.surface = z.surface + p["P"] * at
