"""Every interface that python-can knows, as a `Port`: for hardware without SocketCAN, and python-can's virtual bus.

SocketCAN has its own port, which costs a tenth. Sending goes through the same queue: own ids only, paced, never late.
"""

import logging
import time
from typing import TYPE_CHECKING, Final

import numpy as np

from bms_gateway.bus.access import LISTEN, Access
from bms_gateway.bus.canframe import from_wire
from bms_gateway.bus.clock import BusClock
from bms_gateway.bus.filters import group_filters
from bms_gateway.bus.impostor import Impostors
from bms_gateway.bus.message import to_batch, to_message
from bms_gateway.bus.pace import Pacer
from bms_gateway.bus.port import GATHER_S, Counters, Link
from bms_gateway.errors import BusError, UsageError, did_you_mean
from bms_gateway.frames.batch import FrameBatch

if TYPE_CHECKING:
    import can

log = logging.getLogger(__name__)

DRAIN_MOST: Final = 4_096  # four tenths of a second of a full bus; a drain must end though senders go on
RETRY_FIRST_S: Final = 0.2  # drivers of USB adapters need about as long to come back
RETRY_MOST_S: Final = 5.0  # opening some drivers takes a second; don't do it all the time
FULL_S: Final = 0.01
AHEAD_S: Final = 3_600.0  # stamps further than this from the wall clock count from the driver's start


class PythonCanPort:
    """A python-can bus as a `Port`.

    Parameters
    ----------
    interface, channel : str
        As python-can names them.
    access : Access
        Identifiers to receive and to send.
    clock : BusClock, optional

    Raises
    ------
    UsageError
        python-can has no such interface.
    BusError
        The interface cannot be opened.
    """

    gather_s = GATHER_S

    def __init__(self, interface: str, channel: str, access: Access = LISTEN, *, clock: BusClock | None = None) -> None:
        import can  # slow to load, and the SocketCAN port does without

        known = sorted(can.VALID_INTERFACES)
        if interface not in known:
            raise UsageError(f"no CAN interface '{interface}'{did_you_mean(interface, known)}")
        self.interface, self.channel = interface, channel
        self.counters = Counters()
        self.link = Link.UP
        self.emptied = True
        self._clock = clock or BusClock()
        self._pacer = Pacer(access.own, self.counters, rate=access.rate, burst=access.burst)
        self._impostors = Impostors(channel, access.own, self.counters)
        # filtered here: with filters set, python-can's recv(0) returns nothing at the first frame that it filters out
        received = access.received
        self._wanted = None if received is None else np.array(sorted(received), np.uint32)
        self._groups = group_filters(access.any_sender)
        self._delay_s = self._retry_at = self._down_at = 0.0
        self._shift_s: float | None = None
        self._refused = False
        self._failure = can.CanError
        self._bus: can.BusABC | None = self._open()

    def fileno(self) -> int:
        """Not every driver can be waited for: poll."""
        return -1

    def now_ns(self) -> int:
        """Bus time."""
        now = self._clock.now_ns()
        self.counters.clock_steps = self._clock.steps
        return now

    def drain(self) -> FrameBatch:
        """Take the frames that have arrived; faults of the interface raise no exception."""
        messages: list[can.Message] = []
        self._clock.begin()
        self.emptied = self._bus is None
        while self._bus is not None and len(messages) < DRAIN_MOST:
            try:
                message = self._bus.recv(0)
            except (self._failure, OSError) as error:
                self._failed(self._bus, error)
                self.emptied = True  # the frames that it still held are lost
                break
            if message is None:
                self.emptied = True
                break
            messages.append(message)
        if not messages:
            return FrameBatch.empty()
        if self._shift_s is None:
            off = self._clock.now_ns() / 1e9 - messages[0].timestamp
            self._shift_s = off if abs(off) > AHEAD_S else 0.0
        batch = to_batch(messages, self.counters, self._shift_s)
        time_ns = self._clock.to_bus(batch.time_ns, emptied=self.emptied)
        self.counters.misdated = self._clock.misdated
        keep = np.ones(len(batch), np.bool_) if self._wanted is None else np.isin(batch.can_id, self._wanted)
        for can_id, mask in self._groups:
            keep |= (batch.can_id & np.uint32(mask)) == can_id
        self.counters.received += len(batch)
        wanted = FrameBatch(time_ns[keep], batch.can_id[keep], batch.length[keep], batch.data[keep])
        return self._impostors.refuse(wanted)

    def send(self, frames: FrameBatch) -> None:
        """Queue frames of our node.

        Raises
        ------
        UsageError
            A frame has an id that is not ours.
        """
        self._pacer.offer(frames)

    def pump(self) -> float | None:
        """Reconnect and send as due; return the seconds until the next call is needed, None if nothing waits."""
        if self._bus is None:
            wait = self._retry_at - time.monotonic()
            if wait > 0:
                return wait
            try:
                self._bus = self._open()
            except BusError as error:
                log.debug("%s", error)
                return self._grow_delay()
            log.warning("%s %s is back after %.1f s", self.interface, self.channel, time.monotonic() - self._down_at)
            self.link, self._delay_s = Link.UP, 0.0
        now_ns = self.now_ns()
        while (wire := self._pacer.head(now_ns)) is not None:
            try:
                self._bus.send(to_message(*from_wire(wire)), timeout=0)
            except (self._failure, OSError) as error:
                # python-can does not distinguish a full queue from a fault: wait; frames that become too old are
                # dropped
                if not self._refused:
                    log.warning("%s %s takes no frames (%s)", self.interface, self.channel, error)
                self._refused = True
                return FULL_S
            self._refused = False
            self._pacer.done()
        return FULL_S if len(self._pacer) else None

    def close(self) -> None:
        """Shut the interface down."""
        if self._bus is not None:
            self._bus.shutdown()

    def _open(self) -> "can.BusABC":
        import can

        try:
            return can.Bus(interface=self.interface, channel=self.channel)
        except (NameError, AttributeError, ImportError) as error:
            # drivers load their vendor's library when they are imported and fail over its names only when opened
            raise BusError(
                f"{self.interface} {self.channel} cannot be opened: is the driver's library installed? ({error})"
            ) from None
        except (can.CanError, OSError, ValueError, TypeError) as error:  # TypeError: it wants options that we have not
            raise BusError(f"{self.interface} {self.channel} cannot be opened: {error}") from None

    def _failed(self, bus: "can.BusABC", error: Exception) -> None:
        self.counters.outages += 1
        self._down_at = time.monotonic()
        self.link = Link.ABSENT
        log.warning("%s %s failed (%s): trying again until it is back", self.interface, self.channel, error)
        bus.shutdown()
        self._bus = None
        self._grow_delay()

    def _grow_delay(self) -> float:
        self._delay_s = min(max(RETRY_FIRST_S, 2 * self._delay_s), RETRY_MOST_S)
        self._retry_at = time.monotonic() + self._delay_s
        return self._delay_s
