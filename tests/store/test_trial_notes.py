"""What the notes of a trial say to the next start, and what a start writes into them, without any death."""

import json
import os
import time

import pytest

from bms_gateway.errors import GatewayError, StateError
from bms_gateway.store import StateStore, Trial
from bms_gateway.store import trial as module
from bms_gateway.store.trial import HANG_S, MAX_BYTES, NOTED_MOST, SILENT_MOST

DIED = ("loaded", "died: KeyError: 'x'")


def noted(folder, tries, *, boot="one", **head):
    """Write notes; each try is a tuple of lines."""
    lines = [json.dumps({"boot": boot, **head})]
    for lines_of_it in tries:
        lines += ["try", *lines_of_it]
    (folder / "state.trying").write_text("\n".join(lines) + "\n")


def lines_of(folder):
    head, *lines = filter(None, (folder / "state.trying").read_text().splitlines())
    return json.loads(head), lines


def saved(folder):
    store = StateStore(folder)
    for n in (1, 2):
        assert store.save({"generation": n}, wall_ns=n) is None
    return store


def start(folder, error, boot="one", wait_s=0.0):
    """Start on the states of a folder, and end so; the state that was restored, None for none."""
    store = StateStore(folder)
    store.lock()
    trial = Trial(folder, boot)
    found = store.load(lambda state: None, trial)
    with pytest.raises(type(error)):
        end(trial, error, wait_s)
    store.unlock()
    return found.state


def end(trial, error, wait_s):
    with trial.noting():
        time.sleep(wait_s)
        raise error


def aside(folder):
    return sorted(p.name for p in folder.glob("state*crashed*"))


def condemned(folder):
    """Both states of a folder are aside, by ends that have nothing to do with them."""
    saved(folder)
    for _ in range(2 * NOTED_MOST):
        assert start(folder, ValueError("of a library")) is not None
    assert start(folder, ValueError("of a library")) is None
    assert len(aside(folder)) == 2


@pytest.mark.parametrize("between", ["reboot", "stop"])
def test_states_that_are_not_to_blame_come_back_after_a_reboot_and_after_a_stop(tmp_path, between):
    condemned(tmp_path)
    boot = "two" if between == "reboot" else "one"
    if between == "stop":
        assert start(tmp_path, SystemExit(0)) is None
    for _ in range(NOTED_MOST):
        assert start(tmp_path, ValueError("of a library"), boot) is None
    assert start(tmp_path, ValueError("of a library"), boot) is not None
    assert aside(tmp_path) == []


def test_a_state_that_was_to_blame_stays_aside_once_the_service_goes_on(tmp_path):
    condemned(tmp_path)
    trial = Trial(tmp_path, "one")
    assert StateStore(tmp_path).load(lambda state: None, trial).state is None
    with trial.noting():
        trial.over()
    for _ in range(NOTED_MOST + 1):
        assert start(tmp_path, ValueError("another")) is None
    assert len(aside(tmp_path)) == 2


def test_a_bus_that_takes_long_to_fail_does_not_count(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "HANG_S", 0.1)
    saved(tmp_path)
    for _ in range(NOTED_MOST + 1):
        assert start(tmp_path, GatewayError("no bus"), wait_s=0.3) == {"generation": 2}
    assert aside(tmp_path) == []


def test_a_hang_is_noted_before_the_watchdog_ends_it():
    assert HANG_S + 1.0 < 10.0 - 10.0 / 3  # fed up to a third of its time before the hang


@pytest.mark.parametrize(
    ("tries", "why"),
    [
        ([], ""),
        ([DIED] * (NOTED_MOST - 1), ""),
        ([DIED] * NOTED_MOST, "ended 3 times soon after it was restored: KeyError: 'x'"),
        ([DIED, DIED, ("loaded",), ("loaded",), DIED], "ended 3 times"),
        ([DIED, DIED, ("loaded", "Timeout (0:00:05)!", "File", "went on")], ""),
        ([DIED, DIED, ("Timeout (0:00:05)!", "File", "loaded")], ""),
        (
            [DIED, DIED, ("loaded", "went on", "Timeout (0:00:05)!", "File")],
            "3 times soon after it was restored: it hung",
        ),
        (
            [DIED, DIED, ("went on", "loaded", "Fatal Python error: Aborted", "File")],
            "restored: Fatal Python error: Ab",
        ),
        ([()] * (SILENT_MOST - 1), ""),
        ([()] * SILENT_MOST, "gone 5 times in a row while it was restored"),
        ([("loaded",), *[()] * (SILENT_MOST - 1)], ""),
        ([*[()] * SILENT_MOST, ("loaded",)], ""),
    ],
)
def test_what_speaks_against_a_state(tmp_path, tries, why):
    noted(tmp_path, tries, saved_ns=2)
    found = Trial(tmp_path, "one").against(2)
    assert (why in found) if why else found == ""
    assert Trial(tmp_path, "one").against(3) == ""  # another state


