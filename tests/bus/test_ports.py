"""The port above a datagram socket pair, the in-process bus, python-can's virtual bus, replay: no CAN needed."""

import itertools
import logging
import socket
import subprocess
import sys
import time

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.access import Access
from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.bus.port import Link
from bms_gateway.bus.pythoncan import PythonCanPort
from bms_gateway.bus.receiver import DEPTH
from bms_gateway.bus.replay import replay
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.errors import BusError, UsageError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from tests.bus.frames import ids, make, rows

SECOND = 1_000_000_000


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours, Access(own={0x10: SECOND, 0x11 | EXTENDED: SECOND}))
    yield port, theirs
    port.close()
    theirs.close()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(ids, st.binary(max_size=8) | st.binary(min_size=12, max_size=64)), max_size=9))
def test_frames_arrive_as_sent_stamped_to_whole_microseconds_in_order(frames):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours)
    before = time.time_ns()
    for wire in to_wire(make(*[(0, c, p) for c, p in frames])):
        theirs.send(wire)
    got = port.drain()
    assert [(c, p) for _, c, p in rows(got)] == frames
    assert got.data.shape[1] == (64 if any(len(p) > 8 for _, p in frames) else 8)
    assert not (got.time_ns % 1_000).any()
    assert np.all(np.diff(got.time_ns) >= 0)
    assert np.all((got.time_ns >= before - 1_000) & (got.time_ns <= port.now_ns()))
    assert port.counters.received == len(frames)
    port.close()
    theirs.close()


def test_what_lies_beyond_the_length_is_zero_whatever_the_sender_left_there(pair):
    port, theirs = pair
    theirs.send(b"\x01\0\0\0\x02\0\0\0" + b"\xff" * 8)
    assert port.drain().data.tolist() == [[255, 255, 0, 0, 0, 0, 0, 0]]


def test_remote_error_and_malformed_frames_are_counted_and_never_data(pair):
    port, theirs = pair
    for can_id in (0x4000_0001, 0x2000_0004, 0x2000_0008, 0x2000_0201, 0x100):
        theirs.send(can_id.to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8))
    theirs.send(b"short")
    theirs.send((1).to_bytes(4, sys.byteorder) + bytes([9, 0, 0, 0]) + bytes(8))
    assert port.drain().can_id.tolist() == [0x100]
    assert (port.counters.remote, port.counters.malformed) == (1, 2)
    assert port.counters.errors == {"controller": 1, "protocol": 1, "tx-timeout": 1}


def test_bus_off_and_restart_change_the_state_and_count_one_outage(pair):
    port, theirs = pair
    states = []
    for can_id in (0x2000_0040, 0x2000_0040, 0x2000_0100, 0x2000_0040, 0x123):
        theirs.send(can_id.to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8))
        port.drain()
        states.append(port.link)
    assert states == [Link.BUS_OFF, Link.BUS_OFF, Link.UP, Link.BUS_OFF, Link.UP]
    assert port.counters.outages == 2


def test_more_frames_than_one_system_call_takes_come_in_one_drain():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours)
    theirs.setblocking(False)
    sent = 0
    try:
        for wire in itertools.islice(itertools.cycle(to_wire(make((0, 5, b"abc")))), 3 * DEPTH):
            theirs.send(wire)
            sent += 1
    except BlockingIOError:
        pass
    assert len(port.drain()) == sent
    assert len(port.drain()) == 0
    port.close()
    theirs.close()


def test_only_ids_of_our_own_node_are_sent(pair):
    port, theirs = pair
    with pytest.raises(UsageError, match="0x12 is not an identifier"):
        port.send(make((port.now_ns(), 0x12, b"")))
    with pytest.raises(UsageError, match="0x11 is not an identifier"):
        port.send(make((port.now_ns(), 0x11, b"")))
    port.send(make((port.now_ns(), 0x10, b"\x01"), (port.now_ns(), 0x11 | EXTENDED, b"\x02")))
    assert port.pump() is None
    assert theirs.recv(100) == (0x10).to_bytes(4, sys.byteorder) + bytes([1, 0, 0, 0, 1]) + bytes(7)
    assert theirs.recv(100)[:4] == (0x11 | EXTENDED).to_bytes(4, sys.byteorder)


def test_a_full_queue_waits_and_what_got_too_old_is_dropped():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours, Access(own=dict.fromkeys(range(8), 3600 * SECOND) | {0x10: SECOND}))
    sent_before = 0
    while port.counters.sent < 5_000:
        port.send(make(*[(port.now_ns(), k, b"x") for k in range(8)]))
        if port.pump() is not None and port.counters.sent == sent_before:
            break
        sent_before = port.counters.sent
    port.send(make((port.now_ns() - 2 * SECOND, 0x10, b"old")))
    theirs.setblocking(False)
    arrived = []
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and (port.pump() is not None or not arrived or arrived[-1] != b"new"):
        try:
            arrived.append(theirs.recv(100)[8:11])
        except BlockingIOError:
            if len(arrived) > sent_before and port.pump() is None:
                port.send(make((port.now_ns(), 0x10, b"new")))
    assert b"old" not in arrived
    assert arrived[-1] == b"new"
    assert port.counters.stale >= 1
    port.close()
    theirs.close()


