"""Joule heat that is made at the surface: tabs, terminals and welds."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class SurfaceJoule(Effect):
    r"""A resistance whose heat goes into every casing.

    .. math:: s \to s + \overline{I^2} R_s
    """

    name = "surface_joule"
    title = "Joule heat at the surface (tabs, terminals)"
    equation = "surface heat -> surface heat + I^2*R_s, all cells"
    signature = "surface follows I^2 within seconds"
    needs = "current steps and rests, sampled at 1 Hz"
    node = "surface"
    warms = 1
    confused_with = ("radial_gradient", "busbar_joule")
    parameters = (
        EffectParameter(
            "R_s", "resistance at the surface", "mOhm", 1e-3, 0.0, 5e-4, -1e-3, 5e-3, probe=1.5e-4, least=0.0
        ),
    )

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Heat every surface."""
        z.surface = z.surface + z.I2 * p["R_s"]
