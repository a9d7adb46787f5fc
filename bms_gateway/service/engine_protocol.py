"""The methods of an engine that the service's loop needs; tests use simpler engines with the same methods."""

from collections.abc import Mapping
from typing import Protocol

from bms_gateway.engine.events import Event
from bms_gateway.frames.batch import FrameBatch


class LiveEngine(Protocol):
    """What the service needs of the engine; the service writes the number of frames lost in the port to `dropped`."""

    dropped: int

    def receive(self, frames: FrameBatch, *, now_ns: int) -> None:
        """Receive frames."""
        ...

    def next_deadline(self) -> int | None:
        """Bus time at which `handle_timer` must be called, or None."""
        ...

    def handle_timer(self, *, now_ns: int) -> None:
        """Do what is due."""
        ...

    def next_output(self) -> Event | None:
        """Return the next event, or None."""
        ...

    def finish(self, job_id: int, result: object) -> None:
        """Use the result of a job."""
        ...

    def snapshot(self) -> Mapping[str, object]:
        """State for a restart; the engine never changes it afterwards."""
        ...
