"""A state that ends the service at every start is set aside; one that is not to blame stays, whoever kills the service.

Each try is a process of its own, which really dies.
"""

import os
import signal
import subprocess
import sys

import pytest

from bms_gateway.store import StateStore, Trial
from bms_gateway.store.trial import HUNG, NOTED_MOST, SILENT_MOST
from tests.support.live_service import PATIENCE_S

BEGIN = """
import ctypes, os, signal, sys, time
from pathlib import Path
from bms_gateway.errors import StateError
from bms_gateway.store import StateStore, Trial, trial as module
module.HANG_S = 0.3
folder, boot, how = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
store, trial = StateStore(folder), Trial(folder, boot)

def use(state):
    print("found", state["generation"], flush=True)
    if how == "killed while it is read":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "exception while it is read":
        raise KeyError("own\\nheat")
    if how == "hang while it is read":
        print("hangs", flush=True)
        time.sleep(60)

found = store.load(use, trial)
if found.state is None:
    print("fresh", flush=True)
if trial.told:
    print("told", trial.told, flush=True)
for problem in found.problems:
    print("problem", problem, flush=True)

def live():
    if found.state is None and "even without" not in how:
        return
    if how.startswith("exception"):
        raise ZeroDivisionError("in a tick")
    if how == "fault of a library":
        ctypes.string_at(0)
    if how == "hang":
        print("hangs", flush=True)
        time.sleep(60)
    if how == "hang that ends":
        time.sleep(0.9)
        trial.alive()
    if how in ("killed", "hang that ends"):
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "error of the bus":
        raise StateError("no such interface")
    if how == "told to end":
        raise KeyboardInterrupt

with trial.noting():
    live()
trial.over()
"""
DEATHS = {
    "exception": "ZeroDivisionError: in a tick",
    "exception while it is read": "KeyError: 'own\\nheat'",
    "fault of a library": "Fatal Python error: Segmentation fault",
    "hang": "it hung for 0.3 s",
    "hang while it is read": "it hung for 0.3 s",
}


