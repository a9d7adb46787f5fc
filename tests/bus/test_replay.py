"""The rules of a replay: when each frame goes, what is told meanwhile, and what a full or absent bus costs."""

import errno
from types import SimpleNamespace

import pytest

from bms_gateway.bus import replay as module
from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.replay import Played, SocketCanSender, replay
from bms_gateway.errors import BusError, UsageError
from bms_gateway.frames.batch import FrameBatch
from tests.bus.frames import make

S = 1_000_000_000


class Bus:
    """Takes frames at a clock of its own; each takes `cost` seconds."""

    def __init__(self, cost=0.0):
        self.now, self.cost = 50.0, cost
        self.sent, self.slept = [], []

    def clock(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += max(seconds, 1e-7)  # time that is too short for the clock would stand still

    def send(self, frames):
        self.sent.append((round(self.now - 50.0, 6), frames.can_id.tolist()))
        self.now += self.cost * len(frames)


def play(bus, *batches, **options):
    return replay(batches, bus, clock=bus.clock, sleep=bus.sleep, **options)


def frames(*stamps, first=0):
    return make(*[(t, first + k, b"") for k, t in enumerate(stamps)])


def test_each_frame_goes_at_its_time_those_of_one_time_together():
    bus = Bus()
    done = play(bus, frames(7 * S, 7 * S, 8 * S, 10 * S))
    assert bus.sent == [(0.0, [0, 1]), (1.0, [2]), (3.0, [3])]
    assert bus.slept == pytest.approx([1.0, 2.0])
    assert done == Played(4, 3.0, pytest.approx(3.0), pytest.approx(0.0, abs=1e-6))


def test_the_speed_divides_all_times():
    bus = Bus()
    done = play(bus, frames(0, S), frames(3 * S, first=2), speed=2.0)
    assert bus.sent == [(0.0, [0]), (0.5, [1]), (1.5, [2])]
    assert (done.log_s, done.took_s) == (3.0, pytest.approx(1.5))


def test_what_is_late_goes_at_once_with_all_that_is_due_and_the_worst_is_told():
    bus = Bus(cost=1.0)
    done = play(bus, frames(0, S // 2, S, 3 * S + S // 2))
    assert bus.sent == [(0.0, [0]), (1.0, [1, 2]), (3.5, [3])]
    assert done.worst_late_s == pytest.approx(0.5)


def test_a_stamp_that_steps_back_is_due_at_once_also_in_the_next_batch():
    bus = Bus()
    done = play(bus, frames(5 * S, 6 * S, 4 * S), FrameBatch.empty(), frames(2 * S, 7 * S, first=3))
    assert bus.sent == [(0.0, [0]), (1.0, [1, 2]), (1.0, [3]), (2.0, [4])]
    assert done == Played(5, 2.0, pytest.approx(2.0), pytest.approx(0.0, abs=1e-6))


def test_at_full_speed_all_go_in_pieces_and_nothing_is_late():
    bus = Bus(cost=0.001)
    done = play(bus, frames(*range(0, 600 * S, S)), speed=None)
    assert [len(ids) for _, ids in bus.sent] == [256, 256, 88]
    assert bus.slept == []
    assert (done.frames, done.log_s, done.worst_late_s) == (600, 599.0, 0.0)
    assert done.took_s == pytest.approx(0.6)


def test_progress_is_told_ten_times_a_second_and_at_the_end():
    told = []
    play(Bus(), frames(*[k * S * 2 // 25 for k in range(6)]), progress=lambda *now: told.append(now))
    assert told == [(3, 0.16), (5, 0.32), (6, 0.4)]


def test_no_frames_take_no_time():
    told = []
    assert play(Bus(), FrameBatch.empty(), progress=lambda *now: told.append(now)) == Played(0, 0.0, 0.0, 0.0)
    assert told == [(0, 0.0)]


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_none_is_refused(speed):
    with pytest.raises(UsageError, match=rf"^--speed {speed}: must be above 0, or 'max'$"):
        play(Bus(), speed=speed)


# the sender on SocketCAN


class Sock:
    """A CAN socket that fails as it is told to."""

    def __init__(self, *asked):
        self.asked, self.options, self.sent, self.closed = asked, [], [], False
        self.failures = []

    def setsockopt(self, *option):
        self.options.append(option)

    def bind(self, address):
        self.address = address
        if Sock.fails is not None:
            raise Sock.fails

    def send(self, wire):
        if self.failures:
            raise OSError(self.failures.pop(0), "it says why")
        self.sent.append(wire)

    def close(self):
        self.closed = True

    fails = None


@pytest.fixture
def can(monkeypatch):
    """The module's sockets and time."""
    made, now, slept = [], [10.0], []

    def select(*args):
        slept.append(args)
        now[0] += args[3]

    names = {"AF_CAN": 29, "SOCK_RAW": 3, "CAN_RAW": 1, "SOL_CAN_RAW": 101, "CAN_RAW_FILTER": 1, "CAN_RAW_FD_FRAMES": 5}
    opened = SimpleNamespace(socket=lambda *asked: made.append(Sock(*asked)) or made[-1], **names)
    monkeypatch.setattr(module, "socket", opened)
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(module, "select", SimpleNamespace(select=select))
    monkeypatch.setattr(Sock, "fails", None)
    return SimpleNamespace(made=made, now=now, slept=slept, socket=opened)


def test_a_sender_opens_one_socket_that_hears_nothing_and_sends_can_fd_too(can):
    sender = SocketCanSender("can3")
    (sock,) = can.made
    assert (sock.asked, sock.address) == ((29, 3, 1), ("can3",))
    assert sock.options == [(101, 1, b""), (101, 5, 1)]
    both = make((0, 0x12, b"ab"), (0, 0x34, b""))
    sender.send(both)
    assert sock.sent == list(to_wire(both))
    sender.close()
    assert sock.closed


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_full_queue_is_waited_for_a_little_at_a_time(can, number):
    sender = SocketCanSender("can3")
    (sock,) = can.made
    sock.failures = [number] * 3
    sender.send(make((0, 0x12, b"ab")))
    assert can.slept == [([], [], [], 0.001)] * 3
    assert len(sock.sent) == 1


def test_a_bus_that_takes_nothing_for_five_seconds_is_given_up_and_the_wait_is_of_each_frame(can):
    sender = SocketCanSender("can3")
    (sock,) = can.made
    for _ in range(2):
        sock.failures = [errno.ENOBUFS] * 4_000
        sender.send(make((0, 0x12, b"ab")))
    sock.failures = [errno.ENOBUFS] * 6_000
    begun = can.now[0]
    with pytest.raises(BusError, match=r"^can3 takes no frames: is anything else on the bus\?$"):
        sender.send(make((0, 0x12, b"ab")))
    assert can.now[0] - begun == pytest.approx(5.0, abs=0.0015)
    assert len(sock.sent) == 2


def test_a_bus_that_is_gone_is_told_at_once(can):
    sender = SocketCanSender("can3")
    can.made[0].failures = [errno.ENETDOWN]
    with pytest.raises(BusError, match=r"^cannot send on can3: it says why$"):
        sender.send(make((0, 0x12, b"ab")))
    assert can.slept == []


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (
            OSError(errno.ENODEV, "No such device"),
            "No such device): sudo ip link add dev can3 type vcan && sudo ip link",
        ),
        (OSError(errno.EAFNOSUPPORT, "x"), "this system has no SocketCAN (a Linux kernel with CAN)"),
        (AttributeError("x"), "this system has no SocketCAN (a Linux kernel with CAN)"),
    ],
)
def test_what_cannot_be_opened_is_told_and_its_socket_closed(can, monkeypatch, error, told):
    monkeypatch.setattr(Sock, "fails", error)
    with pytest.raises(BusError) as raised:
        SocketCanSender("can3")
    assert str(raised.value).startswith("cannot send on can3")
    assert told in str(raised.value)
    assert can.made[0].closed


def test_a_system_without_can_sockets_is_told(can, monkeypatch):
    monkeypatch.delattr(can.socket, "AF_CAN")
    with pytest.raises(BusError, match="this system has no SocketCAN"):
        SocketCanSender("can3")
    assert can.made == []
