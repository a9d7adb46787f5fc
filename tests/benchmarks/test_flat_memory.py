"""What an engine keeps does not grow with the time it has run."""

import gc
import tracemalloc
from collections.abc import Iterator

import pytest

from bms_gateway.bus.traffic import SECOND, Traffic
from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.engine import Engine, drive
from bms_gateway.frames.batch import FrameBatch
from tests.engine.packs import database, plan

SETTLED_S, END_S = 1_800, 3_000  # at both the same part of a window (1,200 s) is filled
GROWTH = 50_000  # bytes; the estimates and frames of the time in between take twenty times as much


def minutes(seconds: int) -> Iterator[FrameBatch]:
    the_plan = plan(1)
    source = Traffic(the_plan, database(), noise_K=0.1, seed=3)
    for segments in VirtualPack(the_plan, 3).segments(seconds):
        time = segments[0].time_s
        yield source.between([s.series for s in segments], int(time[0]) * SECOND, int(time[-1]) * SECOND)


@pytest.mark.slow  # tracing makes it slow, not the engine
def test_memory_held_by_an_engine_is_flat() -> None:
    engine, held = Engine(plan(1), database()), {}
    tracemalloc.start()
    try:
        for batch in minutes(END_S):
            for _ in drive(engine, [batch]):
                pass
            gc.collect()
            held[round(int(batch.time_ns[-1]) / SECOND)] = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert held[END_S] - held[SETTLED_S] < GROWTH
