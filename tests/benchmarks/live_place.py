"""Where the live benchmarks get their frames: vcan0 where there is one, else a datagram socket pair; sent by a process.

A frame file holds `struct can_frame` after `struct can_frame`; the sender repeats it, evenly at a rate or in bursts.
A listener is a process of its own too, which writes down when each frame of ours was put on the bus, by the kernel.
"""

import json
import os
import resource
import socket
import struct
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

from bms_gateway.bus.access import LISTEN

CAN = struct.Struct("=IB3x8s")
ROOM = 4 << 20
SO_TIMESTAMPNS, SO_SNDBUFFORCE = 35, 32

OPEN = """
import json, select, socket, struct, sys, time
def opened(fd, channel, filters):
    if int(fd) >= 0:
        return socket.socket(fileno=int(fd))
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
    sock.bind((channel,))
    return sock
"""
SENDER = (
    OPEN
    + """
sock = opened(sys.argv[1], sys.argv[2], b"")
rate, burst = float(sys.argv[4]), int(sys.argv[5])
raw = open(sys.argv[3], "rb").read()
frames = [raw[i : i + 16] for i in range(0, len(raw), 16)]
print("ready", flush=True)
begun, k = time.monotonic(), 0
while True:
    due = int((time.monotonic() - begun) * rate) // burst * burst
    while k < due:
        try:
            sock.send(frames[k % len(frames)])
        except OSError:
            pass  # the receiver is behind: a bus would not wait either
        k += 1
    time.sleep(burst / rate)
"""
)
LISTENER = (
    OPEN
    + """
ids = json.loads(sys.argv[3])
sock = opened(sys.argv[1], sys.argv[2], b"".join(struct.pack("=II", i, 0xDFFFFFFF) for i in ids))
sock.setsockopt(socket.SOL_SOCKET, 35, 1)
sock.settimeout(0.2)
print("ready", flush=True)
seen = []
while not select.select([sys.stdin], [], [], 0)[0]:
    try:
        data, told, *_ = sock.recvmsg(72, 64)
    except TimeoutError:
        continue
    seconds, nanoseconds = struct.unpack("qq", told[0][2][:16])
    seen.append((seconds * 1_000_000_000 + nanoseconds, int.from_bytes(data[:4], sys.byteorder)))
json.dump(seen, sys.stdout)
"""
)


def channel():
    """The interface to measure on, or None for a socket pair."""
    return "vcan0" if Path("/sys/class/net/vcan0").exists() else None


class Place:
    """A bus with a sender on it, and a listener where one is wanted.

    Parameters
    ----------
    frames : Path
        Frame file.
    rate : float
        Frames per second.
    burst : int
        So many back to back, with pauses that keep the rate.
    hear : iterable of int, optional
        Identifiers whose frames the listener writes down.
    """

    def __init__(self, frames, rate, burst=1, hear=None):
        self.channel = channel()
        self.ours = theirs = None
        if self.channel is None:
            self.ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            theirs.setblocking(burst == 1)
            if os.geteuid() == 0:
                theirs.setsockopt(socket.SOL_SOCKET, SO_SNDBUFFORCE, ROOM)
        fd = -1 if theirs is None else theirs.fileno()
        words = [str(fd), self.channel or "-"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "pass_fds": [fd] if theirs else [], "text": True}
        self._listener = self._sender = None
        if hear is not None:
            code = [sys.executable, "-c", LISTENER, *words, json.dumps(sorted(hear))]
            self._listener = subprocess.Popen(code, **pipes)
            self._listener.stdout.readline()
        code = [sys.executable, "-c", SENDER, *words, str(frames), str(rate), str(burst)]
        self._sender = subprocess.Popen(code, **pipes)
        self._sender.stdout.readline()
        if theirs is not None:
            theirs.close()

    def stop(self):
        """End the processes; gives (stamp in ns, identifier) of each frame heard."""
        self._sender.kill()
        heard = self._listener.communicate("end\n")[0] if self._listener else "[]"
        self._sender.communicate()
        return json.loads(heard)


def cpu():
    """CPU time of this process and of its children that have ended, s."""
    used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


@contextmanager
def long_queues():
    """Let socket pairs queue a drain's worth of frames, where we may; the default of ten holds the sender back."""
    queue = Path("/proc/sys/net/unix/max_dgram_qlen")
    if not os.access(queue, os.W_OK):
        yield
        return
    before = queue.read_text()
    queue.write_text("4000")
    try:
        yield
    finally:
        queue.write_text(before)


def _pair_bus(sock):
    import can
    from can.interfaces.socketcan.socketcan import capture_message

    class PairBus(can.BusABC):
        def __init__(self):
            self.socket = sock
            sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            super().__init__(channel="pair")

        def fileno(self):
            return self.socket.fileno()

        def _recv_internal(self, timeout):
            import select

            ready, _, _ = select.select([self.socket], [], [], timeout)
            return (capture_message(_NoName(self.socket)) if ready else None), False  # filters are ours to apply

        def send(self, msg, timeout=None):
            self.socket.send(CAN.pack(msg.arbitration_id, msg.dlc, bytes(msg.data).ljust(8, b"\0")))

        def shutdown(self):
            super().shutdown()
            self.socket.close()

    class _NoName:
        """A socket pair names no channel: python-can wants one."""

        def __init__(self, inner):
            self._inner = inner

        def recvmsg(self, *sizes):
            data, ancillary, flags, _ = self._inner.recvmsg(*sizes)
            return data, ancillary, flags, ("pair",)

        def __getattr__(self, name):
            return getattr(self._inner, name)

    return PairBus()


def python_can(place, wanted=None):
    """python-can's own SocketCAN bus, or one above the socket pair that parses as it does: `capture_message` is its."""
    import can

    filters = None if wanted is None else [{"can_id": i, "can_mask": 0x7FF} for i in wanted]
    if place.channel is None:
        bus = _pair_bus(place.ours)
        bus.set_filters(filters)
        return bus
    return can.Bus(interface="socketcan", channel=place.channel, can_filters=filters)


def our_port(place, access=LISTEN, **options):
    """Our own port there."""
    from bms_gateway.bus.socketcan import SocketCanPort

    if place.channel is None:
        return SocketCanPort.over(place.ours, access, **options)
    return SocketCanPort(place.channel, access, **options)
