"""The synchronous driver: frames from anywhere, events out, jobs run inline. Files, tests and fleets use it."""

from collections.abc import Iterable, Iterator

from bms_gateway.engine.engine import Engine
from bms_gateway.engine.events import Event, StartJob
from bms_gateway.frames.batch import FrameBatch


def drive(engine: Engine, batches: Iterable[FrameBatch]) -> Iterator[Event]:
    """Feed batches to the engine and yield its events in order.

    Parameters
    ----------
    engine : Engine
    batches : iterable of FrameBatch
        In bus order; how they are cut makes no difference.

    Yields
    ------
    Event
        All but `StartJob`: jobs are run at once.
    """
    for batch in batches:
        if len(batch):
            engine.receive(batch, now_ns=int(batch.time_ns.max()))
            yield from drain(engine)


def drain(engine: Engine) -> Iterator[Event]:
    """Yield what the engine has to say now, running its jobs inline."""
    while (event := engine.next_output()) is not None:
        if not isinstance(event, StartJob):
            yield event
        elif engine.awaits(event.job_id):  # one batch may hold the due time too: then the engine has run it itself
            engine.finish(event.job_id, event.job.run())
