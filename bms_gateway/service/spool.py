"""Messages that could not be sent yet: a bounded queue, from which the oldest is dropped and counted.

The queue is in memory and not on disk. A restart loses nothing that matters afterwards: an alert that still holds is
raised again, the status line is made from the present state, journald has the earlier reports, and the drive is in the
vehicle's own recordings. A spool on disk would write the more to the vehicle's flash the longer the broker is not
reached, and could fill the disk that the state needs. Alerts and estimates have a queue each, so that a night of
estimates never displaces an alert.
"""

from collections import deque
from dataclasses import dataclass
from threading import Lock
from typing import Final, Literal

Kind = Literal["alert", "estimate"]
KINDS: Final[tuple[Kind, ...]] = ("alert", "estimate")  # in the order in which they are sent
MOST_BYTES: Final = 4 << 20  # of one kind; a thousand messages of eight strings have 1 MiB


@dataclass(frozen=True, slots=True)
class Message:
    """One message for a broker."""

    topic: str
    payload: bytes


class Spool:
    """Queues of messages, filled by one thread and emptied by another.

    Parameters
    ----------
    limit : int
        Messages of each kind.

    Attributes
    ----------
    dropped : dict of str to int
        Messages dropped, by kind.

    Examples
    --------
    >>> spool = Spool(2)
    >>> for k in range(3):
    ...     spool.put("estimate", Message("t", b"%d" % k))
    >>> spool.put("alert", Message("t", b"a"))
    >>> kind, first = spool.head()
    >>> kind, first.payload, spool.waiting("estimate"), spool.dropped["estimate"]
    ('alert', b'a', 2, 1)
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._queues: dict[Kind, deque[Message]] = {kind: deque() for kind in KINDS}
        self._bytes = dict.fromkeys(KINDS, 0)
        self._lock = Lock()
        self.dropped: dict[Kind, int] = dict.fromkeys(KINDS, 0)

    def put(self, kind: Kind, message: Message) -> None:
        """Add a message; if there are too many of its kind, the oldest are dropped."""
        with self._lock:
            queue = self._queues[kind]
            queue.append(message)
            self._bytes[kind] += len(message.payload)
            while len(queue) > self._limit or (self._bytes[kind] > MOST_BYTES and queue):
                self._bytes[kind] -= len(queue.popleft().payload)
                self.dropped[kind] += 1

    def head(self) -> tuple[Kind, Message] | None:
        """Return the next message: alerts before estimates, old before new; it stays until `sent`."""
        with self._lock:
            return next(((kind, queue[0]) for kind, queue in self._queues.items() if queue), None)

    def sent(self, kind: Kind, message: Message) -> None:
        """Remove a message that `head` has returned; it may have been dropped while it was sent."""
        with self._lock:
            queue = self._queues[kind]
            if queue and queue[0] is message:
                queue.popleft()
                self._bytes[kind] -= len(message.payload)

    def waiting(self, kind: Kind) -> int:
        """Messages of a kind that are not sent yet."""
        return len(self._queues[kind])
