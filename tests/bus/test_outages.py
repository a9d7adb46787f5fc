"""What the SocketCAN port does while its interface misbehaves: a raw socket that fails on demand, no CAN needed.

Time is the test's own: nothing waits, and delays are what the port asks for.
"""

import errno
import logging
import socket
import struct
from collections import deque

import numpy as np
import pytest

from bms_gateway.bus import socketcan
from bms_gateway.bus.access import Access
from bms_gateway.bus.canframe import ROW, to_wire
from bms_gateway.bus.port import Link
from bms_gateway.bus.receiver import DEPTH, Received
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.errors import BusError
from bms_gateway.frames.batch import EXTENDED
from tests.bus.frames import make
from tests.bus.times import LATE_S, SECOND, Time

OWN = {0x10: SECOND, 0x11: SECOND}
SO_RCVBUFFORCE, CAN_RAW_ERR_FILTER, SIOCGIFFLAGS = 33, 2, 0x8913  # asm-generic/socket.h, linux/can/raw.h, sockios.h


class Interface(socket.socket):
    """One end of a datagram pair that plays a raw CAN socket on an interface."""

    def play(self):
        self.there = self.up = True
        self.bound, self.refusals, self.options = "", deque(), {}
        self.buffer = 8 << 20
        self.privileged = True

    def setsockopt(self, level, option, value):
        if level == socket.SOL_CAN_RAW:
            self.options[option] = value
        elif option == SO_RCVBUFFORCE and not self.privileged:
            raise PermissionError(errno.EPERM, "not permitted")
        elif option in (SO_RCVBUFFORCE, socket.SO_RCVBUF):
            self.options[option] = value
        else:
            super().setsockopt(level, option, value)

    def getsockopt(self, level, option):
        return self.buffer if option == socket.SO_RCVBUF else super().getsockopt(level, option)

    def bind(self, address):
        if not self.there:
            raise OSError(errno.ENODEV, "No such device")
        self.bound = address[0]

    def getsockname(self):
        return (self.bound,)

    def send(self, wire):
        if self.refusals:
            raise self.refusals.popleft()
        return super().send(wire)

    def flags(self, sock, request, ifreq):
        assert (sock, request) == (self, SIOCGIFFLAGS)
        name, _ = struct.unpack("16sH14x", ifreq)
        assert name.rstrip(b"\0") == b"can7"
        if not self.there:
            raise OSError(errno.ENODEV, "No such device")
        return struct.pack("16sH14x", name, 0x42 | self.up)


@pytest.fixture
def time(monkeypatch):
    time = Time()
    monkeypatch.setattr(socketcan, "time", time)
    return time


