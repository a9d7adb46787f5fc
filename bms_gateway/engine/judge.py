"""How the models of all strings did at one tick, told to whoever asks: fleets, which look for what models lack."""

from collections.abc import Mapping, Sequence

from bms_gateway.engine.events import Judged, Judgement
from bms_gateway.engine.readings import Reading, Readings
from bms_gateway.engine.string import StringEstimator


def judged(
    t1: int, frames: int, rejected: Mapping[str, int], strings: Sequence[StringEstimator], readings: Readings
) -> Judged:
    """Gather the errors of the tick that ends at `t1`, ns.

    Parameters
    ----------
    t1 : int
    frames : int
    rejected : mapping of str to int
        Counts so far.
    strings : sequence of StringEstimator
    readings : Readings
    """
    return Judged(t1, frames, dict(rejected), tuple(_one(s, readings[i]) for i, s in enumerate(strings)))


def _one(s: StringEstimator, reading: Reading) -> Judgement:
    return Judgement(
        s.plan.name,
        s.innovation,
        s.innovation_sd,
        reading.means.I,
        reading.means.I2,
        reading.inlet,
        s.flow_ratio(reading.flow),
        s.ageing.growth,
        s.ageing.growth_sd,
        s.mismatch.excess,
        s.flags,
    )
