"""The current sensor reads a constant too much or too little."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class CurrentOffset(Effect):
    r"""The true current is below the recorded one by a constant.

    .. math:: I \to I - b, \qquad \overline{I^2} \to \overline{I^2} - 2 b \overline{I} + b^2

    Notes
    -----
    The mean magnitude is exact for intervals with one current. Memories of effects (hysteresis, polarisation) and a
    counted state of charge use the recorded current.
    """

    name = "current_offset"
    title = "current sensor has an offset"
    equation = "I -> I - b"
    signature = "error linear in the current, and heat at rest"
    needs = "a rest at 0 A; currents in both directions"
    node = "input"
    warms = -1
    confused_with = ("entropic_heat", "resistance_asymmetry", "hysteresis")
    parameters = (EffectParameter("b", "offset of the current sensor", "A", 1.0, 0.0, 2.0, -10.0, 10.0, probe=0.6),)

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Subtract the offset from the mean, the mean square, the mean magnitude and the power."""
        b = p["b"]
        z.I2 = np.maximum(z.I2 - 2.0 * b * z.I + b * b, 0.0)
        z.I_abs = z.I_abs + np.abs(z.I - b) - np.abs(z.I)
        z.IV = z.IV - b * z.V
        z.I = z.I - b