def test_frames_of_our_node_from_somebody_else_are_refused_counted_and_told(pair, caplog):
    port, theirs = pair
    for wire in to_wire(make((0, 0x10, b"a"), (0, 0x11, b"b"), (0, 0x11 | EXTENDED, b"c"), (0, 0x10, b"d"))):
        theirs.send(wire)
    with caplog.at_level(logging.WARNING):
        assert [(c, p) for _, c, p in rows(port.drain())] == [(0x11, b"b")]
        assert len(port.drain()) == 0
    assert port.counters.impostors == 3
    (told,) = caplog.records
    assert told.code == "impostor"
    assert "socketpair: another sender uses identifiers of this node (0x10, 3 of them now" in told.getMessage()


def test_who_sends_nothing_has_no_impostors():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours)
    theirs.send(to_wire(make((0, 0x10, b"a")))[0])
    assert len(port.drain()) == 1
    assert port.counters.impostors == 0
    port.close()
    theirs.close()


def test_memory_bus_delivers_to_all_others_and_never_to_the_sender():
    now = itertools.count(100, 10)
    bus = MemoryBus(lambda: next(now))
    a, b, c = bus.port(), bus.port(), bus.port()
    a.send(make((1, 7, b"x")))
    c.send(make((2, 8, b"y")))
    assert len(a.drain()) == 1
    assert rows(b.drain()) == [(100, 7, b"x"), (110, 8, b"y")]
    c.close()
    a.send(make((3, 9, b"")))
    assert rows(c.drain()) == [(100, 7, b"x")]


def test_python_can_interfaces_serve_as_ports():
    port = PythonCanPort("virtual", "test", Access([5, 6 | EXTENDED], own={0x10: SECOND}))
    with can.Bus(interface="virtual", channel="test") as other:
        for can_id, extended in ((5, False), (5, True), (6, False), (6, True), (0x10, False)):
            other.send(can.Message(arbitration_id=can_id, is_extended_id=extended, data=b"ab"))
        other.send(can.Message(arbitration_id=5, is_extended_id=False, is_remote_frame=True))
        got = port.drain()
        assert got.can_id.tolist() == [5, 6 | EXTENDED]
        assert np.all(abs(got.time_ns - time.time_ns()) < 60 * SECOND)
        assert port.counters.impostors == 1
        port.send(make((port.now_ns(), 0x10, b"z")))
        assert port.pump() is None
        message = other.recv(1)
        assert (message.arbitration_id, bytes(message.data), message.is_extended_id) == (0x10, b"z", False)
        with pytest.raises(UsageError, match="not an identifier"):
            port.send(make((port.now_ns(), 0x11, b"z")))
    port.close()


def test_wrong_interfaces_are_refused_with_the_nearest_choice():
    with pytest.raises(UsageError, match="no CAN interface 'vitual'; did you mean 'virtual'"):
        PythonCanPort("vitual", "x")
    with pytest.raises(BusError, match="cannot be opened"):
        PythonCanPort("slcan", "/nonexistent")


def test_the_live_path_does_not_load_python_can():
    code = "import sys, bms_gateway.bus.socketcan, bms_gateway.bus.logfile; print('can' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"


class Tape:
    """A clock that only sleeping moves, and a sender that costs time."""

    def __init__(self, cost=0.0):
        self.now, self.cost, self.sent = 100.0, cost, []

    def clock(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds * 1.01 + 0.0002  # sleeps always last longer than asked

    def send(self, frames):
        self.sent += [(self.now, t) for t in frames.time_ns.tolist()]
        self.now += self.cost * len(frames)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 50_000_000), min_size=1, max_size=200), st.sampled_from([0.5, 1.0, 10.0]))
def test_replay_sends_each_frame_at_its_time_and_nothing_adds_up(gaps, speed):
    stamps = 1_700_000_000 * SECOND + np.cumsum(gaps)
    tape = Tape()
    done = replay(
        [make(*[(t, 1, b"") for t in part]) for part in np.array_split(stamps, 3)],
        tape,
        speed=speed,
        clock=tape.clock,
        sleep=tape.sleep,
    )
    assert [t for _, t in tape.sent] == stamps.tolist()
    late = np.array([now - 100.0 - (t - stamps[0]) * 1e-9 / speed for now, t in tape.sent])
    assert late.min() >= -1e-6
    assert late.max() < 0.002  # one oversleep, not the sum of them
    assert done.frames == len(gaps)


def test_replay_at_full_speed_does_not_sleep_and_tells_its_progress():
    tape, told = Tape(cost=0.001), []
    frames = make(*[(k * SECOND, 1, b"") for k in range(1_000)])
    done = replay([frames, FrameBatch.empty()], tape, speed=None, clock=tape.clock, progress=lambda *a: told.append(a))
    assert (done.frames, done.log_s) == (1_000, 999.0)
    assert done.took_s == pytest.approx(1.0)
    assert told[-1] == (1_000, 999.0)
    with pytest.raises(UsageError, match="above 0"):
        replay([], tape, speed=0.0)


def test_replay_keeps_the_order_of_stamps_that_step_back():
    tape = Tape()
    replay([make((5, 1, b""), (3, 2, b""), (SECOND, 3, b""))], tape, clock=tape.clock, sleep=tape.sleep)
    assert [t for _, t in tape.sent] == [5, 3, SECOND]


@pytest.mark.parametrize(
    "error", [NameError, AttributeError, ImportError, OSError, ValueError, TypeError, can.CanError]
)
def test_whatever_a_driver_fails_with_at_opening_is_a_bus_error(monkeypatch, error):
    def fail(**_):
        raise error("name 'canGetNumberOfChannels' is not defined")

    monkeypatch.setattr(can, "Bus", fail)
    with pytest.raises(BusError, match=r"kvaser 0 cannot be opened: .*canGetNumberOfChannels"):
        PythonCanPort("kvaser", "0")
