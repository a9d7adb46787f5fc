"""Sends logged traffic on a bus with its original timing.

Every frame has an absolute deadline relative to the first frame. So delays by the scheduler do not accumulate: after an
hour the replay is as punctual as in its first second.
"""

import errno
import select
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from bms_gateway.bus.canframe import to_wire
from bms_gateway.errors import BusError, UsageError
from bms_gateway.frames.batch import FrameBatch

FULL_S: Final = 0.001  # a full transmit queue has room again after some frames' time
STUCK_S: Final = 5.0  # a bus that takes no frame for so long has no node that acknowledges
SHOW_S: Final = 0.1


class Sender(Protocol):
    """Target of a replay: takes frames of any id, waits while the bus is full."""

    def send(self, frames: FrameBatch) -> None:
        """Send all, now."""
        ...


class SocketCanSender:
    """Sends frames of any id on a SocketCAN interface; for replays and tests, never for our own node.

    Parameters
    ----------
    channel : str

    Raises
    ------
    BusError
        There is no SocketCAN, or no such interface.
    """

    def __init__(self, channel: str) -> None:
        self.channel = channel
        try:
            self._sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self._sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            self._sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            self._sock.bind((channel,))
        except (AttributeError, OSError) as error:
            if hasattr(self, "_sock"):
                self._sock.close()
            if isinstance(error, AttributeError) or error.errno == errno.EAFNOSUPPORT:
                raise BusError(
                    f"cannot send on {channel}: this system has no SocketCAN (a Linux kernel with CAN)"
                ) from None
            raise BusError(
                f"cannot send on {channel} ({error}): sudo ip link add dev {channel} type vcan && "
                f"sudo ip link set {channel} up makes a virtual one"
            ) from None

    def send(self, frames: FrameBatch) -> None:
        """Send all, waiting while the transmit queue is full.

        Raises
        ------
        BusError
            The interface is down or gone, or takes no frames.
        """
        for wire in to_wire(frames):
            self._send_one(wire)

    def _send_one(self, wire: bytes) -> None:
        give_up = 0.0
        while True:
            try:
                self._sock.send(wire)
            except OSError as error:
                if error.errno not in (errno.ENOBUFS, errno.EAGAIN):
                    raise BusError(f"cannot send on {self.channel}: {error.strerror}") from None
            else:
                return
            now = time.monotonic()
            give_up = give_up or now + STUCK_S
            if now > give_up:
                raise BusError(f"{self.channel} takes no frames: is anything else on the bus?")
            select.select([], [], [], FULL_S)

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()


@dataclass(frozen=True, slots=True)
class Played:
    """Result of a replay.

    Attributes
    ----------
    frames : int
    log_s : float
        Time that the frames span in the log.
    took_s : float
        Time that it took.
    worst_late_s : float
        Greatest delay of a frame after its deadline; 0 at full speed.
    """

    frames: int
    log_s: float
    took_s: float
    worst_late_s: float


def replay(
    batches: Iterable[FrameBatch],
    sender: Sender,
    *,
    speed: float | None = 1.0,
    progress: Callable[[int, float], None] | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Played:
    """Send batches with the timing of their stamps.

    Parameters
    ----------
    batches : iterable of FrameBatch
        As of `read_log`.
    sender : Sender
    speed : float or None
        1: as it was; 2: twice as fast; None: as fast as the bus takes it.
    progress : callable, optional
        Called about ten times a second with frames sent and seconds of the log done.
    clock, sleep : callable
        Seconds on a steady line; for tests.

    Returns
    -------
    Played

    Raises
    ------
    UsageError
        The speed is not positive.
    """
    if speed is not None and not speed > 0:
        raise UsageError(f"--speed {speed}: must be above 0, or 'max'")
    begun = clock()
    first_ns: int | None = None
    latest_ns = 0
    sent, worst, shown = 0, 0.0, begun
    for batch in batches:
        if not len(batch):
            continue
        if first_ns is None:
            first_ns = latest_ns = int(batch.time_ns[0])
        # a stamp that steps back is due at once: order is kept
        due = np.maximum.accumulate(np.maximum(batch.time_ns, latest_ns)) - first_ns
        latest_ns = first_ns + int(due[-1])
        seconds = due * (1e-9 / speed) if speed else np.zeros(len(batch))
        at = 0
        while at < len(batch):
            late = clock() - begun - float(seconds[at])
            if late < 0:
                sleep(-late)
                continue
            upto = int(np.searchsorted(seconds, clock() - begun, side="right")) if speed else min(at + 256, len(batch))
            sender.send(batch[at:upto])
            worst = max(worst, late) if speed else 0.0
            sent += upto - at
            at = upto
            if progress is not None and clock() - shown > SHOW_S:
                shown = clock()
                progress(sent, float(due[at - 1]) * 1e-9)
    log_s = (latest_ns - first_ns) / 1e9 if first_ns is not None else 0.0
    if progress is not None:
        progress(sent, log_s)
    return Played(sent, log_s, clock() - begun, worst)
