"""Frames that gathered while the service was kept from reading belong to the ticks in which they were stamped."""

import time

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.service.live import Gateway
from tests.service.engine import TICK_NS, TickEngine
from tests.support.live_service import FRAME, come, run


def test_a_timer_waits_until_a_drain_has_left_nothing(bus):
    """Of what gathered in a stall a port may take only so much at once; the rest is stamped before the timer, too."""
    engine, left, drain, held = TickEngine(), [], bus.port.drain, []

    def by_fives():
        left.append(drain())
        frames = FrameBatch.concat(left)
        left[:] = [frames[5:]]
        bus.port.emptied = len(frames) <= 5
        return frames[:5]

    bus.port.drain = by_fives

    async def stall():
        await come(lambda: len(engine.ticks) >= 3)
        for _ in range(100):  # more than a tick without anybody reading, and then twenty drains' worth
            bus.theirs.send(FRAME)
            time.sleep(2.5 * TICK_NS / 1e9 / 100)
            drained = drain()
            left.append(drained)
            held.append(len(drained))

    async def begin():
        bus.theirs.send(FRAME)

    run(Gateway(engine, bus.port), begin(), stall(), until=lambda: sum(n for _, n in engine.ticks) >= 101)
    assert sum(held) >= 99
    assert engine.late == []
