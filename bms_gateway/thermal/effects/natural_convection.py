"""Natural convection: still air carries more heat per kelvin if the surface is hotter."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class NaturalConvection(Effect):
    r"""The film's conductance follows a power of the difference to the coolant; 0.25 is laminar free convection.

    .. math:: f = \frac{T_s - T_f}{R_u} \Bigl(\frac{|T_s - T_f|}{5\,\mathrm{K}}\Bigr)^n
    """

    name = "natural_convection"
    title = "free convection"
    equation = "film flux -> film flux * (|T_s - T_f| / 5 K)^n"
    signature = "surface error bends with its distance from the coolant: cools too slowly when hot, too fast when near"
    needs = "a large span of surface-to-coolant difference, best a long cool-down"
    node = "surface"
    warms = -1
    plausibility = -1.5
    confused_with = ("ambient_loss", "resistance_temperature")
    parameters = (EffectParameter("n", "exponent", "1", 1.0, 0.0, 0.25, -0.3, 1.0, probe=0.08),)

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Raise the film's exponent."""
        z.film_exponent = z.film_exponent + p["n"]
