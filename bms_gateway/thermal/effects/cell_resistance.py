"""A weak or aged cell: it makes more heat than the others."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CellResistance(Effect):
    r"""One cell's R_e differs from that of the others by a share.

    .. math:: R_{e,k} \to R_{e,k} (1 + a)
    """

    name = "cell_resistance"
    title = "one cell's resistance differs"
    equation = "R_e -> R_e * (1 + a), one cell"
    signature = "steady error at one cell that builds up with the core's slowness"
    needs = "a sensor on that cell"
    node = "core"
    warms = 1
    place = "cell"
    least_cells = 2
    confused_with = ("cell_cooling", "cell_conduction", "neighbour_heat")
    parameters = (EffectParameter("a", "excess resistance", "1", 1.0, 0.0, 0.3, -0.7, 4.0, probe=0.1),)

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale that cell's R_e."""
        z.R_e = z.R_e * factor(p["a"] * at)
