"""The shell around a stand-in engine, over a socket pair: everything but the bus and systemd is real."""

import asyncio
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.bus.port import Link
from bms_gateway.engine.events import SendFrames
from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.service import live
from bms_gateway.service.live import Gateway
from bms_gateway.service.turns import DRAIN_S, SETTLE_NS, pause
from tests.bus.frames import make
from tests.service.engine import TICK_NS, TickEngine
from tests.support.live_service import FRAME, PATIENCE_S, come, run, traffic


def test_no_frame_stamped_before_a_deadline_comes_after_its_timer(bus):
    engine = TickEngine()
    run(Gateway(engine, bus.port), traffic(bus), until=lambda: len(engine.ticks) >= 12)
    assert engine.late == []
    deadlines = [d for d, _ in engine.ticks]
    assert len(deadlines) >= 12
    assert np.all(np.diff(deadlines) == TICK_NS)
    assert bus.sent() == deadlines


def test_timers_wait_for_stragglers_and_come_soon_after(bus):
    engine = TickEngine()
    stamps = []
    engine_tick, clock = engine.tick, bus.port.now_ns

    def tick():
        stamps.append(clock() - engine.deadline)
        engine_tick()

    engine.tick = tick

    async def one():
        bus.theirs.send(FRAME)

    soon_ns = SETTLE_NS + 10_000_000  # the quickest of some: a busy machine may keep many of them waiting
    run(Gateway(engine, bus.port), one(), until=lambda: len(stamps) >= 7 and min(stamps) < soon_ns)
    assert len(stamps) >= 7
    assert SETTLE_NS <= min(stamps) < soon_ns


def test_a_silent_bus_costs_no_drains_and_a_full_one_a_hundred_a_second(bus):
    engine = TickEngine(silent=2)
    drains = []
    drain = bus.port.drain
    bus.port.drain = lambda: drains.append(time.monotonic()) or drain()
    run(Gateway(engine, bus.port), seconds=1.0)
    assert len(drains) <= 2
    drains.clear()
    begun = time.monotonic()
    run(Gateway(engine, bus.port), traffic(bus), until=lambda: len(drains) >= 20 and len(engine.pending) >= 30)
    assert 20 <= len(drains) <= 1.2 / DRAIN_S * (time.monotonic() - begun)
    assert sum(n for _, n in engine.ticks) + len(engine.pending) >= len(drains)


def test_frames_gather_as_long_as_the_port_has_room_and_no_deadline_waits_for_them(bus, monkeypatch):
    drains = []
    drain = bus.port.drain
    bus.port.drain = lambda: drains.append(time.monotonic()) or drain()
    monkeypatch.setattr(bus.port, "gather_s", 7 * TICK_NS / 1e9)

    def beyond():
        """How many more drains there were than one for each timer, two for each time that frames gather, and some
        that the start gives cause for."""
        engine, begun = TickEngine(), time.monotonic()
        drains.clear()
        # each tick at its timer: gathered frames alone would close seven at once, and no timer would be left to fire
        run(
            Gateway(engine, bus.port),
            traffic(bus, rate=20),
            until=lambda: sum(what == "timer" for what, _ in engine.calls) >= 10,
        )
        elapsed = time.monotonic() - begun
        assert engine.late == []
        assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)
        return len(drains) - (len(engine.ticks) + 2 * elapsed / bus.port.gather_s + 4)

    # where a busy machine lets a drain come behind its deadline, the next one has one of its own: then once more
    end = time.monotonic() + PATIENCE_S
    while (more := beyond()) > 0:
        assert time.monotonic() < end, more


@settings(deadline=None)
@given(gather_s=st.floats(0.0, 1.0), left_s=st.none() | st.floats(-1.0, 2.0))
def test_frames_gather_no_longer_than_there_is_room_nor_into_the_last_moments_before_a_deadline(gather_s, left_s):
    wait = pause(gather_s, left_s)
    assert 0.0 <= wait <= gather_s
    if left_s is not None and left_s > DRAIN_S:
        assert left_s - wait >= DRAIN_S - 1e-12
    if wait < gather_s:
        assert left_s - wait == pytest.approx(DRAIN_S)


def test_the_engine_is_told_what_the_port_has_lost(bus):
    engine = TickEngine()
    bus.port.counters.dropped = 7
    run(Gateway(engine, bus.port), traffic(bus), until=lambda: engine.dropped)
    assert engine.dropped == 7


def test_the_bus_falls_asleep_and_wakes(bus):
    engine = TickEngine(silent=2)

    async def now_and_then():
        bus.theirs.send(FRAME)
        await come(lambda: engine.ticks and engine.deadline is None)
        assert engine.deadline is None
        bus.theirs.send(FRAME)

    run(
        Gateway(engine, bus.port),
        now_and_then(),
        until=lambda: sum(n for _, n in engine.ticks) == 2 and engine.deadline is None,
    )
    assert sum(n for _, n in engine.ticks) == 2
    assert engine.deadline is None


