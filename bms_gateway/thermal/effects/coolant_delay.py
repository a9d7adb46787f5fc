"""The coolant needs time from the inlet sensor to the first cell."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import lag
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

PLUG = 0.65
"""Share of the delay that is transport through hoses and channels; the rest is mixing, with plenums and walls."""
LONGEST = 120.0
"""s: upper bound of the delay, and so of the memory."""
LEAST_SPREAD = 0.1
"""K: standard deviation of the inlet below which no delay is visible."""


class CoolantDelay(Effect):
    r"""The inlet temperature reaches the cells late and rounded: transport, then one first-order lag.

    .. math:: \frac{\hat T_{f,in}(s)}{T_{f,in}(s)} = \frac{e^{-0.65 \tau s}}{1 + 0.35 \tau s}
    """

    name = "coolant_delay"
    title = "coolant arrives late"
    equation = "T_in -> T_in delayed by tau (65 % transport, then a lag of 35 %)"
    signature = "error follows the slope of the inlet temperature"
    needs = "steps of the coolant inlet"
    node = "coolant"
    confused_with = ("thermocouple_lag",)
    one_sided = True
    parameters = (EffectParameter("tau", "mean delay", "s", 1.0, 0.0, 15.0, 0.0, 120.0, probe=5.0),)

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try a short and a long delay: the error is not linear in the delay."""
        return ({"tau": 5.0}, {"tau": 30.0})

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return nothing if the inlet does not move."""
        return ("tau",) if np.std(u.T_in) > LEAST_SPREAD else ()

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats]:
        """Return delayed minus recorded inlet per interval, K; carry: lag, interval, and past inlet, °C."""
        reach = int(np.ceil(PLUG * LONGEST / u.dt)) + 1
        past = np.full(reach, u.T_in[0]) if carry is None else _past(carry, u.dt, reach)
        whole, part = divmod(PLUG * p["tau"] / u.dt, 1.0)
        known = np.concatenate([past, u.T_in])
        last = np.arange(reach, len(known)) - int(whole)
        moved = (1.0 - part) * known[last] + part * known[last - 1]
        begin = float(u.T_in[0]) if carry is None else float(carry[0])
        y, mean = lag(moved, u.dt, (1.0 - PLUG) * p["tau"], begin)
        return (mean - u.T_in)[:, None], np.concatenate([[y[-1], u.dt], known[-reach:]])

    def inputs(self, z: Point, p: Values, at: Floats) -> None:
        """Replace the recorded inlet by the delayed one."""
        z.T_in = z.T_in + z.memory[z.key]


def _past(carry: Floats, dt: float, reach: int) -> Floats:
    """Inlet of the last `reach` intervals, the latest last; a carry with other intervals is read by its ages."""
    values, was = carry[2:], float(carry[1])
    if was == dt:
        return values
    ages = (np.arange(reach)[::-1] + 0.5) * dt
    return np.asarray(np.interp(ages, (np.arange(len(values)) + 0.5) * was, values[::-1]))
