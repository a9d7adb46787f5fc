"""Reversible heat: charging and discharging change the entropy of the electrodes."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import by_knots
from bms_gateway.thermal.entropy import KELVIN
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

KNOTS = np.array([0.05, 0.35, 0.65, 0.95])
LEAST_SPAN = 0.2
"""SOC span below which a record determines one number only."""
REACH = 0.15
"""A record determines a knot if it comes within half a knot spacing of it."""


def _departure(number: int) -> EffectParameter:
    text = f"departure from it at {100.0 * KNOTS[number - 1]:.3g} % SOC"
    return EffectParameter(f"dUdT_{number}", text, "mV/K", 1e-3, 0.0, 0.25e-3, -1.5e-3, 1.5e-3, probe=0.1e-3)


class EntropicHeat(Effect):
    r"""Heat proportional to the current; its sign changes with that of the current and with the state of charge.

    .. math:: q \to q - I T_c \, \frac{dU}{dT}(\mathrm{SOC})

    The coefficient is a level plus a difference at each of four knots, linear between them. A record with little SOC
    span determines only the level; outside the recorded range, the curve returns to the level and not to zero.
    """

    name = "entropic_heat"
    title = "reversible (entropic) heat"
    equation = "Q_c -> Q_c - I*T_c*dU/dT, dU/dT = dUdT + departures by SOC"
    signature = "error follows the smoothed current and changes sign with it, and with SOC"
    needs = "charge and discharge of unequal strength or length; over 20 % SOC span for its dependence on SOC"
    node = "core"
    warms = -1
    plausibility = 0.0
    confused_with = ("current_offset", "resistance_asymmetry")
    parameters = (
        EffectParameter(
            "dUdT", "level of the entropic coefficient", "mV/K", 1e-3, 0.0, 0.25e-3, -1.5e-3, 1.5e-3, probe=0.1e-3
        ),
        *(_departure(k) for k in (1, 2, 3, 4)),
    )

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return the level alone below 20 % SOC span, else also the knots near the recorded range."""
        if "soc" not in u.known or np.ptp(u.soc) < LEAST_SPAN:
            return ("dUdT",)
        low, high = float(np.min(u.soc)) - REACH, float(np.max(u.soc)) + REACH
        return ("dUdT", *(f"dUdT_{k}" for k, knot in enumerate(KNOTS, 1) if low <= knot <= high))

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Subtract I T dU/dT from each core's heat."""
        slope = p["dUdT"] + by_knots(z.soc, KNOTS, [p[f"dUdT_{k}"] for k in (1, 2, 3, 4)])
        z.core = z.core - z.I * (z.T_c + KELVIN) * slope
