"""The SocketCAN port on a real interface: run by `tests/canvm/canvm python -m pytest -m vcan`."""

import errno
import logging
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.access import Access
from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.filters import LIMIT
from bms_gateway.bus.logfile import read_log
from bms_gateway.bus.port import Link
from bms_gateway.bus.replay import SocketCanSender, replay
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.errors import BusError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from tests.bus.frames import make, rows, same

pytestmark = pytest.mark.vcan

SECOND = 1_000_000_000
OWN = {0x10: SECOND}


def ip(*words):
    subprocess.run(["ip", "link", *words], check=True)


opened = []


@pytest.fixture
def vcan():
    yield "vcan0"
    while opened:
        opened.pop().close()
    subprocess.run(["ip", "link", "del", "vcan0"], stderr=subprocess.DEVNULL, check=False)
    subprocess.run("ip link add vcan0 type vcan && ip link set vcan0 up", shell=True, check=True)


def senders(channel):
    sender = SocketCanSender(channel)
    opened.append(sender)
    return sender


@pytest.fixture
def other(vcan):
    return senders(vcan)


def ports(channel, link=Link.UP, **options):
    more = {k: options.pop(k) for k in ("receive_buffer",) if k in options}
    port = SocketCanPort(channel, Access(**options), **more)
    opened.append(port)
    assert port.link is link
    return port


PATIENCE_S = 60.0
"""How long a busy machine may take for what takes a second."""


def candump(channel, path, frames):
    """Start candump for so many frames, and return when the kernel has it listening.

    A slow guest takes its time for that, and what candump asks for by itself holds some 250 frames.
    """
    lists = [p for p in Path("/proc/net/can").iterdir() if p.name.startswith("rcvlist_")]

    def listeners():
        return sum(re.match(rf"\s*{channel}\s", line) is not None for p in lists for line in p.read_text().splitlines())

    before, end = listeners(), time.monotonic() + PATIENCE_S
    with open(path, "w") as out:
        process = subprocess.Popen(["candump", "-L", "-r", str(4 << 20), "-n", str(frames), channel], stdout=out)
    while listeners() == before:
        assert process.poll() is None
        assert time.monotonic() < end, "candump does not listen"
        time.sleep(0.01)
    return process


def pump_until(port, condition, seconds=PATIENCE_S):
    """Do as the service does: drain often, pump when asked."""
    end = time.monotonic() + seconds
    got = []
    while time.monotonic() < end:
        got.append(port.drain())
        port.pump()
        if condition():
            return FrameBatch.concat(got)
        time.sleep(0.01)
    raise AssertionError(f"not within {seconds} s: {port.link}, {port.counters}")


def test_filters_let_the_wanted_ids_through_and_no_others(vcan, other):
    port = ports(vcan, wanted=[0x100, 0x7FF, 0x100 | EXTENDED, 0x1ABCDEF0 | EXTENDED])
    sent = [0x100, 0x101, 0x7FF, 0x100 | EXTENDED, 0x7FF | EXTENDED, 0x1ABCDEF0 | EXTENDED, 0x1ABCDEF1 | EXTENDED]
    other.send(make(*[(0, c, b"1") for c in sent]))
    assert port.drain().can_id.tolist() == [0x100, 0x7FF, 0x100 | EXTENDED, 0x1ABCDEF0 | EXTENDED]
    assert port.counters.errors == {}


def test_more_ids_than_the_kernel_has_filters_are_all_received(vcan, other):
    wanted = [c | EXTENDED for c in range(0x0CFF0000, 0x0CFF0000 + 7 * 3 * LIMIT, 7)]
    port = ports(vcan, wanted=wanted)
    other.send(make(*[(0, c, b"") for c in wanted], (0, 0x123, b""), (0, 0x1CFF0000 | EXTENDED, b"")))
    assert port.drain().can_id.tolist() == wanted


def test_stamps_are_those_that_candump_writes(vcan, other, tmp_path):
    writer = candump(vcan, tmp_path / "dump.log", 300)
    port = ports(vcan)
    parts = []
    for k in range(300):
        other.send(make((0, k | EXTENDED * (k % 2), bytes(range(k % 9)))))
        if k % 37 == 0:
            parts.append(port.drain())
    parts.append(port.drain())
    assert writer.wait(PATIENCE_S) == 0
    logged = FrameBatch.concat(list(read_log(tmp_path / "dump.log")))
    assert len(logged) == 300
    assert same(FrameBatch.concat(parts), logged)
    assert port.counters.clock_steps == 0


def test_remote_frames_and_own_frames_do_not_come_back_but_those_of_others_on_this_host_do(vcan):
    a, b = ports(vcan, own=OWN), ports(vcan)
    a.send(make((a.now_ns(), 0x10, b"x")))
    assert a.pump() is None
    assert len(a.drain()) == 0
    assert [(c, p) for _, c, p in rows(b.drain())] == [(0x10, b"x")]
    subprocess.run(["cansend", vcan, "123#R"], check=True)
    assert len(b.drain()) == 0
    assert b.counters.remote == 1


