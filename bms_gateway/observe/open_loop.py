"""Open loop: the model runs on its inputs and uses no sensor. Other observers are compared with it.

Lin et al., Fig 9: the observer without its correction.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import Ints, StackedModel
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class MeanState:
    """Estimate without covariance: `x` (S, M) now and `x_before` (S, M) one step ago, °C."""

    x: Floats
    x_before: Floats


def predicted_surface(x: Floats, x_before: Floats, sensors: Ints, lag: Floats) -> Floats:
    """Surface temperatures at the instants of the readings, on the line from the previous to the present state.

    Parameters
    ----------
    x, x_before : ndarray (S, M)
    sensors : ndarray of int (S, m)
        0-based cells.
    lag : ndarray (S, m)
        Age of the reading as a share of the step, 0…1.

    Returns
    -------
    ndarray (S, m), °C
    """
    at = 2 * sensors + 1
    rows = np.arange(len(x))[:, None]
    now = x[rows, at]
    return now + lag * (x_before[rows, at] - now)


@dataclass(frozen=True, slots=True)
class OpenLoop:
    """Observer with no feedback.

    References
    ----------
    Lin et al., Fig 9: from a wrong start it needs about 31–36 min to 0.25 K.
    """

    model: StackedModel

    def init(self, x: Floats) -> MeanState:
        """Start from temperatures `x` (S, M), offsets zero."""
        return MeanState(x, x)

    def predict(self, state: MeanState, heat: Floats, inlet0: Floats, inlet1: Floats) -> MeanState:
        """Advance one step: `heat` (S, n) W, inlets (S,) °C at its start and end."""
        return MeanState(self.model.advance(state.x, heat, inlet0, inlet1), state.x)

    def update(self, state: MeanState, y: Floats, age: Floats) -> MeanState:  # noqa: ARG002 — it listens to nothing
        """Return the state as it is."""
        return state
