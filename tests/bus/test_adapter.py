"""What the python-can port does while its adapter misbehaves: one that fails on demand, and time that is the test's."""

import errno
import logging
from collections import deque

import can
import pytest

from bms_gateway.bus import pythoncan
from bms_gateway.bus.access import Access
from bms_gateway.bus.port import Link
from bms_gateway.bus.pythoncan import PythonCanPort
from bms_gateway.errors import UsageError
from tests.bus.frames import make, rows
from tests.bus.times import LATE_S, SECOND, Time

OWN = {0x10: SECOND, 0x11: SECOND}


@pytest.fixture
def time(monkeypatch):
    time = Time()
    monkeypatch.setattr(pythoncan, "time", time)
    return time


class Adapter:
    """What python-can opens: fails as told, and plays back what was laid down."""

    def __init__(self):
        self.heard, self.said, self.opens, self.shut = deque(), [], 0, 0
        self.opening = self.sending = None

    def __call__(self, interface, channel):
        assert (interface, channel) == ("virtual", "x")
        self.opens += 1
        if self.opening is not None:
            raise self.opening
        return self

    def recv(self, timeout):
        assert timeout == 0
        one = self.heard.popleft() if self.heard else None
        if isinstance(one, Exception):
            raise one
        return one

    def send(self, message, timeout):
        assert timeout == 0
        if self.sending is not None:
            raise self.sending
        self.said.append(message)

    def shutdown(self):
        self.shut += 1


@pytest.fixture
def adapter(monkeypatch):
    adapter = Adapter()
    monkeypatch.setattr(can, "Bus", adapter)
    return adapter


def plugged(time, **options):
    return PythonCanPort("virtual", "x", Access(**{"own": OWN} | options), clock=time.bus_clock())


def message(can_id, timestamp, data=b""):
    return can.Message(arbitration_id=can_id, is_extended_id=False, timestamp=timestamp, data=data)


@pytest.mark.parametrize("failure", [can.CanOperationError("unplugged"), OSError(errno.ENODEV, "unplugged")])
def test_an_adapter_that_is_unplugged_is_opened_again_with_growing_delays(adapter, time, caplog, failure):
    port = plugged(time)
    adapter.heard += [message(1, time.wall_ns() / 1e9), failure]
    assert port.drain().can_id.tolist() == [1]
    assert (port.link, port.counters.outages, adapter.shut) == (Link.ABSENT, 1, 1)
    assert len(port.drain()) == 0
    adapter.opening = OSError("not there")
    delays = []
    with caplog.at_level(logging.DEBUG, logger="bms_gateway.bus.pythoncan"):
        while len(delays) < 7:
            wait = port.pump()
            assert port.pump() == pytest.approx(wait)
            delays.append(wait)
            time.pass_s(wait + LATE_S)
    assert caplog.text.count("virtual x cannot be opened: not there") == 6
    assert delays == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0])
    adapter.opening = None
    assert port.pump() is None
    assert (port.link, port.counters.outages) == (Link.UP, 1)
    assert "virtual x failed" in caplog.text
    assert f"virtual x is back after {sum(delays):.1f} s" in caplog.text
    adapter.heard.append(failure)
    port.drain()
    assert port.pump() == pytest.approx(0.2)  # an outage later the delay begins anew
    port.close()
    assert adapter.shut == 2


def test_an_adapter_that_takes_no_frames_is_told_once_and_gets_them_later(adapter, time, caplog):
    port = plugged(time)
    for _ in range(2):
        adapter.sending = can.CanOperationError("queue full")
        port.send(make((port.now_ns(), 0x10, b"\x01"), (port.now_ns(), 0x11, b"\x02")))
        for _ in range(3):
            assert port.pump() == pytest.approx(0.01)
        adapter.sending = None
        assert port.pump() is None
        time.pass_s(1.0)
    assert [m.data[0] for m in adapter.said] == [1, 2, 1, 2]
    assert [r.getMessage() for r in caplog.records] == ["virtual x takes no frames (queue full)"] * 2
    assert (port.link, port.counters.sent) == (Link.UP, 4)
    port.close()
    assert adapter.shut == 1