def raw(vcan):
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    sock.bind((vcan,))
    return sock


def test_error_frames_are_counted_by_class_and_are_never_data(vcan, caplog):
    port = ports(vcan, wanted=[0x4, 0x44])  # the id bits of these error frames, were they taken for data
    with raw(vcan) as sock:
        for can_id in (0x2000_0004, 0x2000_0044, 0x2000_0044):
            sock.send(can_id.to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8))
        with caplog.at_level(logging.WARNING):
            assert len(port.drain()) == 0
        assert port.link is Link.BUS_OFF
        assert port.counters.errors == {"controller": 3, "bus-off": 2}
        assert len(caplog.records) == 1
        sock.send((0x2000_0100).to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8))
    port.drain()
    assert port.link is Link.UP


def test_a_burst_beyond_the_receive_buffer_is_counted_to_the_frame(vcan, other):
    port = ports(vcan, receive_buffer=4_096)
    assert port.receive_buffer < 10_000
    other.send(make(*[(0, k, b"12345678") for k in range(1_000)]))
    first = len(port.drain())
    other.send(make((0, 1, b"")))  # the counter comes with the next frame
    assert len(port.drain()) == 1
    assert 0 < first < 1_000
    assert port.counters.dropped == 1_000 - first


def test_the_receive_buffer_asked_for_holds_two_seconds_of_a_full_bus(vcan, other):
    port = ports(vcan)
    other.send(make(*[(0, k % 2_048, b"12345678") for k in range(17_000)]))
    assert len(port.drain()) == 17_000
    assert port.counters.dropped == 0


def test_switching_the_interface_off_and_on_needs_no_restart(vcan, caplog):
    port = ports(vcan, own=OWN, wanted=[0x100])
    with caplog.at_level(logging.WARNING):
        ip("set", vcan, "down")
        pump_until(port, lambda: port.link is Link.DOWN)
        for _ in range(20):
            port.send(make((port.now_ns(), 0x10, b"")))
            port.pump()
            time.sleep(0.03)
        ip("set", vcan, "up")
        pump_until(port, lambda: port.link is Link.UP)
    sender = senders(vcan)
    sender.send(make((0, 0x100, b"a"), (0, 0x101, b"b")))
    assert port.drain().can_id.tolist() == [0x100]
    assert [r.levelname for r in caplog.records] == ["WARNING", "WARNING"]  # gone, back; nothing in between
    assert port.counters.outages == 1


def test_an_interface_removed_and_made_again_is_bound_again_with_its_filters(vcan):
    port = ports(vcan, own=OWN, wanted=[0x100])
    fileno = port.fileno()
    for _ in range(2):
        ip("del", vcan)
        pump_until(port, lambda: port.link is Link.ABSENT)
        time.sleep(0.5)
        assert port.pump() is not None
        subprocess.run("ip link add vcan0 type vcan; sleep 0.2; ip link set vcan0 up", shell=True, check=True)
        pump_until(port, lambda: port.link is Link.UP)
        sender = senders(vcan)
        sender.send(make((0, 0x100, b"a"), (0, 0x101, b"b")))
        assert port.drain().can_id.tolist() == [0x100]
        port.send(make((port.now_ns(), 0x10, b"x")))
        port.pump()
    assert port.fileno() == fileno
    assert (port.counters.outages, port.counters.sent) == (2, 2)


def test_a_service_started_before_its_interface_waits_for_it(vcan):
    ip("del", vcan)
    port = ports(vcan, Link.ABSENT)
    subprocess.run("ip link add vcan0 type vcan; ip link set vcan0 up", shell=True, check=True)
    pump_until(port, lambda: port.link is Link.UP)
    senders(vcan).send(make((0, 0x100, b"a")))
    assert len(port.drain()) == 1


def test_no_burst_of_old_frames_after_an_outage(vcan):
    cycle = SECOND // 5
    port = ports(vcan, own={0x10: cycle})
    ip("set", vcan, "down")
    pump_until(port, lambda: port.link is Link.DOWN)
    begun = time.monotonic()
    queued = 0
    while time.monotonic() - begun < 1.5:
        port.send(make((port.now_ns(), 0x10, b"")))
        queued += 1
        port.pump()
        time.sleep(0.02)
    ip("set", vcan, "up")
    listener = ports(vcan)
    pump_until(port, lambda: port.link is Link.UP and port.pump() is None)
    assert len(listener.drain()) <= cycle / SECOND / 0.02 + 1
    assert port.counters.stale >= queued - 0.2 / 0.02 - 2


