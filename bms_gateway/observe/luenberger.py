"""Luenberger observer: a constant gain, chosen by hand, pulls the model to the readings.

The paper's gain for one cell, L = [0, 0.01], moves only the surface, and very little: it is nearly an open loop.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import Ints, StackedModel
from bms_gateway.observe.open_loop import MeanState, predicted_surface
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Luenberger:
    """Observer with constant gain.

    Attributes
    ----------
    model : StackedModel
    sensors : ndarray of int (S, m)
        0-based sensed cells.
    L : ndarray (S, M, m)
        Gain per step on y − ŷ.

    References
    ----------
    Lin et al., Fig 5, on the model of Eq 13 (whose B₁₁ is R_e/C_c).
    """

    model: StackedModel
    sensors: Ints
    L: Floats

    def init(self, x: Floats) -> MeanState:
        """Start from temperatures `x` (S, M)."""
        return MeanState(x, x)

    def predict(self, state: MeanState, heat: Floats, inlet0: Floats, inlet1: Floats) -> MeanState:
        """Advance one step: `heat` (S, n) W, inlets (S,) °C at its start and end."""
        return MeanState(self.model.advance(state.x, heat, inlet0, inlet1), state.x)

    def update(self, state: MeanState, y: Floats, age: Floats) -> MeanState:
        """Correct by readings `y` (S, n) °C, NaN where there is none, of `age` (S, n) s."""
        rows = np.arange(len(y))[:, None]
        lag = np.clip(age[rows, self.sensors] / self.model.dt, 0.0, 1.0)
        r = y[rows, self.sensors] - predicted_surface(state.x, state.x_before, self.sensors, lag)
        r = np.where(np.isfinite(r), r, 0.0)
        return MeanState(state.x + np.matmul(self.L, r[:, :, None])[:, :, 0], state.x_before)