def test_after_its_time_is_over_the_gateway_leaves_the_port_alone(bus, monkeypatch):
    """A drain that was still due would find a closed socket."""
    monkeypatch.setattr(bus.port, "gather_s", 0.05)

    async def beyond():
        await Gateway(TickEngine(), bus.port).run(seconds=0.3)
        drains = []
        bus.port.drain = lambda: drains.append(1) or FrameBatch.empty()
        await asyncio.sleep(0.2)
        return drains

    async def both():
        sending = asyncio.ensure_future(traffic(bus, rate=200, duration=1.0))
        drains = await beyond()
        sending.cancel()
        await asyncio.wait([sending])
        return drains

    assert asyncio.run(both()) == []


def test_every_event_is_seen_in_order_and_what_is_seen_is_what_is_sent(bus):
    seen = []
    engine = TickEngine()
    run(Gateway(engine, bus.port, watch=seen.append), traffic(bus), until=lambda: len(engine.ticks) >= 5)
    assert len(engine.ticks) >= 5
    assert [e.time_ns for e in seen if isinstance(e, SendFrames)] == [d for d, _ in engine.ticks]
    assert all(e.batch.time_ns.tolist() == [e.time_ns] for e in seen)


def test_jobs_run_beside_the_loop_and_come_back_in_it(bus):
    engine = TickEngine()
    names, ahead, end = [], [], time.monotonic() + PATIENCE_S

    def work():
        names.append(threading.current_thread().name)
        ahead.append(len(engine.ticks))
        while len(engine.ticks) < ahead[0] + 2 and time.monotonic() < end:  # ticks go on while it works
            time.sleep(0.005)
        return 42

    async def start():
        bus.theirs.send(FRAME)
        await come(lambda: engine.ticks)
        engine.job(7, work)

    run(Gateway(engine, bus.port), start(), until=lambda: engine.results and len(engine.ticks) >= ahead[0] + 2)
    assert engine.results == {7: 42}
    assert names == ["fits"]
    assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)


def fails():
    raise ZeroDivisionError("in the job")


@pytest.mark.parametrize("where", ["job", "engine"])
def test_a_bug_ends_the_service_loudly_and_saves_nothing(bus, where):
    engine, saved = TickEngine(), []
    if where == "engine":
        engine.handle_timer = lambda *, now_ns: fails()
    else:
        engine.job(1, fails)

    async def one():
        bus.theirs.send(FRAME)

    with pytest.raises(ZeroDivisionError):
        run(Gateway(engine, bus.port, save=saved.append), one(), seconds=5)
    assert saved == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_it_cleanly_with_a_last_snapshot(bus, number):
    engine, saved = TickEngine(), []

    async def end():
        bus.theirs.send(FRAME)
        await come(lambda: engine.ticks)
        os.kill(os.getpid(), number)

    begun = time.monotonic()
    run(Gateway(engine, bus.port, save=saved.append), end())
    assert time.monotonic() - begun < PATIENCE_S
    assert [set(s) for s in saved] == [{"ticks", "clock"}]
    assert saved[0]["ticks"] == len(engine.ticks)


def test_reload_takes_a_new_engine_and_keeps_the_old_one_on_a_wrong_config(bus, caplog):
    old, new = TickEngine(), TickEngine()
    answers = [ConfigError("gateway.toml: wrong"), new]

    async def reload():
        await asyncio.sleep(0.01)
        answer = answers.pop(0)
        if isinstance(answer, ConfigError):
            raise answer
        return answer

    gateway = Gateway(old, bus.port, reload=reload)

    async def hup():
        bus.theirs.send(FRAME)
        await come(lambda: old.ticks)
        os.kill(os.getpid(), signal.SIGHUP)
        refused = len(old.ticks)
        await come(lambda: len(answers) == 1 and len(old.ticks) >= refused + 3)
        assert gateway.engine is old
        os.kill(os.getpid(), signal.SIGHUP)
        await come(lambda: gateway.engine is new)
        assert gateway.engine is new
        bus.theirs.send(FRAME)

    with caplog.at_level(logging.INFO):
        run(gateway, hup(), until=lambda: len(new.ticks) >= 2)
    assert "not reloaded, going on as before: gateway.toml: wrong" in caplog.text
    assert len(old.ticks) >= 4
    assert len(new.ticks) >= 2


class Systemd:
    """The other end of sd_notify."""

    def __init__(self, folder, monkeypatch, watchdog_s):
        self.path = str(folder / "notify")
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.sock.bind(self.path)
        self.sock.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", self.path)
        monkeypatch.setenv("WATCHDOG_USEC", str(int(watchdog_s * 1e6)))
        monkeypatch.delenv("WATCHDOG_PID", raising=False)

    def lines(self):
        found = []
        try:
            while True:
                found += self.sock.recv(4096).decode().split("\n")
        except BlockingIOError:
            return found


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    systemd = Systemd(tmp_path, monkeypatch, 0.3)
    yield systemd
    systemd.sock.close()


