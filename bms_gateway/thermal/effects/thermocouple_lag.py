"""Thermocouples respond with a delay: glue, sleeve and bead have a heat capacity."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

QUICKEST = 0.5
"""s: least simulated time constant, because a smaller one would be stiff; the reading still has its delay."""


class ThermocoupleLag(Effect):
    r"""Every reading is a first-order lag of the surface temperature.

    .. math:: \tau \dot y = T_s - y

    Notes
    -----
    The own state lags by τ' = √(τ² + (0.5 s)²), and the reading contains the share τ/τ' of the lag: the mean delay is
    τ, and zero for τ = 0.
    """

    name = "thermocouple_lag"
    title = "thermocouples answer late"
    equation = "tau*dy/dt = T_s - y"
    signature = "error follows the slope of the surface temperature"
    needs = "C_s known to 5 %; current steps, sampled at 1 Hz"
    node = "reading"
    confused_with = ("radial_gradient", "coolant_delay", "surface_joule")
    one_sided = True
    states = 1
    parameters = (EffectParameter("tau", "time constant of the reading", "s", 1.0, 0.0, 6.0, 0.0, 60.0, probe=2.0),)

    def rest(self, T_c: Floats, T_s: Floats, p: Values) -> Floats:
        """Start with the bead at the temperature of the surface."""
        return np.asarray(T_s)[..., None]

    def surroundings(self, z: Point, p: Values, at: Floats) -> None:
        """Let the bead follow the surface."""
        bead = z.extra[z.key]
        z.extra_rates[z.key] = (z.T_s[..., None] - bead) / np.hypot(p["tau"], QUICKEST)

    def reading(self, z: Point, p: Values, at: Floats) -> None:
        """Read the bead."""
        late = p["tau"] / np.hypot(p["tau"], QUICKEST)
        z.y = z.y + late * (z.extra[z.key][..., 0] - z.T_s)
