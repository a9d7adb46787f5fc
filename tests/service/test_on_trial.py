"""The service with a state that ends it: `run` as a whole, process after process, until it lives."""

import asyncio
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bms_gateway.config import load_config
from bms_gateway.service import on_trial
from bms_gateway.service.live import Gateway
from bms_gateway.service.on_trial import prove
from bms_gateway.store import StateStore
from bms_gateway.store.trial import HANG_S, NOTED_MOST
from tests.chaos.bench import config
from tests.service.engine import TICK_NS, TickEngine
from tests.support.live_service import PATIENCE_S, come, run, traffic

RUN = """
import os, socket, sys, time
from bms_gateway.bus.access import Access
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.cli import run
from bms_gateway.cli.main import main
from bms_gateway.engine import Engine
from bms_gateway.service.live import Gateway

ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
run._port = lambda loaded, engine: SocketCanPort.over(ours, Access(own=engine.sends))
how, restore, live = sys.argv[2], Engine.restore, Gateway._live

def restored(engine, state, **more):
    restore(engine, state, **more)
    Engine.next_deadline = {"exception": broken, "abort": lambda _: os.abort(), "hang": lambda _: time.sleep(60)}[how]

def broken(_):
    raise ZeroDivisionError("in a tick")

async def up(gateway, seconds):
    gateway._loop.call_later(0.1, lambda: print("up", flush=True))
    await live(gateway, seconds)

Engine.restore, Gateway._live = restored, up
sys.exit(main(["run", sys.argv[1]]))
"""


def started(file, how):
    return subprocess.Popen(
        [sys.executable, "-c", RUN, file, how], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@pytest.mark.parametrize(
    ("how", "status"), [("exception", 1), ("abort", -signal.SIGABRT), pytest.param("hang", -9, marks=pytest.mark.slow)]
)
@pytest.mark.plain_cases(1)
def test_a_service_that_its_state_ends_lives_without_it_and_says_so(tmp_path, how, status):
    """It was started again with the same state for ever."""
    file = config(tmp_path)
    lib = tmp_path / "lib"
    with file.open("a") as out:
        out.write(f'\n[store]\npath = "{lib}"\nrecent_MB = 0\n[metrics]\nlisten = "off"\n[alerts]\ngrace_s = 1.0\n')
    StateStore(lib).save(load_config(file).engine().snapshot(), wall_ns=1)
    stored = (lib / "state").read_bytes()
    for _ in range(NOTED_MOST):
        process = started(file, how)
        if how == "hang":
            end = time.monotonic() + PATIENCE_S
            notes = lib / "state.trying"
            before = notes.read_text().count("Timeout (") if notes.exists() else 0
            while time.monotonic() < end and not (notes.exists() and notes.read_text().count("Timeout (") > before):
                time.sleep(0.05)
            process.kill()  # as the watchdog does
        process.communicate(timeout=PATIENCE_S)
        assert process.returncode == status
        assert (lib / "state").read_bytes() == stored
    process = started(file, how)
    assert process.stdout.readline() == "up\n"
    assert (lib / "state.crashed").read_bytes() == stored
    most = threading.Timer(PATIENCE_S, process.kill)
    most.start()
    said = ""
    for line in process.stderr:
        said += line
        if "WARNING: " in line:
            process.send_signal(signal.SIGTERM)
    process.communicate()
    most.cancel()
    assert process.returncode == 0
    assert "the service has ended 3 times soon after it was restored: " in said
    assert "no stored state can be used: starting from the model files" in said
    assert "had restored a stored state, which was kept as state.crashed" in said
    assert sorted(os.listdir(lib)) == ["state", "state.crashed"]


class Notes:
    """Stands for a trial."""

    def __init__(self):
        self.told = []

    def alive(self):
        self.told.append("alive")

    def over(self):
        self.told.append("over")


def test_the_trial_is_as_long_as_the_readme_says_and_no_tick_longer(bus):
    text = " ".join((Path(__file__).parents[2] / "deploy" / "README.md").read_text(encoding="utf-8").split())
    assert "A start tries the stored state for the first minute of ticks, or until the first save or a stop." in text
    assert (on_trial.TICKS, on_trial.PERIOD_S, HANG_S) == (60, 1.0, 5.0)
    gateway, notes = Gateway(TickEngine(), bus.port), Notes()
    gateway.tally.ticks = 60
    asyncio.run(prove(gateway, notes))
    assert notes.told == ["over"]


def test_the_trial_ends_after_some_ticks(bus, monkeypatch):
    monkeypatch.setattr(on_trial, "PERIOD_S", 0.01)
    monkeypatch.setattr(on_trial, "TICKS", 5)
    engine, notes = TickEngine(), Notes()
    gateway = Gateway(engine, bus.port)
    ticks, told_at = [], []
    alive = notes.alive
    notes.alive = lambda: (alive(), told_at.append(gateway.tally.ticks))

    async def part():
        await prove(gateway, notes)
        ticks.append(gateway.tally.ticks)

    run(gateway, traffic(bus), part(), until=lambda: ticks)
    assert 5 <= ticks[0] <= 7
    assert set(notes.told[:-1]) == {"alive"}
    assert max(told_at) >= 1  # while ticks are due, too
    assert notes.told[-1] == "over"


def test_the_trial_ends_with_the_first_save_on_a_silent_bus(bus, monkeypatch):
    monkeypatch.setattr(on_trial, "PERIOD_S", 0.01)
    notes, saved = Notes(), []
    gateway = Gateway(TickEngine(), bus.port, save=saved.append)
    gateway.save_every_s = 0.1
    run(gateway, prove(gateway, notes), until=lambda: "over" in notes.told)
    assert notes.told[-1] == "over"
    assert "alive" in notes.told
    assert saved


def test_an_engine_that_does_not_move_is_not_told_to_be_alive(bus, monkeypatch):
    monkeypatch.setattr(on_trial, "PERIOD_S", 0.01)
    engine, notes = TickEngine(), Notes()
    engine.handle_timer = lambda *, now_ns: None
    engine.deadline = bus.port.now_ns() - 30 * TICK_NS
    gateway = Gateway(engine, bus.port)

    async def later():
        await asyncio.sleep(0.3)
        assert notes.told == []
        engine.deadline = None
        await come(lambda: notes.told)

    done = asyncio.Event()

    async def both():
        await later()
        done.set()

    run(gateway, prove(gateway, notes), both(), until=done.is_set)
    assert notes.told