def test_the_reason_that_is_told_is_that_of_the_last(tmp_path):
    noted(tmp_path, [DIED, ("loaded",), ("loaded", "died: OSError: y")], saved_ns=2)
    trial = Trial(tmp_path, "one")
    assert trial.against(2) == ""
    assert trial.told == "the service has ended 2 times soon after it was restored: OSError: y"
    assert trial.against(3) == trial.told == ""
    noted(tmp_path, [DIED], saved_ns=2)
    trial = Trial(tmp_path, "one")
    assert trial.against(2) == ""
    assert "ended once soon" in trial.told


@pytest.mark.parametrize(("size", "counts"), [(MAX_BYTES - 1, True), (MAX_BYTES, False)])
def test_notes_that_are_too_long_count_nothing(tmp_path, size, counts):
    noted(tmp_path, [DIED] * NOTED_MOST, saved_ns=2)
    notes = tmp_path / "state.trying"
    notes.write_bytes(notes.read_bytes().ljust(size, b"\n"))
    assert bool(Trial(tmp_path, "one").against(2)) is counts


def test_a_try_is_noted_from_begin_to_end(tmp_path, monkeypatch):
    trial = Trial(tmp_path, "one")
    assert trial.told == ""
    assert trial.against(7) == ""
    trial.begin()
    assert lines_of(tmp_path) == ({"boot": "one", "aside": [], "saved_ns": 7}, ["try"])
    trial.loaded()
    trial.alive()
    assert lines_of(tmp_path)[1] == ["try", "loaded"]
    monkeypatch.setattr(module, "HANG_S", 0.0)
    trial.alive()
    assert lines_of(tmp_path)[1] == ["try", "loaded", "went on"]
    assert (tmp_path / "state.trying").stat().st_mode & 0o777 == 0o640 & ~_umask()
    monkeypatch.undo()
    with pytest.raises(ValueError, match="a\nb"), trial.noting():
        raise ValueError("a\nb" + "c" * 1000)
    noted_last = lines_of(tmp_path)[1][-1]
    assert noted_last.startswith("died: ValueError: a bcc")
    assert len(noted_last) == len("died: ValueError: ") + 300
    assert not trial.noting_now
    trial.alive()
    trial.loaded()
    assert lines_of(tmp_path)[1][-1] == noted_last
    Trial(tmp_path, "one").over()
    assert os.listdir(tmp_path) == []


def test_a_load_that_took_long_is_no_hang_and_is_noted_once(tmp_path):
    trial = Trial(tmp_path, "one")
    trial.against(7)
    trial.begin()
    trial.alive_s -= HANG_S + 1.0
    for call in (trial.loaded, trial.alive):
        call()
        assert lines_of(tmp_path)[1] == ["try", "loaded", "went on"]
    trial.over()


class Faults:
    """Stands for the module `faulthandler`, which the test run needs for itself."""

    def __init__(self, enabled):
        self.file = enabled
        self.armed = []

    def is_enabled(self):
        return self.file is not None

    def enable(self, file):
        self.file = file

    def disable(self):
        self.file = None

    def dump_traceback_later(self, seconds, file):
        self.armed.append((seconds, file))

    def cancel_dump_traceback_later(self):
        self.armed.append(None)


def test_fatal_signals_and_hangs_are_written_into_the_notes_while_the_trial_lasts(tmp_path, monkeypatch):
    faults = Faults(None)
    monkeypatch.setattr(module, "faulthandler", faults)
    trial = Trial(tmp_path, "one")
    trial.against(7)
    trial.alive()
    assert (faults.file, faults.armed) == (None, [])
    trial.begin()
    notes = (HANG_S, trial.handle)
    assert os.fstat(faults.file).st_ino == (tmp_path / "state.trying").stat().st_ino
    assert faults.armed == [notes]
    trial.loaded()
    assert faults.armed == [notes] * 2
    trial.alive()
    assert faults.armed == [notes] * 3
    trial.over()
    assert (faults.file, faults.armed) == (None, [*[notes] * 3, None])
    trial.alive()
    trial.over()
    assert faults.armed == [*[notes] * 3, None]


