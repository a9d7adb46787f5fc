"""From readings to states: open loop, Luenberger, Kalman and the adaptive observer, all with init, predict, update.

The observer of strings with effects is in `observe.effect_observer`. It imports the catalogue of effects, which a
gateway without effects need not load. `observe.open_loop` and `observe.luenberger`, which serve for comparison, are not
imported here either.
"""

from bms_gateway.observe.adaptive import AdaptiveObserver
from bms_gateway.observe.estimate import Errors, Estimate
from bms_gateway.observe.kalman import Innovation, Kalman, KalmanState, Predicted
from bms_gateway.observe.measured import Measured
from bms_gateway.observe.model import StackedModel, stack, start_covariance
from bms_gateway.observe.sensitivity import PARAMETERS
from bms_gateway.thermal import Disturbance, Start

__all__ = [
    "PARAMETERS",
    "AdaptiveObserver",
    "Disturbance",
    "Errors",
    "Estimate",
    "Innovation",
    "Kalman",
    "KalmanState",
    "Measured",
    "Predicted",
    "StackedModel",
    "Start",
    "stack",
    "start_covariance",
]
