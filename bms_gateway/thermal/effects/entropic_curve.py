"""What the entropic coefficient does between the knots of `entropic_heat`: for curves, never offered as an effect."""

import numpy as np

from bms_gateway.thermal.effects.base import EffectParameter, Values
from bms_gateway.thermal.effects.entropic_heat import EntropicHeat
from bms_gateway.thermal.effects.laws import KELVIN, by_knots
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

FINE = np.linspace(0.0, 1.0, 21)
DEPARTS, REACH = 0.1e-3, 0.1
"""V/K by which coefficients of layered oxides and graphite depart from straight lines between the knots (sd), and the
charge over which they depart one way."""
MODES = 12
"""Of a random curve of that reach: all but a thousandth of its variance."""


def _modes() -> Floats:
    """Shapes (MODES, 21), V/K, whose sizes are independent and of sd 1 (Karhunen–Loève)."""
    covariance = DEPARTS**2 * np.exp(-0.5 * ((FINE[:, None] - FINE) / REACH) ** 2)
    value, shape = np.linalg.eigh(covariance)
    return np.asarray((shape * np.sqrt(np.maximum(value, 0.0))).T[::-1][:MODES])


SHAPES = _modes()


class EntropicCurve(EntropicHeat):
    r"""Reversible heat of a coefficient that departs from the knots of `entropic_heat`.

    .. math:: q \to q - I T_c \sum_k a_k \phi_k(\mathrm{SOC})
    """

    name = "entropic_curve"
    title = "reversible heat between the knots of entropic_heat"
    equation = "Q_c -> Q_c - I*T_c*sum(a_k*phi_k(SOC))"
    signals = ("soc",)
    parameters = tuple(
        EffectParameter(f"a_{k}", f"size of shape {k}", "1", 1.0, 0.0, 1.0, -10.0, 10.0, probe=1.0)
        for k in range(1, MODES + 1)
    )

    def determined(self, u: object) -> tuple[str, ...]:
        """All: what a record does not tell stays at its prior."""
        return tuple(p.name for p in self.parameters)

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Take I T dU/dT from each core's heat."""
        curve = np.array([p[q.name] for q in self.parameters]) @ SHAPES
        z.core = z.core - z.I * (z.T_c + KELVIN) * by_knots(z.soc, FINE, curve.tolist())
