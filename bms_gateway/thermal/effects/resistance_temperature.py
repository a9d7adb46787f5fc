"""Resistance falls as the cell warms: an Arrhenius law of the core temperature."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import activation
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class ResistanceTemperature(Effect):
    r"""Ohmic and kinetic losses follow the temperature of the core.

    .. math:: R_e \to R_e \exp\bigl(B (1/T_c - 1/298.15\,\mathrm{K})\bigr)

    Notes
    -----
    The prior is that of lithium-ion cells: kinetics and electrolyte between 20 and 35 kJ/mol, 2,000 to 4,000 K, and
    less if a contact's share of R_e is large. Every part of the program that fits B uses this prior.
    """

    name = "resistance_temperature"
    title = "resistance falls as the cell warms"
    equation = "R_e -> R_e * exp(B*(1/T_c - 1/298.15 K))"
    signature = "error follows I^2 times the distance from the mean temperature; heat falls as the cell warms"
    needs = "at least 5 K of temperature span at similar I^2; voltage sharpens it"
    node = "core"
    warms = -1
    plausibility = 0.0
    confused_with = ("resistance_drift", "resistance_soc", "natural_convection")
    parameters = (
        EffectParameter("B", "activation temperature", "K", 1.0, 2500.0, 1500.0, -1000.0, 8000.0, probe=500.0),
    )

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_e by the Arrhenius factor of each core."""
        z.R_e = z.R_e * activation(z.T_c, p["B"])
