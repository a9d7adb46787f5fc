"""Joule heat of the string's cable lugs and busbars, which warms the cells at its two ends."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import ends
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class BusbarJoule(Effect):
    r"""A resistance whose heat goes into the casings of the first and the last cell.

    .. math:: s_k \to s_k + \overline{I^2} R_s, \qquad k = 1, n
    """

    name = "busbar_joule"
    title = "Joule heat of the busbars at the string's ends"
    equation = "surface heat -> surface heat + I^2*R_s, first and last cell"
    signature = "surfaces of the end cells follow I^2 within seconds, those between do not"
    needs = "a sensor on an end cell and one further in; current steps and rests"
    node = "surface"
    warms = 1
    least_cells = 2
    confused_with = ("surface_joule", "end_plate", "cell_resistance")
    parameters = (
        EffectParameter("R_s", "resistance at each end", "mOhm", 1e-3, 0.0, 7e-4, -1e-3, 5e-3, probe=2e-4, least=0.0),
    )

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Heat the surfaces at the ends."""
        z.surface = z.surface + z.I2 * p["R_s"] * ends(z.cells)
