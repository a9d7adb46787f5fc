"""The coolant takes its time from the inlet sensor to the first cell."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import lag
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

STAGES = 8
"""Equal lags in a row: the spread of arrival times (tau/sqrt 8) is that of 65 % plug flow and 35 % mixing."""
LEAST_SPREAD = 0.1
"""K: standard deviation of the inlet below which no delay shows."""


class CoolantDelay(Effect):
    r"""The inlet temperature reaches the cells late and rounded: eight equal first-order lags in a row.

    .. math:: \frac{\hat T_{f,in}(s)}{T_{f,in}(s)} = \frac{1}{(1 + s \tau / 8)^8}
    """

    name = "coolant_delay"
    title = "coolant arrives late"
    equation = "T_in -> T_in delayed by tau (eight lags of tau/8: mostly transport, partly mixing)"
    signature = "error follows the slope of the inlet temperature"
    needs = "steps of the coolant inlet"
    node = "coolant"
    confused_with = ("thermocouple_lag",)
    one_sided = True
    parameters = (EffectParameter("tau", "mean delay", "s", 1.0, 0.0, 15.0, 0.0, 120.0, probe=5.0),)

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try a short and a long one: the error is no straight function of the delay."""
        return ({"tau": 5.0}, {"tau": 30.0})

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Nothing where the inlet does not move."""
        return ("tau",) if np.std(u.T_in) > LEAST_SPREAD else ()

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats]:
        """Delayed minus recorded inlet over each interval, K; carried on: the stages, °C."""
        begin = np.full(STAGES, u.T_in[0]) if carry is None else carry
        x, end = u.T_in, np.empty(STAGES)
        for stage in range(STAGES):
            y, x = lag(x, u.dt, p["tau"] / STAGES, float(begin[stage]))
            end[stage] = y[-1]
        return (x - u.T_in)[:, None], end

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Put the delayed inlet in the place of the recorded one."""
        z.T_in = z.T_in + z.memory[z.key]
