"""Losses by hysteresis of the open-circuit voltage: the gap grows with the charge moved in one direction."""

from math import exp, expm1

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

TURNED = 0.01
"""Share of Q that must have moved backwards before the direction counts as changed: noise of a current sensor at rest
is no reversal."""


class Hysteresis(Effect):
    r"""Heat ∝ \|I\| that starts from zero after each change of direction.

    .. math:: q \to q + |I| \, V \bigl(1 - e^{-m/Q}\bigr)

    with m the charge moved since the current last changed its direction.
    """

    name = "hysteresis"
    title = "hysteresis of the open-circuit voltage"
    equation = "Q_c -> Q_c + |I|*V*(1 - exp(-moved/Q)), moved = charge since the last reversal"
    signature = "heat follows |I| and builds up after the current has changed its sign"
    needs = "long and short half-cycles"
    node = "core"
    warms = 1
    confused_with = ("current_offset", "resistance_soc", "entropic_heat")
    one_sided = True
    parameters = (
        EffectParameter("V", "gap when fully built up", "mV", 1e-3, 0.0, 0.02, 0.0, 0.2, probe=0.006),
        EffectParameter(
            "Q",
            "charge that builds it up",
            "Ah",
            3600.0,
            540.0,
            1.0,
            7.2,
            18000.0,
            log=True,
            probe=540.0,
            neutral=None,
        ),
    )

    def starts(self, low: float, high: float) -> tuple[dict[str, float], ...]:
        """Try a short and a long build-up."""
        return ({"Q": 180.0}, {"Q": 1440.0})

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return nothing if the current has one direction only."""
        return ("V", "Q") if np.any(u.I < 0.0) and np.any(u.I > 0.0) else ()

    def follow(self, u: Drive, p: Values, carry: Floats | None) -> tuple[Floats, Floats]:
        """Build-up 1 − exp(−m/Q) as its mean over each interval.

        Carry: charge moved in the present direction [C], that direction, charge moved against it since [C].
        """
        Q = p["Q"]
        moved, direction, against = (0.0, 0.0, 0.0) if carry is None else map(float, carry)
        turned, dt = TURNED * Q, u.dt
        built = []
        for current in u.I.tolist():
            step = abs(current) * dt
            if current * direction < 0.0:
                against += step
                if against < turned:
                    built.append(-expm1(-moved / Q))
                    continue
                moved, direction, step = 0.0, -direction, against
            elif direction == 0.0 and current != 0.0:
                direction = 1.0 if current > 0.0 else -1.0
            against = 0.0
            x = step / Q
            built.append(1.0 - exp(-moved / Q) * (-expm1(-x) / x if x > 1e-12 else 1.0))
            moved += step
        return np.array(built)[:, None], np.array([moved, direction, against])

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Add |I| times the gap."""
        z.core = z.core + z.I_abs * p["V"] * z.memory[z.key]
