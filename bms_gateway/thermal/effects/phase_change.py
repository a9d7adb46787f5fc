"""A material at the surface melts: a phase-change sheet, wax, ice."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class PhaseChange(Effect):
    r"""Latent heat adds to the surface's capacity around the melting temperature.

    .. math:: C_s \to C_s + \frac{L}{w \sqrt{2\pi}} \exp\Bigl(-\frac{(T_s - T_m)^2}{2 w^2}\Bigr)
    """

    name = "phase_change"
    title = "latent heat at the surface"
    equation = "C_s -> C_s + L*gauss(T_s; T_m, w)"
    signature = "surface lingers at one temperature, on the way up and on the way down"
    needs = "surfaces that pass the melting temperature both ways"
    node = "surface"
    confused_with = ("natural_convection",)
    one_sided = True
    steep = True
    parameters = (
        EffectParameter("L", "latent heat", "J", 1.0, 0.0, 1000.0, 0.0, 1e4, probe=300.0),
        EffectParameter(
            "T_m", "melting temperature", "°C", 1.0, 40.0, 20.0, -20.0, 120.0, probe=40.0, neutral=None, reach=1.0
        ),
        EffectParameter(
            "w", "width of melting", "K", 1.0, 0.7, 0.35, 0.2, 3.0, log=True, probe=0.7, neutral=None, reach=0.3
        ),
    )

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try eight melting temperatures over the range of the surfaces, ends included."""
        return tuple({"T_m": low + float(share) * (high - low)} for share in np.linspace(0.0, 1.0, 8))

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Raise C_s around the melting temperature."""
        x = (z.T_s - p["T_m"]) / p["w"]
        z.C_s = z.C_s + p["L"] / (p["w"] * np.sqrt(2.0 * np.pi)) * np.exp(-0.5 * x * x)
