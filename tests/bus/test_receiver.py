"""Reading in bulk gives what reading one by one gives, to the nanosecond; and how long frames may gather."""

import socket
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus import receiver as module
from bms_gateway.bus.canframe import ROW, to_wire
from bms_gateway.bus.impostor import Impostors
from bms_gateway.bus.port import GATHER_S, Counters
from bms_gateway.bus.receiver import DEPTH, Receiver
from bms_gateway.bus.socketcan import FRAME_ROOM, FULL_BUS, GATHER_MOST_S, SPARE, SocketCanPort
from bms_gateway.frames.batch import FrameBatch
from tests.bus.frames import ids, make, rows

SO_PEEK_OFF = 42  # successive peeks walk the queue
STAMP = struct.Struct("@qq")
QUEUE = 10  # what a socket pair holds where nobody has raised the system's limit


@pytest.fixture
def pair():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    yield ours, theirs
    ours.close()
    theirs.close()


def one_by_one(sock, count):
    """Data and stamp of each datagram in the queue, which stay there, as plain `recvmsg` tells them."""
    sock.setsockopt(socket.SOL_SOCKET, SO_PEEK_OFF, 0)
    found = []
    for _ in range(count):
        data, told, *_ = sock.recvmsg(100, 100, socket.MSG_PEEK)
        ((_, _, stamp),) = told
        seconds, nanoseconds = STAMP.unpack(stamp)
        found.append((data, seconds * 1_000_000_000 + nanoseconds))
    return found


@settings(max_examples=60, deadline=None)
@given(st.lists(st.lists(st.binary(min_size=1, max_size=ROW.itemsize), min_size=1, max_size=QUEUE), max_size=4))
def test_in_bulk_or_one_by_one_the_same_bytes_sizes_and_stamps(calls):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    receiver = Receiver(ours)
    for datagrams in calls:
        for datagram in datagrams:
            theirs.send(datagram)
        expected = one_by_one(ours, len(datagrams))
        got = receiver.take()
        assert [d for d, _ in expected] == datagrams
        assert got.sizes.tolist() == list(map(len, datagrams))
        assert [row.tobytes()[:size] for row, size in zip(got.rows, got.sizes, strict=True)] == datagrams
        assert got.wall_ns.tolist() == [stamp // 1_000 * 1_000 for _, stamp in expected]
        assert got.drops is None
    assert receiver.take() is None
    ours.close()
    theirs.close()


@given(size=st.integers(4_096, 16 << 20))
@settings(max_examples=30, deadline=None)
def test_frames_gather_no_longer_than_a_quarter_of_what_the_buffer_holds_of_a_full_bus(size):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    port = SocketCanPort.over(ours, receive_buffer=size)
    assert GATHER_S <= port.gather_s <= GATHER_MOST_S
    if port.gather_s > GATHER_S:
        charged = SPARE * port.gather_s * FULL_BUS * FRAME_ROOM
        assert charged <= ours.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) + 2
    assert port.gather_s * FULL_BUS < DEPTH  # one call is enough
    port.close()
    theirs.close()


@settings(deadline=None)
@given(st.lists(st.tuples(ids, st.binary(max_size=8)), max_size=12), st.sets(ids, max_size=6), st.data())
def test_frames_of_our_identifiers_are_refused_and_no_others(frames, own, data):
    for at in data.draw(st.lists(st.integers(0, max(len(frames) - 1, 0)), max_size=4)):
        if frames and own:
            frames[at] = (data.draw(st.sampled_from(sorted(own))), frames[at][1])
    counters = Counters()
    batch = make(*[(0, c, p) for c, p in frames]) if frames else FrameBatch.empty()
    kept = Impostors("can0", own, counters).refuse(batch)
    assert [(c, p) for _, c, p in rows(kept)] == [(c, p) for c, p in frames if c not in own]
    assert counters.impostors == len(frames) - len(kept)


def test_however_frames_are_cut_into_drains_they_are_the_same(pair):
    ours, theirs = pair
    port = SocketCanPort.over(ours)
    rng = np.random.default_rng(3)
    sent = [(0, int(rng.integers(1, 0x7FF)), rng.bytes(int(rng.integers(0, 9)))) for _ in range(200)]
    wire, got, stamps = to_wire(make(*sent)), [], []
    at = 0
    while at < len(wire):
        many = int(rng.integers(1, QUEUE + 1))
        for one in wire[at : at + many]:
            theirs.send(one)
        stamps += [s // 1_000 * 1_000 for _, s in one_by_one(ours, len(wire[at : at + many]))]
        got.append(port.drain())
        at += many
    whole = FrameBatch.concat(got)
    assert [(c, p) for _, c, p in rows(whole)] == [(c, p) for _, c, p in sent]
    assert whole.time_ns.tolist() == stamps
    assert port.counters.received == len(sent)
    port.close()


def test_what_the_kernel_has_lost_is_told_by_the_frames_after_it():
    """Datagrams over loopback: they have the counter that a CAN socket has, and a pair of sockets has not."""
    ours, theirs = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with ours, theirs:
        ours.bind(("127.0.0.1", 0))
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        receiver, sent, received = Receiver(ours), 0, 0
        for _ in range(3):
            for _ in range(100):
                theirs.sendto(bytes(8), ours.getsockname())
                sent += 1
            while (got := receiver.take()) is not None:
                received += len(got.sizes)
                assert (got.wall_ns > 10**18).all()
        lost = sent - received
        assert lost > 0
        theirs.sendto(bytes(8), ours.getsockname())
        assert receiver.take().drops == lost


def test_a_call_that_has_frames_from_before_and_after_the_first_loss_stamps_all_and_tells_it():
    """The kernel tells the counter with those only that it queued after the loss."""
    ours, theirs = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with ours, theirs:
        ours.bind(("127.0.0.1", 0))
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
        receiver = Receiver(ours)
        for _ in range(100):
            theirs.sendto(bytes(8), ours.getsockname())
        ours.recv(8)
        theirs.sendto(bytes(8), ours.getsockname())
        got = receiver.take()
        assert len(got.sizes) > 1
        assert (got.wall_ns > 10**18).all()
        assert got.drops == 101 - 1 - len(got.sizes)


def test_a_frame_without_a_stamp_has_none_and_takes_none_from_the_others(pair, monkeypatch):
    """As of a kernel that does not stamp; ours always does."""
    ours, theirs = pair
    receiver, real = Receiver(ours), module.recvmmsg

    def unstamped(handle, messages, *others):
        n = real(handle, messages, *others)
        messages[0].header.control_size = 0
        return n

    monkeypatch.setattr(module, "recvmmsg", unstamped)
    for _ in range(3):
        theirs.send(bytes(16))
    stamps = [stamp // 1_000 * 1_000 for _, stamp in one_by_one(ours, 3)]
    got = receiver.take()
    assert got.wall_ns.tolist() == [0, *stamps[1:]]
    assert got.drops is None


def test_a_datagram_longer_than_a_frame_is_cut_and_touches_no_other(pair):
    ours, theirs = pair
    receiver = Receiver(ours)
    sent = [bytes([k]) * 300 for k in range(1, QUEUE)]
    for _ in range(2):  # the second time what the rows had before is seen
        for one in sent:
            theirs.send(one)
        got = receiver.take()
        assert got.sizes.tolist() == [ROW.itemsize] * len(sent)
        assert [row.tobytes() for row in got.rows] == [one[: ROW.itemsize] for one in sent]


def test_a_socket_that_is_gone_is_an_error_of_the_system(pair):
    receiver = Receiver(pair[0])
    pair[0].close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        receiver.take()
