"""Irreversible heat from the measured voltage, for any overpotential."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.effects.laws import by_knots
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

KNOTS = np.array([0.05, 0.275, 0.5, 0.725, 0.95])
REACH = 0.1125
"""A record determines a knot if it comes within half a knot spacing of it."""


def _departure(number: int) -> EffectParameter:
    text = f"departure from it at {100.0 * KNOTS[number - 1]:.3g} % SOC"
    # 0.2 V: LFP changes by 0.1 V over the range, NMC by 0.7
    return EffectParameter(f"U_{number}", text, "V", 1.0, 0.0, 0.2, -1.0, 1.0, probe=0.05)


class VoltageHeat(Effect):
    r"""The difference between open-circuit and terminal voltage times the current, instead of I²R_e.

    .. math:: q = \overline{I} \, U(\mathrm{SOC}) - \overline{I V}

    U is a level plus a difference at each of five knots, linear between them. Intervals without a voltage keep I²R_e.
    """

    name = "voltage_heat"
    title = "heat from the measured voltage"
    equation = "Q_c = I*(U(SOC) - V) in place of I^2*R_e, U = level + departures by SOC"
    signature = "error follows whatever the overpotential does beyond I*R_e"
    needs = "a voltage measured at the cells' own terminals"
    node = "core"
    signals = ("voltage", "soc")
    parameters = (
        EffectParameter(
            "U", "level of the open-circuit voltage", "V", 1.0, 3.3, 0.4, 1.2, 4.8, probe=3.3, neutral=None
        ),
        *(_departure(k) for k in (1, 2, 3, 4, 5)),
    )

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return the level, and the knots near the recorded range."""
        if not {"voltage", "soc"} <= u.known:
            return ()
        low, high = float(np.min(u.soc)) - REACH, float(np.max(u.soc)) + REACH
        return ("U", *(f"U_{k}" for k, knot in enumerate(KNOTS, 1) if low <= knot <= high))

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Replace I²R_e by the voltage's heat where there is a voltage.

        The voltage is the mean of the cells; a cell with more resistance gets more of the heat.
        """
        U = p["U"] + by_knots(z.soc, KNOTS, [p[f"U_{k}"] for k in (1, 2, 3, 4, 5)])
        heat = (z.I * U - z.IV) * z.R_e / np.mean(z.R_e, axis=-1, keepdims=True)
        z.core = z.core + np.where(np.isnan(heat), 0.0, heat - z.I2 * z.R_e)
