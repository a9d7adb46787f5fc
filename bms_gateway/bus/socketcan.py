"""Raw SocketCAN port: drained on a timer, stamped by the kernel, still usable after every outage of the interface.

At 8,500 frames/s the wake-ups cost most of the time, not the bytes. So the service drains the socket every 100 ms if
the kernel's buffer is large enough, and one drain is one or two system calls and a few array operations (`receiver`).
The kernel stamps each frame on arrival, so the wait changes no result. The socket lives as long as the port. When
the interface goes away the kernel unbinds it (ENODEV, once) and it is bound again by name, with growing delays; when
the interface is switched off (ENETDOWN, once) it goes on by itself afterwards.

The same code runs above one end of a datagram socket pair, for hosts without CAN.
"""

import errno
import fcntl
import logging
import socket
import struct
import time
from typing import Final, Self

from bms_gateway.bus.access import LISTEN, Access
from bms_gateway.bus.canframe import BUS_OFF, ERROR_MASK, RESTARTED, to_batch
from bms_gateway.bus.clock import BusClock
from bms_gateway.bus.filters import LIMIT, MOST_GROUPS, group_filters, join_filters
from bms_gateway.bus.impostor import Impostors
from bms_gateway.bus.pace import Pacer
from bms_gateway.bus.port import GATHER_S, Counters, Link
from bms_gateway.bus.receiver import DEPTH, Receiver
from bms_gateway.errors import BusError
from bms_gateway.frames.batch import FrameBatch

log = logging.getLogger(__name__)

RETRY_FIRST_S: Final = 0.1  # `ip link set down; … up` takes about this long
RETRY_MOST_S: Final = 2.0  # longest wait after a USB adapter is plugged in again
FULL_S: Final = 0.01  # a full transmit queue of ten frames empties in 1–3 ms at 500 kbit/s; leave others some room
PACE_S: Final = 0.01  # rhythm of the token bucket: ten tokens per wake-up
RECEIVE_BUFFER: Final = 8 << 20  # two seconds of a full bus, should the machine be busy elsewhere; taken as it fills
FRAME_ROOM: Final = 1_024  # bytes that the kernel charges for a frame: 896 on vcan
FULL_BUS: Final = 8_500  # frames/s of 8 bytes at 1 Mbit/s
SPARE: Final = 4  # a reader may be delayed by this many gathering times before a frame is lost
GATHER_MOST_S: Final = 0.1  # ten wake-ups a second cost far less than the frames; longer saves little more
LEAST_ROOM: Final = 512  # bytes that the kernel charges for any frame: its own head alone takes more
SO_RCVBUFFORCE: Final = 33
CAN_RAW_ERR_FILTER: Final = 2
SIOCGIFFLAGS, IFF_UP = 0x8913, 1

_GONE = (errno.ENODEV, errno.ENXIO)
_FULL = (errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM)


