"""Resistance depends on the state of charge."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

LEAST_SPAN = 0.05
"""SOC span below which the slope cannot be distinguished from R_e."""
CURVED_SPAN = 0.3
"""SOC span above which the curvature can be distinguished from the slope."""


class ResistanceSoc(Effect):
    r"""A parabola in the state of charge, centred at one half.

    .. math:: R_e \to R_e (1 + s_1 u + s_2 u^2), \qquad u = 1 - 2\,\mathrm{SOC}
    """

    name = "resistance_soc"
    title = "resistance depends on the SOC"
    equation = "R_e -> R_e * (1 + s_1*u + s_2*u^2), u = 1 - 2*SOC"
    signature = "error at equal I^2 follows the SOC"
    needs = "charge that goes out and in again, so that SOC is told from time; or voltage"
    node = "core"
    warms = 1
    signals = ("soc",)
    plausibility = -1.5
    confused_with = ("resistance_drift", "resistance_temperature")
    parameters = (
        EffectParameter("s_1", "rise from half full to empty", "1", 1.0, 0.0, 0.3, -2.0, 2.0, probe=0.1),
        EffectParameter("s_2", "rise towards both ends", "1", 1.0, 0.0, 0.3, -2.0, 2.0, probe=0.1),
    )

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return the slope, and the curvature too if the record spans enough of the range."""
        span = float(np.ptp(u.soc)) if "soc" in u.known else 0.0
        return () if span < LEAST_SPAN else ("s_1",) if span < CURVED_SPAN else ("s_1", "s_2")

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_e by the parabola."""
        u = 1.0 - 2.0 * z.soc
        z.R_e = z.R_e * factor(p["s_1"] * u + p["s_2"] * u * u)