def test_fatal_signals_that_somebody_else_wants_to_see_are_left_to_them(tmp_path, monkeypatch):
    faults = Faults(2)
    monkeypatch.setattr(module, "faulthandler", faults)
    trial = Trial(tmp_path, "one")
    trial.against(7)
    trial.begin()
    trial.loaded()
    trial.over()
    assert (faults.file, faults.armed) == (2, [])


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


@pytest.mark.parametrize(
    "first", ["[1]", "{}", '{"boot": 1}', '{"boot": "one", "aside": 3}', '{"boot": "one", "aside": [["state"]]}']
)
def test_a_first_line_that_is_no_head_counts_nothing(tmp_path, first):
    (tmp_path / "state.trying").write_text(first + "\ntry\ndied: x" * 5 + "\n")
    trial = Trial(tmp_path, "one")
    assert trial.aside == trial.tries == []


@pytest.mark.parametrize(
    "aside", [["../state", "state.crashed"], ["state", "a/b"], ["state", 1], "ab", ["state", "b", "c"]]
)
def test_a_head_that_names_files_elsewhere_counts_nothing(tmp_path, aside):
    noted(tmp_path, [DIED] * NOTED_MOST, aside=[aside], saved_ns=None)
    trial = Trial(tmp_path, "one")
    assert trial.aside == trial.tries == []
    assert trial.put_back() == []


def test_notes_stay_open_no_longer_than_the_trial(tmp_path):
    before = set(os.listdir("/proc/self/fd"))
    trial = Trial(tmp_path, "one")
    trial.against(1)
    trial.begin()
    assert len(os.listdir("/proc/self/fd")) == len(before) + 1
    trial.over()
    assert set(os.listdir("/proc/self/fd")) == before


def test_an_end_that_was_asked_for_ends_the_trial_unless_it_came_after_a_hang(tmp_path, monkeypatch):
    for hang_s, left in ((5.0, []), (-1.0, ["state.trying"])):
        monkeypatch.setattr(module, "HANG_S", hang_s)
        trial = Trial(tmp_path, "one")
        trial.against(1)
        trial.begin()
        with pytest.raises(KeyboardInterrupt), trial.noting():
            raise KeyboardInterrupt
        assert not trial.noting_now
        assert os.listdir(tmp_path) == left


def test_a_stop_lets_go_of_the_notes_and_keeps_what_was_set_aside(tmp_path):
    noted(tmp_path, [DIED], saved_ns=1, aside=[["state", "state.crashed"]])
    before = set(os.listdir("/proc/self/fd"))
    trial = Trial(tmp_path, "one")
    trial.against(1)
    trial.begin()
    with pytest.raises(KeyboardInterrupt), trial.noting():
        raise KeyboardInterrupt
    assert set(os.listdir("/proc/self/fd")) == before
    assert lines_of(tmp_path) == ({"boot": "one", "aside": [["state", "state.crashed"]], "saved_ns": 1}, [])


def test_a_bus_that_takes_long_to_fail_takes_back_what_was_taken_for_a_hang(tmp_path):
    noted(tmp_path, [DIED] * (NOTED_MOST - 1), saved_ns=1)
    trial = Trial(tmp_path, "one")
    assert trial.against(1) == ""
    trial.begin()
    trial.loaded()
    with (tmp_path / "state.trying").open("a") as notes:
        notes.write("Timeout (0:00:05)!\n")
    trial.alive_s -= HANG_S + 1.0
    with pytest.raises(StateError), trial.noting():
        raise StateError("no such interface")
    assert Trial(tmp_path, "one").against(1) == ""


@pytest.mark.parametrize("saved_ns", [None, 0, 1, 1_700_000_000_000_000_000])
def test_the_tries_of_another_boot_count_against_no_state_and_those_of_this_one_do(tmp_path, saved_ns):
    noted(tmp_path, [DIED] * NOTED_MOST, boot="another", saved_ns=saved_ns)
    for _ in range(NOTED_MOST):
        trial = Trial(tmp_path, "one")
        assert trial.against(saved_ns) == ""
        trial.begin()
        with pytest.raises(ValueError, match="x"), trial.noting():
            raise ValueError("x")
    assert "ended 3 times" in Trial(tmp_path, "one").against(saved_ns)