class SocketCanPort:
    """A raw CAN socket as a `Port`.

    Parameters
    ----------
    channel : str
        Interface, for example "can0". It need not exist yet.
    access : Access
        Identifiers to receive and to send.
    receive_buffer : int
        Bytes to ask for.
    clock : BusClock, optional
    sock : socket.socket, optional
        A datagram socket of `struct can_frame` instead of the interface.

    Attributes
    ----------
    counters : Counters
    link : Link
    emptied : bool
        See `Port`.
    receive_buffer : int
        Bytes got.
    gather_s : float
        How long frames may wait in it, s: a quarter of the time in which a full bus fills it, within limits.

    Raises
    ------
    BusError
        This kernel has no SocketCAN.
    """

    def __init__(
        self,
        channel: str,
        access: Access = LISTEN,
        *,
        receive_buffer: int = RECEIVE_BUFFER,
        clock: BusClock | None = None,
        sock: socket.socket | None = None,
    ) -> None:
        self.channel = channel
        self.counters = Counters()
        self.link = Link.UP
        self.emptied = True
        self.clock = clock or BusClock()
        self._pacer = Pacer(access.own, self.counters, rate=access.rate, burst=access.burst)
        self._impostors = Impostors(channel, access.own, self.counters)
        self._delay_s = 0.0
        self._retry_at = self._down_at = 0.0
        self._last_drops = 0
        self._sock = sock or _raw_socket()
        self._sock.setblocking(False)
        self._receiver = Receiver(self._sock)
        self.receive_buffer = self._ask_buffer(receive_buffer)
        # more than the buffer holds (the kernel gives twice what it is asked for): a drain ends though senders go on
        self.drain_most = 2 * self.receive_buffer // LEAST_ROOM + DEPTH
        filled_s = 2 * self.receive_buffer / FRAME_ROOM / FULL_BUS
        self.gather_s = min(max(filled_s / SPARE, GATHER_S), GATHER_MOST_S)
        groups, received = group_filters(access.any_sender)[:MOST_GROUPS], access.received
        pairs = [(0, 0)] if received is None else join_filters(received, LIMIT - len(groups)) + groups
        self._filters = b"".join(struct.pack("=II", *pair) for pair in pairs)
        if sock is None:
            self._sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, ERROR_MASK)
            self._sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)
            self._sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            self._bind()

    @classmethod
    def over(cls, sock: socket.socket, access: Access = LISTEN, *, receive_buffer: int = RECEIVE_BUFFER) -> Self:
        """Make a port above a datagram socket, for hosts without CAN."""
        return cls("socketpair", access, receive_buffer=receive_buffer, sock=sock)

    def fileno(self) -> int:
        """Descriptor of the socket; the same for the port's whole life."""
        return self._sock.fileno()

    def now_ns(self) -> int:
        """Bus time."""
        now = self.clock.now_ns()
        if self.clock.steps != self.counters.clock_steps:
            self.counters.clock_steps = self.clock.steps
            log.warning("wall clock was set by %+.3f s: bus time goes on without it", self.clock.last_step_ns / 1e9)
        return now

    def drain(self) -> FrameBatch:
        """Take the frames that have arrived; faults of the interface raise no exception."""
        parts: list[FrameBatch] = []
        taken, self.emptied = 0, False
        self.clock.begin()
        while not self.emptied and taken < self.drain_most:
            try:
                got = self._receiver.take()
            except OSError as error:
                self._failed(error)
                if error.errno in (errno.ENETDOWN, *_GONE):
                    continue  # told once; what was received before is still there
                self.emptied = True  # emptied as far as possible: no more frames come out
                break
            if got is None:
                self.emptied = True
                break
            taken += len(got.rows)
            time_ns = got.wall_ns
            if not time_ns.all():
                time_ns[time_ns == 0] = self.clock.now_ns() - self.clock.offset_ns
            batch, errors = to_batch(got.rows, got.sizes, time_ns, self.counters)
            self._note_errors(errors, len(batch))
            if got.drops is not None:
                self._note_drops(got.drops)
            parts.append(batch)
            self.emptied = len(got.rows) < DEPTH  # the call ended because nothing was left
        if not parts:
            return FrameBatch.empty()
        frames = parts[0] if len(parts) == 1 else FrameBatch.concat(parts)
        # all at once: after a stall the frames of the last part are as old as those of the first
        time_ns = self.clock.to_bus(frames.time_ns, emptied=self.emptied)
        self.counters.misdated = self.clock.misdated
        return self._impostors.refuse(FrameBatch(time_ns, frames.can_id, frames.length, frames.data))

    def send(self, frames: FrameBatch) -> None:
        """Queue frames of our node and send what the rate allows.

        Raises
        ------
        UsageError
            A frame has an id that is not ours.
        """
        self._pacer.offer(frames)

    def pump(self) -> float | None:
        """Reconnect and send as due; return the seconds until the next call is needed, None if nothing waits."""
        if self.link in (Link.DOWN, Link.ABSENT):
            wait = self._retry_at - time.monotonic()
            if wait > 0:
                return wait
            if not self._reconnect():
                return self._delay_s
        now_ns = self.now_ns()
        while (wire := self._pacer.head(now_ns)) is not None:
            try:
                self.put(wire)
            except OSError as error:
                if error.errno in _FULL:
                    return FULL_S
                self._failed(error)
                return self._delay_s
            self._pacer.done()
        return PACE_S if len(self._pacer) else None

    def put(self, wire: bytes) -> None:
        """Hand one frame to the kernel without queue and limits: `pump` decides when.

        Raises
        ------
        OSError
            As of the socket.
        """
        self._sock.send(wire)

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()

    def _ask_buffer(self, size: int) -> int:
        """Request a receive buffer, beyond the system's limit if permitted; return the size that was granted."""
        try:
            self._sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, size)
        except PermissionError:
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size)
        got = self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2  # the kernel doubles what it grants
        if got < size:
            log.info("receive buffer %d KiB instead of %d: raise net.core.rmem_max", got >> 10, size >> 10)
        return got

    def _bind(self) -> bool:
        try:
            # set each time: the kernel removes the filters together with the interface
            self._sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, self._filters)
            self._sock.bind((self.channel,))
        except OSError as error:
            self._failed(error)
            return False
        if not self._is_up():
            self._failed(OSError(errno.ENETDOWN, "interface is switched off"))
            return False
        return True

    def _is_up(self) -> bool:
        request = struct.pack("16sH14x", self.channel.encode(), 0)
        flags: int = struct.unpack_from("=H", fcntl.ioctl(self._sock, SIOCGIFFLAGS, request), 16)[0]
        return bool(flags & IFF_UP)

    def _reconnect(self) -> bool:
        try:
            bound = self._sock.getsockname()[0] == self.channel
            back = self._is_up() if bound else self._bind()
        except OSError as error:
            self._failed(error)
            return False
        if not back:
            if bound:  # a failed `_bind` has already made the delay longer
                self._grow_delay()
            return False
        log.warning("%s is back after %.1f s", self.channel, time.monotonic() - self._down_at)
        self.link = Link.UP
        self._delay_s = 0.0
        return True

    def _failed(self, error: OSError) -> None:
        """Note an outage: the first failure warns, later ones are quiet."""
        before = self.link
        self.link = Link.ABSENT if error.errno in _GONE else Link.DOWN
        if before in (Link.UP, Link.BUS_OFF):
            self.counters.outages += 1
            self._down_at = time.monotonic()
            log.warning("%s is %s (%s): trying again until it is back", self.channel, self.link.value, error.strerror)
        elif before is not self.link:
            log.debug("%s is %s", self.channel, self.link.value)
        self._grow_delay()

    def _grow_delay(self) -> None:
        self._delay_s = min(max(RETRY_FIRST_S, 2 * self._delay_s), RETRY_MOST_S)
        self._retry_at = time.monotonic() + self._delay_s

    def _note_errors(self, errors: list[str], data_frames: int) -> None:
        if self.link is Link.UP and BUS_OFF in errors and RESTARTED not in errors:
            self.link = Link.BUS_OFF
            self.counters.outages += 1
            self._down_at = time.monotonic()
            log.warning("%s: controller is bus-off", self.channel)
        elif self.link is Link.BUS_OFF and (RESTARTED in errors or data_frames):
            self.link = Link.UP
            log.warning("%s: controller is back after %.1f s", self.channel, time.monotonic() - self._down_at)

    def _note_drops(self, drops: int) -> None:
        lost = (drops - self._last_drops) & 0xFFFF_FFFF
        if lost:
            log.warning("%s: %d frames lost in the kernel, read too late", self.channel, lost)
        self._last_drops = drops
        self.counters.dropped += lost


def _raw_socket() -> socket.socket:
    try:
        return socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except (AttributeError, OSError) as error:
        raise BusError(
            f"this system has no SocketCAN ({error}): modprobe can-raw, or set another [bus] interface"
        ) from None
