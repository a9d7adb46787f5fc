"""Slow polarisation: an overpotential that follows the current with a delay."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import lag
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point


class Polarization(Effect):
    r"""One RC pair: R_1 takes the lagged current, and R_e is the immediate part.

    .. math:: \tau \dot V_1 = I R_1 - V_1, \qquad q \to q + V_1^2 / R_1
    """

    name = "polarization"
    title = "slow polarisation (one RC pair)"
    equation = "Q_c -> Q_c + V_1^2/R_1, tau*dV_1/dt = I*R_1 - V_1"
    signature = "heat lags the current: a long pulse heats more than short ones of the same mean I^2"
    needs = "pulses of different length"
    node = "core"
    warms = 1
    plausibility = -1.5
    confused_with = ("resistance_asymmetry", "radial_gradient")
    one_sided = True
    parameters = (
        EffectParameter("R_1", "resistance of the slow part", "mOhm", 1e-3, 0.0, 2e-3, 0.0, 2e-2, probe=0.6e-3),
        EffectParameter(
            "tau", "its time constant", "s", 1.0, 40.0, 0.7, 5.0, 400.0, log=True, probe=40.0, neutral=None
        ),
    )

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try a fast and a slow polarisation."""
        return ({"tau": 15.0}, {"tau": 60.0})

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats]:
        """Mean square of the lagged current over each interval, A²; carry: that current, A."""
        tau = p["tau"]
        y, mean = lag(u.I, u.dt, tau, 0.0 if carry is None else float(carry[0]))
        gap = y[:-1] - u.I
        shared = tau / (2.0 * u.dt) * -np.expm1(-2.0 * u.dt / tau)
        square = u.I * u.I + 2.0 * u.I * (mean - u.I) + gap * gap * shared
        return square[:, None], y[-1:]

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Add the heat in R_1."""
        z.core = z.core + p["R_1"] * z.memory[z.key]
