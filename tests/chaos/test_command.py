"""The command: its table, its JSON, its status, what it refuses; and all of it on a real vcan0."""

import asyncio
import json
import os
import signal
import subprocess
import sys
import time

import pytest

from bms_gateway.chaos import real_time as bench_module
from bms_gateway.chaos.catalogue import Chaos
from bms_gateway.chaos.real_time import BusScenario, RealTimeBench
from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.service import live
from tests.chaos.bench import LONG, config


def test_it_prints_what_was_expected_and_seen_and_writes_it_as_json(tmp_path, capsys):
    words = ["chaos", "--config", str(config(tmp_path)), "--on", "memory", "--scenario", "crc", "--scenario", "down-up"]
    assert main([*words, "--json", str(tmp_path / "a.json")]) == 0
    out = capsys.readouterr().out
    assert "held     crc " in out
    assert "counted as crc after" in out
    assert "skipped  down-up" in out
    assert "1 faults tried, 1 held, 0 failed; 1 skipped" in out
    crc, down = json.loads((tmp_path / "a.json").read_text())["scenarios"]
    assert (down["name"], crc["name"]) == ("down-up", "crc") or (crc["name"], down["name"]) == ("crc", "down-up")
    assert crc["holds"] is True
    assert crc["recovered_s"] < crc["recovers_within_s"]
    assert down["skipped"] == "needs an interface: --on vcan0"


def test_status_is_1_when_one_does_not_hold_and_when_nothing_could_be_tried(tmp_path, monkeypatch, capsys):
    words = ["chaos", "--config", str(config(tmp_path)), "--on", "memory", "--scenario"]
    assert main([*words, "down-up"]) == 1
    monkeypatch.setattr("bms_gateway.engine.inputs.Inputs.changes", lambda self, t1: [])
    assert main([*words, "wrong-dlc"]) == 1
    assert "1 failed: wrong-dlc" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--scenario", "parked-hour"], "did you mean 'parked-hours'"),
        (["--seed", "-1"], "--seed -1: must not be negative"),
        (["--on", "vcan9"], "cannot send on vcan9"),
    ],
)
def test_wrong_words_are_told_in_one_line(tmp_path, capsys, words, line):
    assert main(["chaos", "--config", str(config(tmp_path)), "--on", "memory", *words]) == 2
    err = capsys.readouterr().err
    assert line in err
    assert err.count("\n") == 1


def test_a_gateway_that_only_listens_cannot_be_watched(tmp_path, capsys):
    file = config(tmp_path)
    file.write_text(file.read_text().replace('channel = "vcan0"', 'channel = "vcan0"\ntransmit = false'))
    assert main(["chaos", "--config", str(file), "--on", "memory"]) == 2
    assert "bus.transmit is false" in capsys.readouterr().err


def test_the_list_names_all_and_runs_none(tmp_path, capsys):
    assert main(["chaos", "--config", str(config(tmp_path)), "--on", "memory", "--list"]) == 0
    out = capsys.readouterr().out
    assert "thermocouple-slow" in out
    assert "down-up" in out
    assert "not here: needs an interface" in out


def test_an_interrupt_while_the_disk_hangs_does_not_wait_for_it(tmp_path, monkeypatch):
    """The service waits for its last save; that the disk does not answer is our own doing."""
    monkeypatch.setattr(bench_module, "STEADY_FIRST", 1)
    monkeypatch.setattr(live, "SAVE_LAST_S", 60.0)
    loaded = load_config(config(tmp_path))
    scenario, told = Chaos(loaded.plan, loaded.database).scenarios["disk-hangs"], []

    async def hangs(bench):
        bench.disk.clear()
        while not bench.gateway.tally.saves_failed:
            await asyncio.sleep(0.02)
        told.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.Event().wait()

    with pytest.raises(KeyboardInterrupt):
        RealTimeBench(loaded.plan, loaded.database).run(BusScenario(scenario, hangs))
    assert time.monotonic() - told[0] < 60.0


