"""What the service's loop needs of an engine, and no more: tests put simpler ones in its place."""

from collections.abc import Mapping
from typing import Protocol

from bms_gateway.engine.events import Event
from bms_gateway.frames.batch import FrameBatch


class LiveEngine(Protocol):
    """What the shell needs of the engine; it tells it in `dropped` how many frames the port has lost."""

    dropped: int

    def receive(self, frames: FrameBatch, *, now_ns: int) -> None:
        """Take frames in."""
        ...

    def next_deadline(self) -> int | None:
        """Bus time at which `handle_timer` is wanted, or None."""
        ...

    def handle_timer(self, *, now_ns: int) -> None:
        """Do what is due."""
        ...

    def next_output(self) -> Event | None:
        """Give the next event, or None."""
        ...

    def finish(self, job_id: int, result: object) -> None:
        """Take the result of a job."""
        ...

    def snapshot(self) -> Mapping[str, object]:
        """State to go on from; nothing in it changes any more when the engine goes on."""
        ...
