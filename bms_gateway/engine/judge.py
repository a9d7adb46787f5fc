"""How the models of all strings did at one tick, told to whoever asks: fleets, which look for what models lack."""

from collections.abc import Mapping, Sequence

from bms_gateway.engine.events import Judged, Judgement
from bms_gateway.engine.inputs import Reading
from bms_gateway.engine.string import StringEstimator


def judged(
    t1: int, frames: int, rejected: Mapping[str, int], strings: Sequence[StringEstimator], readings: Sequence[Reading]
) -> Judged:
    """Gather the errors of the tick that ends at `t1`, ns.

    Parameters
    ----------
    t1 : int
    frames : int
    rejected : mapping of str to int
        Counts so far.
    strings, readings : sequence
        In the order of the plan.
    """
    return Judged(t1, frames, dict(rejected), tuple(_one(s, r) for s, r in zip(strings, readings, strict=True)))


def _one(s: StringEstimator, reading: Reading) -> Judgement:
    return Judgement(
        s.plan.name,
        s.innovation,
        s.innovation_sd,
        reading.means.I,
        reading.means.I2,
        reading.inlet,
        s.flow_ratio(reading),
        s.ageing.growth,
        s.ageing.growth_sd,
        s.mismatch.excess,
        s.flags,
    )