def test_a_save_that_hung_leaves_the_folder_alone_that_is_removed(tmp_path, monkeypatch):
    """The removal failed when the disk answered only after the last save had been given up."""
    monkeypatch.setattr(bench_module, "STEADY_FIRST", 1)
    monkeypatch.setattr(live, "SAVE_LAST_S", 0.05)
    loaded = load_config(config(tmp_path))
    scenario, written = Chaos(loaded.plan, loaded.database).scenarios["disk-hangs"], []

    def slow(self, state, *, wall_ns):
        for k in range(20):
            written.append(self.directory.exists())
            (self.directory / f"part{k}").touch()
            time.sleep(0.02)

    async def hangs(bench):
        bench.disk.clear()
        while not bench.gateway.tally.saves_failed:
            await asyncio.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)
        await asyncio.Event().wait()

    monkeypatch.setattr(bench_module.StateStore, "save", slow)
    with pytest.raises(KeyboardInterrupt):
        RealTimeBench(loaded.plan, loaded.database).run(BusScenario(scenario, hangs))
    time.sleep(1.0)  # what is written late is written by then
    assert written
    assert all(written)


def test_an_interrupt_while_a_scenario_ends_is_heard(tmp_path, monkeypatch):
    """The service took it for its own end, which had begun, and the next scenario followed."""
    monkeypatch.setattr(bench_module, "STEADY_FIRST", 1)
    monkeypatch.setattr(bench_module, "STEADY", 1)
    loaded = load_config(config(tmp_path))
    scenario, stop = Chaos(loaded.plan, loaded.database).scenarios["impostor"], live.Gateway.stop

    def interrupted(gateway):
        monkeypatch.setattr(live.Gateway, "stop", stop)
        os.kill(os.getpid(), signal.SIGINT)
        asyncio.get_running_loop().call_later(0.5, gateway.stop)

    async def nothing(_bench):
        monkeypatch.setattr(live.Gateway, "stop", interrupted)

    with pytest.raises(KeyboardInterrupt):
        RealTimeBench(loaded.plan, loaded.database).run(BusScenario(scenario, nothing))


@pytest.mark.vcan
def test_every_fault_on_a_real_interface(tmp_path):
    loaded = load_config(config(tmp_path))
    # what takes many minutes of driving is tried inside the process (`test_scenarios`, `test_heat_faults`)
    scenarios = Chaos(loaded.plan, loaded.database, "vcan0").scenarios
    names = [name for name, s in scenarios.items() if name not in LONG and s.kind != "heat"]
    words = ["chaos", "--config", str(config(tmp_path)), "--on", "vcan0", "--json", str(tmp_path / "a.json")]
    words += [word for name in names for word in ("--scenario", name)]
    done = subprocess.run([sys.executable, "-m", "bms_gateway", *words], capture_output=True, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
    outcomes = json.loads((tmp_path / "a.json").read_text())["scenarios"]
    assert len(outcomes) >= 28
    assert [o["name"] for o in outcomes if o["skipped"]] == []


@pytest.mark.vcan
def test_a_bus_with_a_battery_on_it_is_refused(tmp_path, capsys):
    file = config(tmp_path)
    assert main(["simulate", "--config", str(file), "--out", str(tmp_path / "a.log"), "--duration", "60"]) == 0
    with subprocess.Popen(
        [sys.executable, "-m", "bms_gateway", "replay", str(tmp_path / "a.log"), "--to", "vcan0"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    ) as vehicle:
        try:
            status = 0
            for _ in range(30):  # the replay takes its time to start on a slow machine
                status = main(["chaos", "--config", str(file), "--on", "vcan0", "--scenario", "full-load"])
                if status == 2 or vehicle.poll() is not None:
                    break
        finally:
            vehicle.kill()
    assert status == 2
    assert "a battery is on this bus" in capsys.readouterr().err
