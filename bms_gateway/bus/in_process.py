"""A bus inside the process: for the demo where there is no CAN, and for tests. Same input, same result, no threads."""

from collections.abc import Callable

import numpy as np

from bms_gateway.bus.port import GATHER_S, Counters, Link
from bms_gateway.frames.batch import FrameBatch


class MemoryBus:
    """Ports that are connected: each receives the frames of all others, and not its own.

    Parameters
    ----------
    clock : callable, optional
        Bus time, ns: frames are stamped when they are sent, as a real bus does. Without it stamps stay as the sender
        made them and the newest one is the time.

    Examples
    --------
    >>> bus = MemoryBus()
    >>> a, b = bus.port(), bus.port()
    >>> a.send(FrameBatch(np.array([5]), np.array([1], np.uint32), np.array([0], np.uint8), np.zeros((1, 8), np.uint8)))
    >>> len(a.drain()), len(b.drain()), b.now_ns()
    (0, 1, 5)
    """

    def __init__(self, clock: Callable[[], int] | None = None) -> None:
        self._clock = clock
        self._latest_ns = 0
        self._ports: list[MemoryPort] = []

    def port(self) -> "MemoryPort":
        """Join the bus."""
        port = MemoryPort(self)
        self._ports.append(port)
        return port

    def now_ns(self) -> int:
        """Bus time."""
        return self._latest_ns if self._clock is None else self._clock()

    def put(self, frames: FrameBatch, sender: "MemoryPort") -> None:
        """Hand frames to every port but the sender."""
        if not len(frames):
            return
        if self._clock is not None:
            stamp = np.full(len(frames), self._clock(), np.int64)
            frames = FrameBatch(stamp, frames.can_id, frames.length, frames.data)
        self._latest_ns = max(self._latest_ns, int(frames.time_ns.max()))
        for port in self._ports:
            if port is not sender:
                port.deliver(frames)

    def leave(self, port: "MemoryPort") -> None:
        """Remove a port from the bus."""
        self._ports.remove(port)


class MemoryPort:
    """One node of a `MemoryBus`, as a `Port`."""

    gather_s = GATHER_S
    emptied = True

    def __init__(self, bus: MemoryBus) -> None:
        self._bus = bus
        self._arrived: list[FrameBatch] = []
        self.counters = Counters()
        self.link = Link.UP

    def fileno(self) -> int:
        """There is no file descriptor to wait for: the port is polled."""
        return -1

    def now_ns(self) -> int:
        """Bus time."""
        return self._bus.now_ns()

    def deliver(self, frames: FrameBatch) -> None:
        """Take in frames of another node."""
        self._arrived.append(frames)
        self.counters.received += len(frames)

    def drain(self) -> FrameBatch:
        """Take all that was delivered."""
        frames = FrameBatch.concat(self._arrived)
        self._arrived.clear()
        return frames

    def send(self, frames: FrameBatch) -> None:
        """Deliver to all others at once."""
        self.counters.sent += len(frames)
        self._bus.put(frames, self)

    def pump(self) -> float | None:
        """Nothing ever waits."""
        return None

    def close(self) -> None:
        """Leave the bus."""
        self._bus.leave(self)
