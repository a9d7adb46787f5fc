"""A ring written as the service writes it, from traffic driven through the engine."""

from pathlib import Path

from bms_gateway.engine import Decoded, Engine, drive
from bms_gateway.store.recent import Recent
from tests.engine.packs import database, plan, traffic


def recorded(folder: Path, *, seconds=240, megabytes=64.0, every=60, strings=2, shift_ns=0, seed=1):
    """Drive traffic, writing a block every so many ticks; the events."""
    engine = Engine(plan(strings), database())
    engine.recording = True
    ring = Recent(folder, megabytes)
    events = []
    frames = traffic(seconds, seed, strings)
    frames.time_ns[:] += shift_ns
    for event in drive(engine, [frames]):
        if isinstance(event, Decoded):
            events.append(event)
            ring.add(event, engine)
            if len(events) % every == 0:
                assert ring.flush() is None
    assert ring.flush() is None
    return events
