"""Ctrl-C: one is enough, within a second, with one word, and nothing is left of what was at work."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bms_gateway.config import shipped

ROOT = Path(__file__).resolve().parents[2]
SOON_S = 5.0
"""A second on an idle machine."""
PATIENCE_S = 60.0


def members(group: int) -> list[str]:
    """Processes of a group that are not gone."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has just gone
            continue
        if int(its_group) == group and state != "Z":
            found.append(stat.parent.name)
    return found


def start(words: list[str], folder: Path) -> subprocess.Popen[bytes]:
    # a group of its own, all of which a terminal interrupts. Tests that a shell has put into the background ignore
    # interrupts, and so would what they start
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with (folder / "stderr").open("wb") as err:
            return subprocess.Popen(
                [sys.executable, "-m", "bms_gateway", *words], cwd=ROOT, stderr=err, stdout=err, process_group=0
            )
    finally:
        signal.signal(signal.SIGINT, before)


def gone(group: int) -> None:
    end = time.monotonic() + PATIENCE_S
    while members(group) and time.monotonic() < end:
        time.sleep(0.05)
    assert members(group) == []


def at_work(process: subprocess.Popen[bytes], count: int) -> None:
    """Wait until there are so many processes; the interrupt may then meet them at any point."""
    end = time.monotonic() + PATIENCE_S
    while len(members(process.pid)) < count:
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.02)


def words_of(command: str, folder: Path) -> list[str]:
    config = str(shipped("deploy/example/gateway.toml"))
    if command == "reproduce":
        return ["reproduce", "--jobs", "2", "--json", str(folder / "out.json")]
    if command == "fleet":
        logs = [str(folder / f"{k}.log") for k in range(4)]
        for log in logs:
            assert simulate(config, log) == 0
        return ["fleet", *logs, "--config", config, "--jobs", "2", "--out", str(folder / "fleet")]
    return ["chaos", "--config", config, "--on", "memory", "--json", str(folder / "out.json")]


def simulate(config: str, log: str) -> int:
    words = [sys.executable, "-m", "bms_gateway", "simulate", "--config", config, "--out", log, "--duration", "900"]
    return subprocess.run(words, cwd=ROOT, check=False, stdout=subprocess.DEVNULL).returncode


@pytest.fixture
def heeded():
    """Programs start with the signal that a closed terminal sends, also where the tests run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("heeded")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_command_that_is_told_to_end_leaves_no_part_of_a_result(number, tmp_path):
    """As after Ctrl-C; its status says which signal it was."""
    words = ["simulate", "--config", str(shipped("deploy/example/gateway.toml")), "--duration", "360000"]
    (tmp_path / "a.log").write_text("an older result\n")
    process = start([*words, "--out", str(tmp_path / "a.log")], tmp_path)
    try:
        end = time.monotonic() + PATIENCE_S
        while not list(tmp_path.glob(".a.log.*")) and time.monotonic() < end:
            time.sleep(0.02)
        os.kill(process.pid, number)
        assert process.wait(PATIENCE_S) == -number
        assert sorted(p.name for p in tmp_path.iterdir()) == ["a.log", "stderr"]
        assert (tmp_path / "a.log").read_text() == "an older result\n"
        assert (tmp_path / "stderr").read_text() == ""
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "count", "after_s"),
    [
        *(("reproduce", 4, s) for s in (0.0, 3.0)),  # the program, two workers and what keeps count of them
        *(("fleet", 4, s) for s in (0.0, 1.5)),
        ("chaos", 1, 5.0),
    ],
)
def test_one_interrupt_ends_all(command, count, after_s, tmp_path):
    words = words_of(command, tmp_path)
    (tmp_path / "out.json").write_text("{}")
    process = start(words, tmp_path)
    try:
        at_work(process, count)
        time.sleep(after_s)
        began = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        status = process.wait(PATIENCE_S)
        taken_s = time.monotonic() - began
        told = (tmp_path / "stderr").read_text()
        assert (status, told.splitlines()[-1]) == (130, "bms-gateway: stopped"), told
        assert "Traceback" not in told
        assert taken_s < SOON_S
        gone(process.pid)
        assert (tmp_path / "out.json").read_text() == "{}"
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_the_workers_of_a_killed_program_go_with_it(tmp_path):
    process = start(words_of("reproduce", tmp_path), tmp_path)
    at_work(process, 4)
    time.sleep(3.0)
    process.kill()
    process.wait()
    gone(process.pid)


def test_the_scenarios_are_named_without_anything_else(tmp_path):
    process = start(["chaos", "--list"], tmp_path)
    assert process.wait(PATIENCE_S) == 0
    assert "bus-off" in (tmp_path / "stderr").read_text()
