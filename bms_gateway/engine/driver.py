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
        In the order of the bus, cut at any place.

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
    """Yield the events that the engine holds now, and run its jobs at once."""
    while (event := engine.next_output()) is not None:
        if not isinstance(event, StartJob):
            yield event
        elif engine.awaits(
            event.job_id
        ):  # a batch may span the due time of a job as well: the engine has then run the job itself
            engine.finish(event.job_id, event.job.run())
