"""The errors of the models of all strings at one tick, for fleets, which look for missing effects."""

from collections.abc import Mapping

from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.events import Judged, Judgement
from bms_gateway.engine.readings import Readings


def judged(t1: int, frames: int, rejected: Mapping[str, int], estimators: Estimators, readings: Readings) -> Judged:
    """Collect the errors of the tick that ends at `t1`, ns.

    Parameters
    ----------
    t1 : int
    frames : int
    rejected : mapping of str to int
        Counts so far.
    estimators : Estimators
    readings : Readings
        Inputs of the estimators at this tick.
    """
    innovation, innovation_sd = estimators.errors()
    of_each = []
    for i, s in enumerate(estimators.strings):
        reading = readings[i]
        of_each.append(
            Judgement(
                s.plan.name,
                innovation[s.mine],
                innovation_sd[s.mine],
                reading.means.I,
                reading.means.I2,
                reading.inlet,
                s.flow_ratio(reading.slow["coolant_flow"]),
                s.ageing.growth,
                s.ageing.growth_sd,
                s.mismatch.excess,
                s.flags,
                reading.slow["soc"],
                reading.means.V,
                reading.y,
                reading.age,
            )
        )
    return Judged(t1, frames, dict(rejected), tuple(of_each))
