"""The film between surface and coolant thins as the coolant flows faster."""

import numpy as np

from bms_gateway.thermal.drive import Drive
from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

LEAST_FLOW = 0.01
"""Least flow ratio: below it the power law is not valid, and still air cools too."""
LEAST_SPREAD = 0.01
"""Spread of the flow ratio below which its exponent cannot be distinguished from R_u."""


class FlowDependentCooling(Effect):
    r"""R_u follows a power of the coolant flow; 0.63 is a bank of tubes in cross flow (Zukauskas).

    .. math:: R_u \to R_u \, (\text{flow}/\text{nominal})^{-n}
    """

    name = "flow_dependent_cooling"
    title = "cooling follows the coolant flow"
    equation = "R_u -> R_u * (flow/nominal)^-n"
    signature = "distance of the surface from the coolant per watt follows the flow"
    needs = "a flow that changes"
    node = "surface"
    warms = -1
    signals = ("flow",)
    plausibility = -1.5
    confused_with = ("cooling_drift",)
    parameters = (EffectParameter("n", "exponent", "1", 1.0, 0.0, 0.5, -0.5, 2.0, probe=0.15, least=0.0),)

    def determined(self, u: Drive) -> tuple[str, ...]:
        """Return nothing if the flow was not recorded or did not change."""
        return ("n",) if "flow" in u.known and np.std(u.flow) > LEAST_SPREAD else ()

    def coefficients(self, z: Point, p: Values, at: Floats) -> None:
        """Scale R_u by the power of the flow."""
        z.R_u = z.R_u * np.maximum(z.flow, LEAST_FLOW) ** -p["n"]
