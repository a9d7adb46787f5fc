"""Cooling gets worse while the record runs: a filter clogs, a fan slows."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CoolingDrift(Effect):
    r"""R_u changes in proportion to the time since the record began.

    .. math:: R_u \to R_u (1 + a t)
    """

    name = "cooling_drift"
    title = "cooling drifts with time"
    equation = "R_u -> R_u * (1 + a*t)"
    signature = "distance of the surface from the coolant grows with time, in rests too"
    needs = "the same cycle at the start and at the end"
    node = "surface"
    warms = 1
    confused_with = ("resistance_drift", "ambient_loss", "flow_dependent_cooling")
    parameters = (
        EffectParameter("a", "growth", "1/h", 1 / 3600, 0.0, 0.3 / 3600, -1 / 3600, 3 / 3600, probe=0.1 / 3600),
    )

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_u by the time."""
        z.R_u = z.R_u * factor(p["a"] * 3600.0 * z.hours)
