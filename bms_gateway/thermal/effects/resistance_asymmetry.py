"""The resistance on charge differs from that on discharge."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class ResistanceAsymmetry(Effect):
    r"""R_e is larger, or smaller, by a share while the cell is charged.

    .. math:: R_e \to R_e (1 + a) \quad \text{for } I < 0

    In an interval with both directions, the share of the inward charge counts.
    """

    name = "resistance_asymmetry"
    title = "another resistance on charge"
    equation = "R_e -> R_e * (1 + a) while I < 0"
    signature = "error follows I*|I|: one sign while charging, the other while discharging"
    needs = "current in both directions, strong enough to heat"
    node = "core"
    plausibility = -1.5
    confused_with = ("current_offset", "entropic_heat")
    parameters = (EffectParameter("a", "excess on charge", "1", 1.0, 0.0, 0.3, -0.7, 2.0, probe=0.1),)

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return nothing if the current has one direction only: R_e then contains the whole resistance."""
        return ("a",) if np.any(u.I < 0.0) and np.any(u.I > 0.0) else ()

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_e by the share of charging in each interval."""
        inwards = np.clip((z.I_abs - z.I) / np.maximum(2.0 * z.I_abs, 1e-12), 0.0, 1.0)
        z.R_e = z.R_e * factor(p["a"] * inwards)
