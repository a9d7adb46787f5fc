"""Entropic coefficient between the knots of `entropic_heat`: for curves, never offered as an effect."""

import numpy as np

from bms_gateway.thermal.effects.base import EffectParameter, Values
from bms_gateway.thermal.effects.entropic_heat import EntropicHeat
from bms_gateway.thermal.effects.laws import by_knots
from bms_gateway.thermal.entropy import KELVIN
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

FINE = np.linspace(0.0, 1.0, 21)
DEPARTS, REACH = 0.1e-3, 0.1
"""V/K: sd of the differences between the coefficients of layered oxides and graphite and lines between the knots; and
the charge over which a difference keeps its sign."""
MODES = 12
"""Number of shapes of a random curve with that length: all but a thousandth of its variance."""


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
        """Return all: parameters that a record does not determine stay at their prior."""
        return tuple(p.name for p in self.parameters)

    def heats(self, z: Point, p: Values, at: Floats) -> None:
        """Subtract I T dU/dT from each core's heat."""
        curve = np.array([p[q.name] for q in self.parameters]) @ SHAPES
        z.core = z.core - z.I * (z.T_c + KELVIN) * by_knots(z.soc, FINE, curve.tolist())
