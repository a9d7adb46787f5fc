"""Resistance grows while the record runs."""

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import factor
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class ResistanceDrift(Effect):
    r"""R_e changes in proportion to the time since the record began.

    .. math:: R_e \to R_e (1 + a t)
    """

    name = "resistance_drift"
    title = "resistance drifts with time"
    equation = "R_e -> R_e * (1 + a*t)"
    signature = "error in the heat grows steadily with time, whatever temperature and SOC do"
    needs = "the same cycle at the start and at the end"
    node = "core"
    warms = 1
    confused_with = ("resistance_soc", "resistance_temperature", "cooling_drift")
    parameters = (
        EffectParameter("a", "growth", "1/h", 1 / 3600, 0.0, 0.3 / 3600, -1 / 3600, 3 / 3600, probe=0.1 / 3600),
    )

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_e by the time."""
        z.R_e = z.R_e * factor(p["a"] * 3600.0 * z.hours)