def test_systemd_hears_ready_watchdog_and_stopping(bus, systemd):
    begun, lines = time.monotonic(), []
    gateway = Gateway(TickEngine(), bus.port)
    gateway.summary = lambda: "OK"
    run(
        gateway,
        traffic(bus),
        until=lambda: lines.extend(systemd.lines()) or lines.count("WATCHDOG=1") >= 6,
    )
    lines += systemd.lines()
    assert lines[0] == "READY=1"
    assert lines[1].startswith("STATUS=OK; bus up")
    assert 6 <= lines.count("WATCHDOG=1") <= 1 + (time.monotonic() - begun) * live.FEEDS / 0.3
    assert "STOPPING=1" in lines


def test_the_watchdog_is_fed_on_a_silent_bus(bus, systemd):
    lines = []
    run(
        Gateway(TickEngine(), bus.port),
        until=lambda: lines.extend(systemd.lines()) or lines.count("WATCHDOG=1") >= 4,
    )
    assert lines.count("WATCHDOG=1") >= 4


def fed_while_stalled(gateway, systemd, caplog, *tasks):
    """Lines to systemd in the time in which the gateway found itself stalled five times."""
    told = []

    async def stalled():
        await come(lambda: "stalled" in caplog.text)
        systemd.lines()
        before = caplog.text.count("stalled")
        await come(lambda: caplog.text.count("stalled") >= before + 5)
        told.extend([caplog.text.count("stalled") - before, *systemd.lines()])

    run(gateway, *tasks, stalled(), until=lambda: told)
    assert told[0] >= 5
    return told


def test_the_watchdog_is_not_fed_when_the_estimator_stands_still(bus, systemd, monkeypatch, caplog):
    monkeypatch.setattr(live, "OVERDUE_NS", 200_000_000)
    engine = TickEngine()
    engine.handle_timer = lambda *, now_ns: None
    engine.tick = lambda: None
    engine.receive = lambda frames, *, now_ns: setattr(engine, "deadline", int(frames.time_ns[0]))

    async def one():
        bus.theirs.send(FRAME)

    assert "WATCHDOG=1" not in fed_while_stalled(Gateway(engine, bus.port), systemd, caplog, one())


def test_the_watchdog_is_not_fed_when_receiving_stands_still(bus, systemd, caplog):
    gateway = Gateway(TickEngine(silent=0), bus.port)
    gateway.turns.begin = lambda: None  # the drain is lost, nothing waits for frames
    assert "WATCHDOG=1" not in fed_while_stalled(gateway, systemd, caplog)


def test_systemd_hears_ready_only_when_the_bus_is_open_and_what_is_waited_for_before(bus, systemd, monkeypatch):
    monkeypatch.setattr(live, "LOOK_S", 0.02)
    bus.port.link = Link.ABSENT
    bus.port.pump = lambda: 1.0
    before, after = [], []

    async def come_up():
        await come(lambda: before.extend(systemd.lines()) or before.count("STATUS=waiting: bus absent") >= 3)
        os.kill(os.getpid(), signal.SIGHUP)
        await asyncio.sleep(0)
        bus.port.link = Link.UP

    async def reload():
        return TickEngine()

    gateway = Gateway(TickEngine(), bus.port, reload=reload)
    run(gateway, come_up(), until=lambda: after.extend(systemd.lines()) or "READY=1" in after)
    assert "READY=1" not in before
    assert "EXTEND_TIMEOUT_USEC=30000000" in before
    assert after[after.index("READY=1") + 1].startswith("STATUS=bus up")


def test_ports_that_cannot_be_waited_for_are_polled():
    memory = MemoryBus(time.time_ns)
    ours, theirs = memory.port(), memory.port()
    engine = TickEngine()

    async def send():
        for _ in range(50):
            theirs.send(make((0, 0x123, b"12345678")))
            await asyncio.sleep(0.02)

    run(Gateway(engine, ours), send(), until=lambda: sum(n for _, n in engine.ticks) == 50)
    assert sum(n for _, n in engine.ticks) == 50
    assert engine.late == []
    assert len(theirs.drain()) == len(engine.ticks)


def test_notices_are_logged_with_their_string_and_code(bus, caplog):
    engine = TickEngine()
    engine.notice("sensor 3 of string_1 reads as open: check its plug", "sensor")
    with caplog.at_level(logging.INFO):
        run(Gateway(engine, bus.port), until=lambda: "check its plug" in caplog.text)
    record = next(r for r in caplog.records if "check its plug" in r.getMessage())
    assert (record.levelname, record.code) == ("WARNING", "sensor")


def test_the_live_path_does_not_load_python_can():
    code = "import sys, bms_gateway.bus.socketcan, bms_gateway.service.live; print('can' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"