def start(folder, how, boot="one"):
    """Start once, and give the lines that were said. What hangs is killed once that has been noted."""
    process = subprocess.Popen(
        [sys.executable, "-c", BEGIN, folder, boot, how], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    said = []
    for line in process.stdout:
        said.append(line.rstrip("\n"))
        if said[-1] == "hangs":
            tries = Trial(folder, boot).tries
            while not tries or not any(HUNG in line for line in tries[-1]):
                tries = Trial(folder, boot).tries
            process.kill()
    process.wait(PATIENCE_S)
    process.stdout.close()
    return said


def two_saves(folder):
    store = StateStore(folder)
    for n in (1, 2):
        assert store.save({"generation": n}, wall_ns=n) is None


def names(folder):
    return sorted(os.listdir(folder))


@pytest.mark.parametrize(("how", "why"), DEATHS.items(), ids=DEATHS)
@pytest.mark.plain_cases(2)
def test_a_state_that_ends_the_service_three_times_is_set_aside_and_then_the_one_before(tmp_path, how, why):
    """The service was started again with it for ever."""
    two_saves(tmp_path)
    newest = (tmp_path / "state").read_bytes()
    for _ in range(NOTED_MOST):
        assert start(tmp_path, how)[0] == "found 2"
    said = start(tmp_path, how)
    assert said[0] == "found 1"
    for _ in range(NOTED_MOST - 1):
        assert start(tmp_path, how)[0] == "found 1"
    last = start(tmp_path, how)
    assert "fresh" in last
    text = " ".join((*said, *last))
    assert f"not used: the service has ended 3 times soon after it was restored: {why}; set aside as " in text
    assert (tmp_path / "state.crashed").read_bytes() == newest
    assert names(tmp_path) == ["state.crashed", "state.previous.crashed"]


def test_each_further_try_says_how_the_ones_before_have_ended(tmp_path):
    two_saves(tmp_path)
    start(tmp_path, "exception")
    start(tmp_path, "killed")
    told = "told the service has ended {} soon after it was restored: ZeroDivisionError: in a tick"
    assert start(tmp_path, "exception")[1] == told.format("once")
    assert start(tmp_path, "exception")[1] == told.format("2 times")


def test_what_is_set_aside_is_told_until_a_person_has_seen_to_it(tmp_path):
    two_saves(tmp_path)
    for _ in range(NOTED_MOST + 1):
        start(tmp_path, "exception")
    (tmp_path / "state.previous").unlink()
    store = StateStore(tmp_path)
    assert store.load(trial=Trial(tmp_path, "another")).state is None
    assert "had restored a stored state, which was kept as state.crashed: report it" in store.unread
    assert store.save({"generation": 3}, wall_ns=3) is None
    assert "kept as state.crashed" in store.unread
    (tmp_path / "state.crashed").unlink()
    assert store.save({"generation": 4}, wall_ns=4) is None
    assert store.unread == ""


@pytest.mark.parametrize("how", ["killed", "error of the bus", "hang that ends", "told to end", "nothing"])
def test_no_kill_from_outside_no_error_of_the_bus_and_no_stop_counts_against_a_state(tmp_path, how):
    two_saves(tmp_path)
    tries = 10 if how == "killed" else SILENT_MOST + 1
    for _ in range(tries):
        assert start(tmp_path, how) == ["found 2"]
    left = ["state.trying"] if how in ("killed", "error of the bus", "hang that ends") else []
    assert names(tmp_path) == ["state", "state.previous", *left]


def test_kills_while_it_is_read_count_only_in_a_long_row(tmp_path):
    two_saves(tmp_path)
    for _ in range(3):
        for _ in range(SILENT_MOST - 1):
            assert start(tmp_path, "killed while it is read") == ["found 2"]
        assert start(tmp_path, "killed") == ["found 2"]
    for _ in range(SILENT_MOST):
        assert start(tmp_path, "killed while it is read") == ["found 2"]
    said = start(tmp_path, "nothing")
    assert said[0] == "found 1"
    assert "gone 5 times in a row while it was restored; set aside as state.crashed" in said[1]


def test_a_power_cut_counts_nothing(tmp_path):
    two_saves(tmp_path)
    for k in range(2 * NOTED_MOST):
        assert start(tmp_path, "exception", boot=f"boot {k}")[0] == "found 2"


def test_a_life_that_went_well_or_was_stopped_makes_good_for_the_ends_before(tmp_path):
    two_saves(tmp_path)
    for how in ("nothing", "told to end"):
        for _ in range(NOTED_MOST - 1):
            start(tmp_path, "exception")
        assert start(tmp_path, how)[0] == "found 2"
        assert names(tmp_path) == ["state", "state.previous"]


def test_a_newer_state_has_tries_of_its_own(tmp_path):
    two_saves(tmp_path)
    for n in (3, 4, 5):
        for _ in range(NOTED_MOST - 1):
            start(tmp_path, "exception")
        assert StateStore(tmp_path).save({"generation": n}, wall_ns=n) is None
    assert start(tmp_path, "nothing") == ["found 5"]


def test_states_are_put_back_where_the_service_ends_without_them_too(tmp_path):
    """What ends it is on the bus, say: then no state is to blame, and none is lost."""
    two_saves(tmp_path)
    before = {name: (tmp_path / name).read_bytes() for name in ("state", "state.previous")}
    said = [start(tmp_path, "exception even without") for _ in range(3 * NOTED_MOST)]
    assert [s[0] for s in said] == ["found 2"] * 3 + ["found 1"] * 3 + ["fresh"] * 3
    for _ in range(2 * NOTED_MOST):
        said.append(start(tmp_path, "exception even without"))
        assert said[-1][0] == "found 2"
    assert "put back: the service ends again and again without a stored state, too" in said[9][1]
    assert {name: (tmp_path / name).read_bytes() for name in ("state", "state.previous")} == before
    assert names(tmp_path) == ["state", "state.previous", "state.trying"]
    assert start(tmp_path, "nothing") == ["found 2"]
    assert names(tmp_path) == ["state", "state.previous"]


def test_a_state_that_a_person_has_moved_is_not_put_back_over_another(tmp_path):
    two_saves(tmp_path)
    for _ in range(3 * NOTED_MOST):
        start(tmp_path, "exception even without")
    (tmp_path / "state").write_bytes((tmp_path / "state.crashed").read_bytes())
    (tmp_path / "state.previous.crashed").unlink()
    assert start(tmp_path, "nothing")[0] == "found 2"
    assert names(tmp_path) == ["state", "state.crashed"]


def test_a_note_that_was_cut_off_takes_no_other_with_it(tmp_path):
    two_saves(tmp_path)
    start(tmp_path, "killed")
    for _ in range(NOTED_MOST):
        assert start(tmp_path, "killed")[0] == "found 2"
        with (tmp_path / "state.trying").open("a") as notes:
            notes.write("Timeout (0:0")  # killed while it was written
    assert start(tmp_path, "killed")[0] == "found 1"


NOTES = {
    "empty": b"",
    "noise": bytes(range(256)) * 9,
    "no head": b"try\ntry\ntry\n",
    "a list": b"[1]\n" + b"try\ndied: x\n" * 4,
    "nested": b"[" * 60_000 + b"\n" + b"try\ndied: x\n" * 4,
    "without a boot": b"{}\n" + b"try\ndied: x\n" * 4,
    "a head for elsewhere": b'{"boot": "one", "aside": [["../state", "../other"]]}\n' + b"try\ndied: x\n" * 4,
    "a pair of one": b'{"boot": "one", "aside": [["state"]]}\n' + b"try\ndied: x\n" * 4,
    "not even a list": b'{"boot": "one", "aside": 3}\n' + b"try\ndied: x\n" * 4,
    "long": b'{"boot": "one", "saved_ns": 2}\n' + b"try\ndied: x\n" * 9_000,
    "words before any try": b'{"boot": "one", "saved_ns": 2}\n' + b"died: x\n" * 4,
}


@pytest.mark.parametrize("content", NOTES.values(), ids=NOTES)
def test_notes_that_are_none_count_nothing(tmp_path, content):
    folder = tmp_path / "lib"
    two_saves(folder)
    (tmp_path / "other").write_text("of somebody else")
    (folder / "state.trying").write_bytes(content)
    assert start(folder, "nothing") == ["found 2"]
    assert names(folder) == ["state", "state.previous"]
    assert names(tmp_path) == ["lib", "other"]


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
def test_what_is_no_file_of_notes_is_not_written_through_and_holds_nothing_up(tmp_path, kind):
    folder = tmp_path / "lib"
    two_saves(folder)
    other, notes = tmp_path / "other", folder / "state.trying"
    other.write_text("of somebody else")
    {"link": lambda: notes.symlink_to(other), "folder": notes.mkdir, "pipe": lambda: os.mkfifo(notes)}[kind]()
    assert start(folder, "killed") == ["found 2"]
    assert start(folder, "nothing") == ["found 2"]
    assert other.read_text() == "of somebody else"


def test_where_nothing_can_be_written_there_is_no_trial(tmp_path):
    trial = Trial(tmp_path / "missing", "one")
    assert trial.against(1) == ""
    trial.begin()
    trial.loaded()
    trial.over()
    assert names(tmp_path) == []


def test_a_process_that_dies_of_a_signal_dies_of_it_all_the_same(tmp_path):
    two_saves(tmp_path)
    done = subprocess.run([sys.executable, "-c", BEGIN, tmp_path, "one", "fault of a library"], capture_output=True)
    assert done.returncode == -signal.SIGSEGV