def test_an_error_for_the_user_is_no_end_by_the_state(tmp_path):
    trial = Trial(tmp_path, "one")
    trial.against(1)
    trial.begin()
    with pytest.raises(StateError), trial.noting():
        raise StateError("no such interface")
    assert not trial.noting_now
    assert lines_of(tmp_path)[1] == ["try"]


def test_a_start_without_notes_restores_and_notes_it(tmp_path):
    store, used = saved(tmp_path), []
    found = store.load(used.append, Trial(tmp_path, "one"))
    assert (found.state, found.saved_ns, found.problems, used) == ({"generation": 2}, 2, (), [{"generation": 2}])
    assert lines_of(tmp_path) == ({"boot": "one", "aside": [], "saved_ns": 2}, ["try", "loaded"])


def test_a_start_with_notes_against_the_newest_takes_the_one_before_and_remembers_where_it_lies(tmp_path):
    store, used = saved(tmp_path), []
    noted(tmp_path, [DIED] * NOTED_MOST, saved_ns=2)
    found = store.load(used.append, Trial(tmp_path, "one"))
    assert (found.state, used) == ({"generation": 1}, [{"generation": 1}])
    assert len(found.problems) == 1
    assert "set aside as state.crashed" in str(found.problems[0])
    assert "had restored a stored state, which was kept as state.crashed" in store.unread
    head = {"boot": "one", "aside": [["state", "state.crashed"]], "saved_ns": 1}
    assert lines_of(tmp_path) == (head, ["try", "loaded"])


def test_a_start_without_the_states_that_were_set_aside_is_on_trial_too(tmp_path):
    store = saved(tmp_path)
    noted(tmp_path, [DIED] * NOTED_MOST, saved_ns=2)
    (tmp_path / "state.previous").unlink()
    assert store.load(None, Trial(tmp_path, "one")).state is None
    head = {"boot": "one", "aside": [["state", "state.crashed"]], "saved_ns": None}
    assert lines_of(tmp_path) == (head, ["try", "loaded"])


def test_a_start_that_finds_none_has_no_trial(tmp_path):
    assert StateStore(tmp_path).load(None, Trial(tmp_path, "one")).state is None
    assert os.listdir(tmp_path) == []


def test_a_state_that_the_engine_refuses_is_not_on_trial_afterwards(tmp_path):
    store = saved(tmp_path)

    def refuse(_):
        raise StateError("too hot")

    assert store.load(refuse, Trial(tmp_path, "one")).state is None
    assert sorted(os.listdir(tmp_path)) == ["state.previous.refused", "state.refused"]


def test_where_it_cannot_be_set_aside_it_is_not_used_and_not_written_over(tmp_path):
    store = saved(tmp_path)
    for name in ("state.crashed", *(f"state.crashed.{k}" for k in range(2, 6))):
        (tmp_path / name).write_text("kept")
    noted(tmp_path, [DIED] * NOTED_MOST, saved_ns=2)
    found = store.load(None, Trial(tmp_path, "one"))
    assert found.state == {"generation": 1}
    assert "5 others are kept as state.crashed*" in str(found.problems[0])
    assert lines_of(tmp_path)[0]["aside"] == []
    assert "not saved" in str(store.save({"generation": 3}, wall_ns=3))
    assert store.look().state == {"generation": 2}


@pytest.mark.parametrize(
    ("saved_ns", "tries", "back"), [(None, NOTED_MOST, True), (None, NOTED_MOST - 1, False), (5, NOTED_MOST, False)]
)
def test_states_are_put_back_after_as_many_ends_without_them(tmp_path, saved_ns, tries, back):
    store = saved(tmp_path)
    (tmp_path / "state.previous").unlink()
    (tmp_path / "state").rename(tmp_path / "state.crashed")
    noted(tmp_path, [DIED] * tries, saved_ns=saved_ns, aside=[["state", "state.crashed"]])
    found = store.load(None, Trial(tmp_path, "one"))
    assert (found.state == {"generation": 2}) is back
    assert (tmp_path / "state.crashed").exists() is not back
    if back:
        assert [str(p).endswith("without a stored state, too") for p in found.problems] == [True]
        assert lines_of(tmp_path) == ({"boot": "one", "aside": [["state", "state.crashed"]], "acquitted": True}, [])
        again = store.load(None, Trial(tmp_path, "one"))
        assert (again.state, again.problems) == ({"generation": 2}, ())