@pytest.fixture
def wires(time, monkeypatch):
    """Interface and the far end of the bus."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    ours = Interface(fileno=ours.detach())
    ours.play()
    theirs.setblocking(False)
    monkeypatch.setattr(socketcan, "_raw_socket", lambda: ours)
    monkeypatch.setattr(socketcan.fcntl, "ioctl", ours.flags)
    yield ours, theirs
    ours.close()
    theirs.close()


@pytest.fixture
def interface(wires):
    return wires[0]


@pytest.fixture
def bus(wires):
    return wires[1]


def opened(time, **options):
    """A port with the time of the test; `options` are those of `Access`, and the size of the buffer."""
    more = {k: options.pop(k) for k in ("receive_buffer",) if k in options}
    return SocketCanPort("can7", Access(**{"own": OWN} | options), clock=time.bus_clock(), **more)


def test_a_port_binds_its_interface_with_filters_for_what_it_wants_and_for_its_own_ids(interface, time):
    port = opened(time, wanted=[0x123, 0x5 | EXTENDED])
    assert (port.link, interface.bound) == (Link.UP, "can7")
    filters = interface.options[socket.CAN_RAW_FILTER]
    bases = {base for base, _ in struct.iter_unpack("=II", filters)}
    assert bases == {0x123, 0x5 | EXTENDED, 0x10, 0x11}
    assert interface.options[CAN_RAW_ERR_FILTER] == 0x1FF
    assert interface.options[socket.CAN_RAW_RECV_OWN_MSGS] == 0
    assert interface.options[socket.CAN_RAW_FD_FRAMES] == 1
    assert port.fileno() == interface.fileno()
    assert not interface.getblocking()
    assert interface.options[SO_RCVBUFFORCE] == 8_388_608


def test_a_port_that_wants_all_has_the_filter_that_passes_all(interface, time):
    opened(time)
    assert interface.options[socket.CAN_RAW_FILTER] == struct.pack("=II", 0, 0)


def test_the_receive_buffer_is_what_the_system_grants(interface, time, caplog):
    with caplog.at_level(logging.INFO):
        assert opened(time, receive_buffer=4 << 20).receive_buffer == 4 << 20
    assert interface.options[SO_RCVBUFFORCE] == 4 << 20
    assert not caplog.records
    interface.privileged, interface.buffer = False, 2 * (208 << 10)
    with caplog.at_level(logging.INFO):
        assert opened(time, receive_buffer=4 << 20).receive_buffer == 208 << 10
    assert interface.options[socket.SO_RCVBUF] == 4 << 20
    assert "receive buffer 208 KiB instead of 4096: raise net.core.rmem_max" in caplog.text


def test_an_interface_that_comes_late_is_bound_with_growing_delays_and_told_once(interface, time, caplog):
    interface.there = False
    with caplog.at_level(logging.WARNING):
        port = opened(time)
    assert (port.link, port.counters.outages) == (Link.ABSENT, 1)
    delays = []
    while len(delays) < 7:
        wait = port.pump()
        assert port.pump() == pytest.approx(wait)  # nothing is tried before
        delays.append(wait)
        time.pass_s(wait + LATE_S)
    assert delays == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0])
    interface.there = True
    assert port.pump() is None
    assert (port.link, interface.bound) == (Link.UP, "can7")
    assert socket.CAN_RAW_FILTER in interface.options
    told = [r.getMessage() for r in caplog.records]
    assert told == [
        "can7 is absent (No such device): trying again until it is back",
        f"can7 is back after {sum(delays):.1f} s",
    ]
    assert port.counters.outages == 1


def test_an_interface_that_is_switched_off_is_waited_for_and_the_delay_begins_anew(interface, time, caplog):
    interface.up = False
    port = opened(time)
    assert port.link is Link.DOWN
    first = port.pump()
    time.pass_s(first + LATE_S)
    assert port.pump() == pytest.approx(2 * first)
    interface.up = True
    assert port.pump() == pytest.approx(2 * first)  # not asked before its time
    time.pass_s(2 * first + LATE_S)
    assert port.pump() is None
    assert port.link is Link.UP
    assert "switched off" in caplog.text
    interface.up = False
    interface.refusals.append(OSError(errno.ENETDOWN, "Network is down"))
    port.send(make((port.now_ns(), 0x10, b"")))
    assert port.pump() == pytest.approx(first)
    assert (port.link, port.counters.outages) == (Link.DOWN, 2)


def test_an_interface_that_goes_away_while_it_is_down_is_told_apart(interface, time, caplog):
    interface.up = False
    port = opened(time)
    interface.there = False
    with caplog.at_level(logging.DEBUG, logger="bms_gateway.bus.socketcan"):
        for delay in (0.2, 0.4):
            time.pass_s(1.0)
            assert port.pump() == pytest.approx(delay)
            assert [r.getMessage() for r in caplog.records[1:]] == ["can7 is absent"]  # after the warning, and once
    assert (port.link, port.counters.outages) == (Link.ABSENT, 1)
    interface.there, interface.bound = True, ""  # made anew: bound to nothing, still off
    time.pass_s(1.0)
    port.pump()
    assert (port.link, interface.bound) == (Link.DOWN, "can7")


@pytest.mark.parametrize("full", [errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM])
def test_a_full_transmit_queue_is_no_outage_and_the_frame_goes_later(interface, bus, time, full):
    port = opened(time)
    interface.refusals.append(OSError(full, "full"))
    port.send(make((port.now_ns(), 0x10, b"\x07"), (port.now_ns(), 0x11, b"\x08")))
    assert port.pump() == pytest.approx(0.01)
    assert (port.link, port.counters.outages, port.counters.sent) == (Link.UP, 0, 0)
    assert port.pump() is None
    assert [bus.recv(100)[8] for _ in range(2)] == [7, 8]
    assert port.counters.sent == 2


def test_after_an_outage_the_newest_values_are_sent_not_the_old_ones(interface, bus, time):
    port = opened(time)
    interface.there = interface.up = False
    interface.bound = ""
    interface.refusals.append(OSError(errno.ENXIO, "No such device or address"))
    for k in range(30):
        port.send(make((port.now_ns(), 0x10, bytes([k]))))
        port.pump()
        time.pass_s(1.0)
    assert port.link is Link.ABSENT
    interface.there = interface.up = True
    time.pass_s(5.0)
    port.send(make((port.now_ns(), 0x10, b"\x63")))
    assert port.pump() is None
    assert bus.recv(100)[8] == 0x63
    with pytest.raises(BlockingIOError):
        bus.recv(100)
    assert port.counters.stale == 30


def test_what_the_rate_does_not_allow_yet_is_sent_in_the_rhythm_of_the_bucket(interface, bus, time):
    port = opened(time, own=dict.fromkeys(range(40), 10 * SECOND))
    port.send(make(*[(port.now_ns(), k, b"") for k in range(40)]))
    assert port.pump() == pytest.approx(0.01)
    at_once = port.counters.sent
    assert 0 < at_once < 40
    time.pass_s(0.01)
    assert port.pump() == pytest.approx(0.01)
    assert port.counters.sent == at_once + 10
    time.pass_s(1.0)
    for _ in range(4):
        port.pump()
        time.pass_s(0.01)
    assert (port.pump(), port.counters.sent) == (None, 40)


def test_a_wall_clock_that_is_set_is_counted_and_told_and_bus_time_goes_on(interface, time, caplog):
    port = opened(time)
    before = port.now_ns()
    time.pass_s(1.0)
    time.wall_off_ns += 3600 * SECOND
    assert port.now_ns() == before + SECOND
    assert port.now_ns() == before + SECOND
    assert port.counters.clock_steps == 1
    assert [r.getMessage() for r in caplog.records] == [
        "wall clock was set by +3600.000 s: bus time goes on without it"
    ]


class Script:
    """A `Receiver` that gives what a test lays down, and nothing after it."""

    def __init__(self, *given):
        self.given = deque(given)

    def take(self):
        one = self.given.popleft() if self.given else None
        if isinstance(one, OSError):
            raise one
        return one


def received(time, *frames, stamp_ns=None, drops=None):
    rows = np.zeros(len(frames), ROW)
    rows["can_id"], rows["length"] = frames, 1
    stamps = np.full(len(frames), time.wall_ns() if stamp_ns is None else stamp_ns, np.int64)
    return Received(rows, np.full(len(frames), 16, np.uint32), stamps, drops)


def test_frames_before_and_after_an_interface_went_down_come_in_one_drain(interface, time, monkeypatch):
    down, gone = (OSError(code, "down") for code in (errno.ENETDOWN, errno.ENODEV))
    script = Script(down, received(time, 1), gone)
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    assert port.drain().can_id.tolist() == [1]
    assert (port.link, port.counters.outages) == (Link.DOWN, 1)
    assert len(port.drain()) == 0
    assert (port.link, port.counters.outages) == (Link.ABSENT, 1)


def test_another_failure_of_reading_ends_the_drain(interface, time, monkeypatch):
    script = Script(received(time, *[1] * DEPTH), OSError(errno.EIO, "I/O error"), received(time, 2))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    assert port.drain().can_id.tolist() == [1] * DEPTH
    assert port.link is Link.DOWN
    assert port.drain().can_id.tolist() == [2]


def test_what_two_system_calls_gave_comes_in_one_drain(interface, time, monkeypatch):
    script = Script(received(time, *[1] * DEPTH), received(time, 2, 3))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    assert opened(time).drain().can_id.tolist() == [1] * DEPTH + [2, 3]


def test_a_drain_ends_though_senders_go_on(interface, time, monkeypatch):
    calls = 2 * (4 << 20) // 512 // DEPTH + 1  # more than the buffer, of which the kernel gives twice as much, can hold
    script = Script(*(received(time, *[1] * DEPTH) for _ in range(calls + 1)))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    assert len(port.drain()) == calls * DEPTH
    assert not port.emptied
    assert len(port.drain()) == DEPTH
    assert port.emptied


def test_a_drain_takes_the_last_frame_that_the_buffer_can_hold(interface, time, monkeypatch):
    script = Script(*(received(time, *[1] * DEPTH) for _ in range(3)))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    port.drain_most = DEPTH + 1
    assert len(port.drain()) == 2 * DEPTH


def stalled(time, seconds, rate, *, start_s=0.0):
    """What two or more calls give after so many seconds in which nobody read; and the stamps."""
    begun = time.wall_ns()
    time.pass_s(seconds)
    stamps = begun + (np.arange(start_s, seconds, 1.0 / rate) * 1e9).astype(np.int64)
    cuts = [stamps[k : k + DEPTH] for k in range(0, len(stamps), DEPTH)]
    return stamps, [received(time, *[1] * len(part), stamp_ns=part) for part in cuts]


def test_after_any_stall_frames_keep_the_stamps_of_the_kernel(interface, time, monkeypatch):
    """Within one drain the second part was held against the moment of the first: 375 of 476 frames became "now"."""
    script = Script()
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    for seconds, rate in ((7.5, 200), (30.0, 400), (0.1, 8_500), (600.0, 20)):
        stamps, parts = stalled(time, seconds, rate)
        script.given.extend(parts)
        np.testing.assert_array_equal(port.drain().time_ns, stamps)
    assert port.counters.misdated == 0


def test_a_stall_within_a_drain_costs_no_stamp_of_the_next_one(interface, time, monkeypatch):
    """Frames come while the reader is held up between system call and clock: they are older than the mapping."""
    script = Script()
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    script.given.append(received(time, 1, 1))
    later, to_bus = [], port.clock.to_bus

    def held_up(stamps, **more):
        stamps_of_stall, parts = stalled(time, 30.0, 40)
        later.append(stamps_of_stall)
        script.given.extend(parts)
        port.clock.to_bus = to_bus
        return to_bus(stamps, **more)

    port.clock.to_bus = held_up
    assert len(port.drain()) == 2
    np.testing.assert_array_equal(port.drain().time_ns, later[0])
    assert port.counters.misdated == 0


def test_what_one_drain_leaves_is_not_misdated_in_the_next(interface, time, monkeypatch):
    script = Script()
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    port.drain_most = 3 * DEPTH
    stamps, parts = stalled(time, 40.0, 200)
    script.given.extend(parts)
    found = [port.drain().time_ns]
    assert not port.emptied
    while not port.emptied:
        time.pass_s(0.01)
        found.append(port.drain().time_ns)
    np.testing.assert_array_equal(np.concatenate(found), stamps)
    assert port.counters.misdated == 0


@pytest.mark.parametrize("set_by_s", [3.0, -3.0, 0.5, -0.5, 3600.0, -3600.0])
@pytest.mark.parametrize("at", [0, 1, 700, 1_500, 2_999, 3_000])
def test_a_clock_that_is_set_during_a_stall_moves_no_frame(interface, time, monkeypatch, set_by_s, at):
    """At any of 3,000 frames: three seconds forward looked like a part of the stall to those after it."""
    script = Script()
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    stamps, _ = stalled(time, 30.0, 100, start_s=0.005)
    raw = stamps.copy()
    raw[at:] += round(set_by_s * 1e9)
    time.wall_off_ns += round(set_by_s * 1e9)
    script.given.extend(received(time, *[1] * len(raw[k : k + DEPTH]), stamp_ns=raw[k : k + DEPTH]) for k in
                        range(0, len(raw), DEPTH))  # fmt: skip
    np.testing.assert_array_equal(port.drain().time_ns, stamps)
    assert (port.counters.misdated, port.counters.clock_steps) == (0, 0)
    port.now_ns()
    assert port.counters.clock_steps == 1


def test_frames_that_the_kernel_did_not_stamp_get_the_time_of_their_arrival(interface, time, monkeypatch):
    script = Script(received(time, 1, 2, stamp_ns=0))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    time.pass_s(0.25)
    time.wall_off_ns += 3600 * SECOND
    port.now_ns()
    assert port.drain().time_ns.tolist() == [port.now_ns()] * 2
    assert port.counters.misdated == 0


def test_stamps_that_cannot_be_true_are_counted(interface, time, monkeypatch):
    script = Script(received(time, 1, stamp_ns=5))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    assert port.drain().time_ns.tolist() == [port.now_ns()]
    assert port.counters.misdated == 1


def test_frames_lost_in_the_kernel_are_counted_across_the_end_of_its_counter(interface, time, monkeypatch, caplog):
    script = Script(*(received(time, 1, drops=d) for d in (3, 3, 0xFFFF_FFFF, 1)))
    monkeypatch.setattr(socketcan, "Receiver", lambda _: script)
    port = opened(time)
    for counted in (3, 3, 0xFFFF_FFFF, 0x1_0000_0001):
        port.drain()
        assert port.counters.dropped == counted
    told = [r.getMessage() for r in caplog.records]
    assert told[0] == "can7: 3 frames lost in the kernel, read too late"
    assert told[2] == "can7: 2 frames lost in the kernel, read too late"


def test_a_bus_off_controller_that_goes_away_counts_as_one_more_outage(interface, bus, time, caplog):
    port = opened(time)
    bus.send(struct.pack("=IB3x8x", 0x2000_0040, 8))
    port.drain()
    assert (port.link, port.counters.outages) == (Link.BUS_OFF, 1)
    assert [r.getMessage() for r in caplog.records] == ["can7: controller is bus-off"]
    assert port.pump() is None  # the controller restarts by itself: nothing to bind
    time.pass_s(1.5)
    bus.send(to_wire(make((0, 0x123, b"")))[0])
    port.drain()
    assert port.link is Link.UP
    assert "can7: controller is back after 1.5 s" in caplog.text
    bus.send(struct.pack("=IB3x8x", 0x2000_0140, 8))  # off and restarted in one frame
    port.drain()
    assert (port.link, port.counters.outages) == (Link.UP, 1)
    bus.send(struct.pack("=IB3x8x", 0x2000_0040, 8))
    port.drain()
    interface.refusals.append(OSError(errno.ENODEV, "No such device"))
    port.send(make((port.now_ns(), 0x10, b"")))
    port.pump()
    assert (port.link, port.counters.outages) == (Link.ABSENT, 3)
    port.close()
    assert interface.fileno() == -1


def test_a_system_without_socketcan_is_told_in_one_line(monkeypatch):
    def refuse(*_):
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(socketcan.socket, "socket", refuse)
    with pytest.raises(BusError, match=r"no SocketCAN \(.*not supported.*modprobe can-raw"):
        SocketCanPort("can0")
