"""A path of the heat that passes neither casing nor coolant: tabs and busbars."""

from bms_gateway.thermal.effects.ambient_loss import AMBIENT
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CoreLoss(Effect):
    r"""Every core exchanges heat, through its tabs, with busbars that do not follow the coolant.

    .. math:: Q_c \to Q_c + P - G (T_c - 25\,°C)
    """

    name = "core_loss"
    title = "heat leaves the cores through their tabs"
    equation = "Q_c -> Q_c + P - G*(T_c - 25 °C)"
    signature = "as a second heat path to the surroundings, with a cooler core under load"
    needs = "steps of the coolant inlet; C_c and C_s known"
    node = "core"
    warms = -1
    plausibility = -1.5
    elsewhere = "heat that leaves the casings, as to a housing"
    confused_with = ("ambient_loss", "natural_convection", "inlet_offset", "resistance_temperature")
    parameters = (
        EffectParameter(
            "G", "conductance from a core to its busbars", "W/K", 1.0, 0.0, 0.2, -0.3, 2.0, probe=0.06, least=0.0
        ),
        EffectParameter("P", "heat from the busbars at 25 °C", "W", 1.0, 0.0, 2.0, -40.0, 40.0, probe=0.6),
    )

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Subtract the heat through the tabs."""
        z.core = z.core + p["P"] - p["G"] * (z.T_c - AMBIENT)
