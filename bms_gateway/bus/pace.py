"""The queue of the frames that our node sends: only our identifiers, never in a burst, never late.

A token bucket spreads the frames of a tick over some milliseconds, so that other nodes can send in between. The queue
is bounded, and a frame that waited longer than its cycle is dropped: after an outage the bus gets the present values,
not a burst of old ones. No single identifier gets more than its share, so that a fault in our node cannot block others.
No config changes these limits.
"""

from collections import deque
from collections.abc import Mapping
from typing import Final

from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.port import Counters
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch

RATE: Final = 1_000  # frames/s: an eighth of a full 1 Mbit/s bus, enough for 500 cells at 1 Hz
BURST: Final = 8  # below the shortest transmit queue of a CAN interface (10)
QUEUE: Final = 4_096  # four seconds at that rate; longer than any of our cycles
ID_SHARE: Final = 16  # no id gets more than this part of the rate: 62 frames/s, three times what 18 cells at 1 Hz need
ID_BURST: Final = 4  # bursts of one id, in bursts of all: 32 frames, the 18 cells of a string and some more
REST_NS: Final = 10_000_000  # fewer wake-ups; at RATE ten tokens gather in it


class Pacer:
    """Queue and token bucket.

    Parameters
    ----------
    own : mapping of int to int
        Identifiers that may be sent, each with its cycle time, ns.
    counters : Counters
        `stale`, `overflow` and `limited` are counted here.
    rate : float
        Frames per second in the long run; `1 / ID_SHARE` of it for one identifier.
    burst : int
        Frames at once; `ID_BURST` times as many of one identifier until it must rest.
    """

    def __init__(self, own: Mapping[int, int], counters: Counters, *, rate: float = RATE, burst: int = BURST) -> None:
        self._own = dict(own)
        self._counters = counters
        self._gap_ns = round(1e9 / rate)
        self._full_ns = max(burst * self._gap_ns, REST_NS)
        self._credit_ns = burst * self._gap_ns
        self._at_ns: int | None = None
        self._id_gap_ns = ID_SHARE * self._gap_ns
        self._id_full_ns = ID_BURST * burst * self._id_gap_ns
        self._id_free_ns: dict[int, int] = {}  # when the bucket of an id that was sent is full again
        self._queue: deque[tuple[int, int, bytes]] = deque()

    def __len__(self) -> int:
        return len(self._queue)

    def offer(self, frames: FrameBatch) -> None:
        """Queue frames.

        Raises
        ------
        UsageError
            A frame is not of our node; none of the batch is queued.
        """
        ids = frames.can_id.tolist()
        for can_id in ids:
            if can_id not in self._own:
                raise UsageError(f"0x{can_id & 0x1FFFFFFF:X} is not an identifier of this node: not sent")
        for can_id, due, wire in zip(ids, frames.time_ns.tolist(), to_wire(frames), strict=True):
            if len(self._queue) == QUEUE:
                self._queue.popleft()
                self._counters.overflow += 1
            self._queue.append((due + self._own[can_id], can_id, wire))

    def head(self, now_ns: int) -> bytes | None:
        """Give the frame to send now, if there is one and the rate allows it; it stays until `done`."""
        while self._queue:
            latest, can_id, _ = self._queue[0]
            if latest < now_ns:
                self._counters.stale += 1
            elif self._id_free_ns.get(can_id, now_ns) - now_ns > self._id_full_ns - self._id_gap_ns:
                self._counters.limited += 1
            else:
                break
            self._queue.popleft()
        if self._at_ns is not None and now_ns > self._at_ns:
            self._credit_ns = min(self._full_ns, self._credit_ns + now_ns - self._at_ns)
        self._at_ns = now_ns
        return self._queue[0][2] if self._queue and self._credit_ns >= self._gap_ns else None

    def done(self) -> None:
        """Take note that the head was sent."""
        _, can_id, _ = self._queue.popleft()
        now_ns = self._at_ns or 0
        self._id_free_ns[can_id] = max(now_ns, self._id_free_ns.get(can_id, now_ns)) + self._id_gap_ns
        self._credit_ns -= self._gap_ns
        self._counters.sent += 1
