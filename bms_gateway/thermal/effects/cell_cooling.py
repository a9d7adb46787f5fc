"""A blocked channel or a shaded cell: the cell is cooled worse than the others."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CellCooling(Effect):
    r"""One cell's R_u differs from that of the others by a share.

    .. math:: R_{u,k} \to R_{u,k} (1 + a)
    """

    name = "cell_cooling"
    title = "one cell's cooling differs"
    equation = "R_u -> R_u * (1 + a), one cell"
    signature = "steady error at one cell that also shows when the inlet steps, without current"
    needs = "a sensor on that cell; steps of the coolant inlet"
    node = "surface"
    warms = 1
    place = "cell"
    least_cells = 2
    confused_with = ("cell_resistance", "cell_conduction", "end_plate")
    parameters = (EffectParameter("a", "excess cooling resistance", "1", 1.0, 0.0, 0.4, -0.7, 5.0, probe=0.12),)

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale that cell's R_u."""
        z.R_u = z.R_u * factor(p["a"] * at)
