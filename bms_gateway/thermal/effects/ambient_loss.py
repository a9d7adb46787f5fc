"""A second path of the heat besides the coolant: chassis, radiation, a housing in the sun."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

AMBIENT = 25.0
"""°C to which G refers; a different ambient temperature shows as P."""


class AmbientLoss(Effect):
    r"""Every surface exchanges heat with surroundings that do not follow the coolant.

    .. math:: s \to s + P - G (T_s - 25\,°C)
    """

    name = "ambient_loss"
    title = "second heat path to the surroundings"
    equation = "surface heat -> surface heat + P - G*(T_s - 25 °C)"
    signature = "error appears when the inlet moves and the surroundings do not"
    needs = "steps of the coolant inlet"
    node = "surface"
    warms = -1
    plausibility = -1.5
    elsewhere = "heat that leaves the cores themselves, as through their tabs"
    confused_with = ("core_loss", "neighbour_heat", "natural_convection", "inlet_offset", "thermocouple_offset")
    parameters = (
        EffectParameter("G", "conductance to the surroundings", "W/K", 1.0, 0.0, 0.2, -0.3, 2.0, probe=0.06, least=0.0),
        EffectParameter("P", "heat from the surroundings at 25 °C", "W", 1.0, 0.0, 2.0, -40.0, 40.0, probe=0.6),
    )

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Add the heat from the surroundings."""
        z.surface = z.surface + p["P"] - p["G"] * (z.T_s - AMBIENT)
