"""The plates that hold a string together cool, or warm, the cells at its ends."""

from bms_gateway.thermal.effects.ambient_loss import AMBIENT
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import ends
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class EndPlate(Effect):
    r"""First and last cell exchange heat with surroundings that do not follow the coolant.

    .. math:: s_k \to s_k + P - G (T_{s,k} - 25\,°C), \qquad k = 1, n
    """

    name = "end_plate"
    title = "end plates cool or warm the end cells"
    equation = "surface heat -> surface heat + P - G*(T_s - 25 °C), first and last cell"
    signature = "end cells slowly run colder, or hotter, than those between"
    needs = "a sensor on an end cell and one in the middle; steps of the coolant inlet"
    node = "surface"
    warms = -1
    least_cells = 2
    confused_with = ("ambient_loss", "cell_cooling", "busbar_joule")
    parameters = (
        EffectParameter("G", "conductance to each plate", "W/K", 1.0, 0.0, 0.2, -0.3, 2.0, probe=0.06, least=0.0),
        EffectParameter("P", "heat from each plate at 25 °C", "W", 1.0, 0.0, 2.0, -40.0, 40.0, probe=0.6),
    )

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Add the heat from the plates."""
        z.surface = z.surface + (p["P"] - p["G"] * (z.T_s - AMBIENT)) * ends(z.cells)
