"""A loose or dried-out jelly roll: its heat reaches the casing later than that of other cells."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CellConduction(Effect):
    r"""One cell's R_c differs from that of the others by a share.

    .. math:: R_{c,k} \to R_{c,k} (1 + a)
    """

    name = "cell_conduction"
    title = "one cell's inner conduction differs"
    equation = "R_c -> R_c * (1 + a), one cell"
    signature = "error at one cell after each change of the current, none in the steady state"
    needs = "a sensor on that cell; current steps and rests"
    node = "core"
    place = "cell"
    least_cells = 2
    confused_with = ("cell_resistance", "cell_cooling")
    parameters = (EffectParameter("a", "excess inner resistance", "1", 1.0, 0.0, 0.6, -0.7, 6.0, probe=0.18),)

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale that cell's R_c."""
        z.R_c = z.R_c * factor(p["a"] * at)