class Full:
    """A socket whose first sends fail as a full queue does."""

    def __init__(self, sock, failures):
        self._sock, self._failures = sock, failures

    def send(self, wire):
        if self._failures:
            raise OSError(self._failures.pop(), "refused")
        return self._sock.send(wire)

    def __getattr__(self, name):
        return getattr(self._sock, name)


def test_enobufs_and_eagain_are_waited_out(vcan):
    port, listener = ports(vcan, own=OWN), ports(vcan)
    port._sock = Full(port._sock, [errno.ENOBUFS, errno.EAGAIN, errno.ENOBUFS])
    port.send(make(*[(port.now_ns(), 0x10, bytes([k])) for k in range(3)]))
    waits = 0
    while port.pump() is not None:
        waits += 1
    assert waits == 3
    assert port.link is Link.UP
    assert listener.drain().data[:, 0].tolist() == [0, 1, 2]


def test_can_fd_frames_are_received_where_the_interface_has_them(vcan):
    ip("set", vcan, "down")
    ip("set", vcan, "mtu", "72")
    ip("set", vcan, "up")
    port = ports(vcan)
    senders(vcan).send(make((0, 0x55, bytes(range(48))), (0, 0x56, b"ab")))
    assert [(c, p) for _, c, p in rows(port.drain())] == [(0x55, bytes(range(48))), (0x56, b"ab")]


def test_frames_of_our_node_from_somebody_else_are_seen_but_not_our_own(vcan, other):
    port, listener = ports(vcan, own=OWN, wanted=[0x100]), ports(vcan)
    port.send(make((port.now_ns(), 0x10, b"ours")))
    port.pump()
    other.send(make((0, 0x10, b"theirs"), (0, 0x100, b"a")))
    assert port.drain().can_id.tolist() == [0x100]
    assert port.counters.impostors == 1
    assert len(listener.drain()) == 3


def test_replay_has_the_timing_of_the_log_without_drift(vcan, other):
    rng = np.random.default_rng(7)
    stamps = 1_700_000_000 * SECOND + np.cumsum(rng.integers(0, 4_000, 2_000)) * 1_000
    frames = make(*[(int(t), 0x100 + k % 50, bytes([k % 256])) for k, t in enumerate(stamps)])
    port = ports(vcan)
    done = replay([frames[k : k + 300] for k in range(0, 2_000, 300)], other)
    got = port.drain()
    assert len(got) == done.frames == 2_000
    late = (got.time_ns - got.time_ns[0]) - (stamps - stamps[0])
    # the punctual ones of the first and of the last: whatever the machine did in between, a pause is caught up with
    early, end = np.min(late[:200]), np.min(late[-200:])
    assert abs(end - early) < 2_000_000  # 2 ms over 4 s; a sum of oversleeping would be a hundred times that
    assert same(FrameBatch(stamps, got.can_id, got.length, got.data), frames)


def test_replay_at_full_speed_loses_nothing(vcan, other):
    port = ports(vcan, receive_buffer=64 << 20)  # for all of them: this is about the sender
    done = replay([make(*[(k * SECOND, 1, b"12345678") for k in range(20_000)])], other, speed=None)
    assert len(port.drain()) == done.frames == 20_000
    assert port.counters.dropped == 0


def test_replay_onto_a_missing_interface_says_what_to_do(vcan):
    with pytest.raises(BusError, match=r"cannot send on vcan9 .*ip link add dev vcan9 type vcan"):
        SocketCanSender("vcan9")
    sender = senders(vcan)
    ip("set", vcan, "down")
    with pytest.raises(BusError, match="Network is down"):
        sender.send(make((0, 1, b"")))


def test_a_wall_clock_set_by_an_hour_leaves_bus_time_alone(vcan, other):
    port = ports(vcan)
    other.send(make((0, 1, b"")))
    first = int(port.drain().time_ns[0])
    begun = time.monotonic_ns()
    try:
        other.send(make((0, 2, b"")))
        time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() + 3600 * SECOND)
        other.send(make((0, 3, b"")))
        got = port.drain()
        now = port.now_ns()
    finally:
        time.clock_settime_ns(time.CLOCK_REALTIME, time.time_ns() - 3600 * SECOND)
    elapsed = time.monotonic_ns() - begun
    assert got.can_id.tolist() == [2, 3]
    assert np.all((got.time_ns >= first) & (got.time_ns <= first + elapsed + 10_000_000))
    assert abs(now - first) < elapsed + 10_000_000
    assert port.counters.clock_steps == 1


def test_wire_layout_is_that_of_can_utils(vcan):
    port = ports(vcan)
    subprocess.run(["cansend", vcan, "1ABCDEF0#0102030405"], check=True)
    got = port.drain()
    assert to_wire(got)[0] == (0x9ABCDEF0).to_bytes(4, sys.byteorder) + bytes([5, 0, 0, 0, 1, 2, 3, 4, 5, 0, 0, 0])