def test_an_adapter_is_sent_no_more_than_the_rate_allows(adapter, time):
    port = plugged(time, own=dict.fromkeys(range(40), 10 * SECOND))
    port.send(make(*[(port.now_ns(), k, b"") for k in range(40)]))
    assert port.pump() == pytest.approx(0.01)
    at_once = len(adapter.said)
    assert at_once < 40
    time.pass_s(0.01)
    port.pump()
    assert len(adapter.said) == at_once + 10
    with pytest.raises(UsageError, match="0x99 is not an identifier"):
        port.send(make((0, 0x99, b"")))


def test_stamps_that_count_from_the_drivers_start_are_moved_to_the_wall_clock(adapter, time):
    port = plugged(time)
    adapter.heard += [message(1, 3.0), message(2, 3.0)]
    time.pass_s(1.0)
    now = port.now_ns()
    assert port.drain().time_ns.tolist() == pytest.approx([now, now], abs=2_000)
    assert port.counters.received == 2
    time.pass_s(1.0)
    adapter.heard += [message(1, 3.75), message(1, 4.0)]
    assert port.drain().time_ns.tolist() == pytest.approx([now + 3 * SECOND // 4, now + SECOND], abs=2_000)
    assert port.counters.misdated == 0


def test_stamps_that_are_off_by_less_than_an_hour_are_the_drivers_own(adapter, time):
    port = plugged(time)
    adapter.heard.append(message(1, time.wall_ns() / 1e9 - 0.02))
    assert port.drain().time_ns.tolist() == pytest.approx([time.wall_ns() - SECOND // 50], abs=2_000)
    adapter.heard.append(message(1, time.wall_ns() / 1e9 + 3_600.5))  # true of no frame, but no other clock's either
    assert port.drain().time_ns.tolist() == pytest.approx([port.now_ns()], abs=2_000)
    assert port.counters.misdated == 1


@pytest.mark.parametrize(("off_s", "misdated"), [(3_599.5, 1), (3_600.5, 0)])
def test_a_driver_whose_clock_is_off_by_over_an_hour_counts_from_its_start(adapter, time, off_s, misdated):
    port = plugged(time)
    adapter.heard.append(message(1, time.wall_ns() / 1e9 + off_s))
    assert port.drain().time_ns.tolist() == pytest.approx([port.now_ns()], abs=2_000)
    assert port.counters.misdated == misdated


def test_a_drain_of_an_adapter_ends_though_senders_go_on(adapter, time):
    port = plugged(time)
    adapter.heard += [message(1, time.wall_ns() / 1e9)] * 4_101
    assert len(port.drain()) == 4_096
    assert len(port.drain()) == 5
    assert len(port.drain()) == 0


def test_an_adapter_without_filters_gives_all_but_our_own_and_what_no_bus_carries(adapter, time):
    port = plugged(time)
    now = time.wall_ns() / 1e9
    adapter.heard += [message(1, now, b"ab"), message(0x10, now), message(2, float("nan"))]
    adapter.heard += [can.Message(timestamp=now, is_error_frame=True) for _ in range(2)]
    adapter.heard += [can.Message(timestamp=now, is_remote_frame=True)]
    assert [(c, p) for _, c, p in rows(port.drain())] == [(1, b"ab")]
    counters = port.counters
    assert (counters.impostors, counters.malformed, counters.remote, counters.errors) == (1, 1, 1, {"other": 2})


def test_the_clock_of_an_adapters_port_counts_steps(adapter, time):
    port = plugged(time)
    before = port.now_ns()
    time.wall_off_ns -= 60 * SECOND
    assert port.now_ns() == before
    assert port.counters.clock_steps == 1
    assert port.fileno() == -1
