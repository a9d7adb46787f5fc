"""The interface that every source and sink of live frames offers to the service."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Protocol

from bms_gateway.frames.batch import FrameBatch

GATHER_S: Final = 0.01
"""How long frames may gather if the size of the buffer is unknown."""


class Link(Enum):
    """State of the way to the bus."""

    UP = "up"
    DOWN = "down"
    """The interface is there but switched off."""
    ABSENT = "absent"
    """There is no such interface (any more)."""
    BUS_OFF = "bus-off"
    """The controller has taken itself off the bus; it restarts as the interface's restart-ms says."""


@dataclass(slots=True)
class Counters:
    """Counters of a port since it was opened."""

    received: int = 0
    sent: int = 0
    dropped: int = 0
    """Lost in the kernel because we read too late."""
    remote: int = 0
    errors: dict[str, int] = field(default_factory=dict)
    """Error frames by class; one frame may be of several."""
    malformed: int = 0
    """Datagrams that are not CAN frames, and frames that no bus carries."""
    stale: int = 0
    """Not sent because a newer value was due."""
    overflow: int = 0
    """Not sent because the queue was full."""
    limited: int = 0
    """Not sent because its identifier had been sent too often."""
    impostors: int = 0
    """Frames with identifiers of our node from another sender: refused."""
    outages: int = 0
    clock_steps: int = 0
    misdated: int = 0
    """Frames with an impossible stamp: the time of arrival was used."""

    def note_impossible(self) -> None:
        """Count a datagram that cannot be a frame."""
        self.malformed += 1

    def note_error(self, name: str = "other") -> None:
        """Count an error frame of a class."""
        self.errors[name] = self.errors.get(name, 0) + 1


class Port(Protocol):
    """A bus to read from and to write to; no method blocks."""

    counters: Counters
    link: Link

    @property
    def emptied(self) -> bool:
        """Whether the latest drain took all frames that had arrived when it began; if not, no timer may fire yet."""
        ...

    @property
    def gather_s(self) -> float:
        """How long frames may wait in the buffer of the port, s, with reserve on a full bus."""
        ...

    def fileno(self) -> int:
        """Descriptor that becomes readable with the first frame, or −1: then it must be polled."""
        ...

    def now_ns(self) -> int:
        """Bus time now, on the line of the frames' stamps."""
        ...

    def drain(self) -> FrameBatch:
        """Take all frames that had arrived when the call began, or a part that can be processed at once."""
        ...

    def send(self, frames: FrameBatch) -> None:
        """Queue frames of our node; the stamp of each is the time at which it is due."""
        ...

    def pump(self) -> float | None:
        """Send and reconnect as due; return the seconds until the next call is needed, None if nothing waits."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...
