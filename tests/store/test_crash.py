"""A cut of power between any two system calls of saving leaves the old or the new generation, whole."""

import json
import os
import random
import re
import shutil
import signal
import stat
import subprocess
import sys
import time

import pytest

from bms_gateway.store import StateStore
from tests.store.disk import Recorder, build

FILL = "0123456789abcdef" * 700  # over two pages


def old(n):
    return {"generation": n, "fill": FILL}


def first_start(folder):
    return 0


def two_saves(folder):
    store = StateStore(folder / "lib" / "gateway")
    for n in (-1, 0):
        assert store.save(old(n), wall_ns=n) is None
    return 0


def spoilt_newest(folder):
    two_saves(folder)
    state = folder / "lib" / "gateway" / "state"
    state.write_bytes(state.read_bytes()[:-100])
    return -1


def spoilt_before(folder):
    two_saves(folder)
    (folder / "lib" / "gateway" / "state.previous").write_bytes(b"")
    return 0


def only_previous(folder):
    two_saves(folder)
    (folder / "lib" / "gateway" / "state").unlink()
    return -1


def stale_new(folder):
    two_saves(folder)
    (folder / "lib" / "gateway" / "state.new").write_bytes(b"bms-gateway-state 1 0" + bytes(9000))
    return 0


def all_spoilt(folder):
    two_saves(folder)
    for name in ("state", "state.previous", "state.corrupt", "state.previous.corrupt", "state.new"):
        (folder / "lib" / "gateway" / name).write_bytes(b"\0" * 5000)


STARTS = [first_start, two_saves, spoilt_newest, spoilt_before, only_previous, stale_new, all_spoilt]


def recorded(folder, saves=3, load_first=True):
    """Run a start and some saves under the recorder; calls, and after each the newest generation known to be safe."""
    recorder = Recorder(folder)
    safe = []
    with recorder.watching():
        store = StateStore(folder / "lib" / "gateway")
        if load_first:
            store.load()
        safe += [0] * (len(recorder.after) - len(safe))
        for n in range(1, saves + 1):
            assert store.save(old(n), wall_ns=n) is None
            safe += [n - 1] * (len(recorder.after) - len(safe) - 1) + [n]
    return recorder, safe


def generation(folder):
    """What a start finds: its generation, None for nothing; anything else is garbage."""
    found = StateStore(folder / "lib" / "gateway").load().state
    if found is None:
        return None
    assert found == old(found["generation"])
    return found["generation"]


@pytest.mark.parametrize("load_first", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["loaded", "unread"])
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.plain_cases(3)
def test_every_cut_leaves_the_old_or_the_new_generation(tmp_path, start, load_first):
    before = start(tmp_path / "disk") if start is not first_start else (tmp_path / "disk").mkdir()
    recorder, safe = recorded(tmp_path / "disk", load_first=load_first)
    assert safe[-1] == 3
    points, seen, wrong = cut_everywhere(recorder, safe, before, tmp_path / "cut")
    assert wrong == []
    print(f"{start.__name__}: {len(recorder.calls)} calls, {points} crash points, {len(seen)} directories")
    assert points > 200


def cut_everywhere(recorder, safe, before, folder):
    """Load what every cut leaves: how many cuts, the different directories, the first that is neither old nor new."""
    points, seen, wrong = 0, {}, []
    for (call, disk), newest in zip(recorder.after, safe, strict=True):
        for state in disk.states(reordered=True):
            points += 1
            key = tuple(sorted(state.items()))
            if key not in seen:
                build(state, folder)
                seen[key] = generation(folder)
                # whatever was left, the next save works and is found
                assert StateStore(folder / "lib" / "gateway").save(old(9), wall_ns=9) is None
                assert generation(folder) == 9
                shutil.rmtree(folder)
            if seen[key] not in (newest or before, newest + 1):
                wrong.append((call, seen[key], [(n, c and len(c)) for n, c in state.items()]))
                return points, seen, wrong
    return points, seen, wrong


@pytest.mark.parametrize("unsynced", ["files", "directories"])
def test_a_save_that_does_not_sync_would_be_found_out(tmp_path, monkeypatch, unsynced):
    two_saves(tmp_path / "disk")
    sync = os.fsync
    forgotten = stat.S_ISREG if unsynced == "files" else stat.S_ISDIR
    monkeypatch.setattr(os, "fsync", lambda handle: None if forgotten(os.fstat(handle).st_mode) else sync(handle))
    # the recorder must not see what did not happen
    monkeypatch.setattr(Recorder, "fsync", lambda self, h: None if forgotten(os.fstat(h).st_mode) else FSYNC(self, h))
    recorder, safe = recorded(tmp_path / "disk")
    assert cut_everywhere(recorder, safe, 0, tmp_path / "cut")[2]


FSYNC = Recorder.fsync


@pytest.mark.slow
def test_a_cut_while_recovering_from_a_cut(tmp_path):
    """Every directory that a cut leaves is started from again, and cut again at every call."""
    (tmp_path / "disk").mkdir()
    recorder, _ = recorded(tmp_path / "disk", saves=2)
    firsts = {tuple(sorted(s.items())): s for _, d in recorder.after for s in d.states(sector=8192)}
    points = 0
    for state in firsts.values():
        shutil.rmtree(tmp_path / "again", ignore_errors=True)
        build(state, tmp_path / "again")
        build(state, tmp_path / "probe")
        before = generation(tmp_path / "probe")
        shutil.rmtree(tmp_path / "probe")
        second = Recorder(tmp_path / "again")
        with second.watching():
            store = StateStore(tmp_path / "again" / "lib" / "gateway")
            store.load()
            assert store.save(old(7), wall_ns=7) is None
        for k, (call, disk) in enumerate(second.after):
            for cut in disk.states(sector=8192):
                points += 1
                build(cut, tmp_path / "probe")
                got = generation(tmp_path / "probe")
                shutil.rmtree(tmp_path / "probe")
                assert got == 7 if k == len(second.after) - 1 else got in (before, 7), (call, got, before)
    print(f"{len(firsts)} first cuts, {points} second cuts")


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_the_recorder_sees_every_call_that_the_kernel_sees(tmp_path):
    program = (
        "import sys; from pathlib import Path; from bms_gateway.store import StateStore\n"
        "store = StateStore(Path(sys.argv[1]) / 'lib' / 'gateway'); store.load()\n"
        "for n in (1, 2, 3): store.save({'generation': n}, wall_ns=n)\n"
    )
    traced, log = tmp_path / "traced", tmp_path / "log"
    traced.mkdir()
    what = "trace=" + (
        "openat,open,creat,write,pwrite64,writev,fsync,fdatasync,rename,renameat,renameat2,"
        "unlink,unlinkat,mkdir,mkdirat,truncate,ftruncate,link,linkat,symlink"
    )
    done = subprocess.run(
        ["strace", "-f", "-y", "-o", log, "-e", what, sys.executable, "-c", program, traced], capture_output=True
    )
    if done.returncode and b"ptrace" in done.stderr.lower():
        pytest.skip("no process may be traced here")
    assert done.returncode == 0, done.stderr
    seen = []
    for line in log.read_text().splitlines():
        call = re.match(r"\d+ +(\w+)\(", line)
        if not call or str(traced) not in line or re.search(r"= -1 E", line):
            continue
        name = {"openat": "open", "renameat2": "rename", "renameat": "rename", "unlinkat": "unlink"}.get(
            call[1], call[1]
        )
        if name == "open" and "O_WRONLY" not in line:
            continue
        seen.append(name)
    recorder = Recorder(tmp_path / "recorded")
    (tmp_path / "recorded").mkdir()
    with recorder.watching():
        store = StateStore(tmp_path / "recorded" / "lib" / "gateway")
        store.load()
        for n in (1, 2, 3):
            store.save({"generation": n}, wall_ns=n)
    assert seen == [c.split()[0] for c in recorder.calls]


LOOP = """
import sys
from pathlib import Path
from bms_gateway.store import StateStore
store = StateStore(Path(sys.argv[1]))
n = store.load().state
n = n["generation"] if n else 0
while True:
    n += 1
    assert store.save({"generation": n, "fill": "0123456789abcdef" * 700}, wall_ns=n) is None
    print(n, flush=True)
"""


def test_kill_9_at_any_moment_costs_at_most_the_save_under_way(tmp_path):
    rng = random.Random(1)
    last = 0
    for _ in range(8):
        saver = subprocess.Popen([sys.executable, "-c", LOOP, tmp_path], stdout=subprocess.PIPE)
        said = [int(saver.stdout.readline())]  # it is at work
        time.sleep(rng.uniform(0.0, 0.05))
        saver.send_signal(signal.SIGKILL)
        said += [int(line) for line in saver.stdout.read().splitlines(keepends=True) if line.endswith(b"\n")]
        saver.wait()
        saver.stdout.close()
        found = StateStore(tmp_path).load()
        assert found.problems == ()
        assert found.state["generation"] in (said[-1], said[-1] + 1)
        assert said[0] == last + 1
        last = found.state["generation"]


def test_a_second_process_on_the_directory_is_told_so_in_one_line(tmp_path):
    first, second = StateStore(tmp_path / "state"), StateStore(tmp_path / "state")
    assert first.lock() is None
    code = (
        "import sys; from pathlib import Path; from bms_gateway.store import StateStore\n"
        "from bms_gateway.errors import StateError\n"
        "try: StateStore(Path(sys.argv[1])).lock()\n"
        "except StateError as e: print(e)\n"
    )
    said = subprocess.run([sys.executable, "-c", code, second.directory], capture_output=True, text=True, check=True)
    assert said.stdout.count("\n") == 1
    assert "another bms-gateway keeps its state there" in said.stdout
    first.unlock()
    assert second.lock() is None
    second.unlock()


def test_the_lock_ends_with_its_process(tmp_path):
    code = (
        "import sys, os; from pathlib import Path; from bms_gateway.store import StateStore\n"
        "StateStore(Path(sys.argv[1])).lock(); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code, tmp_path]).returncode == -signal.SIGKILL
    store = StateStore(tmp_path)
    assert store.lock() is None
    store.unlock()


def test_where_no_lock_can_be_had_the_service_goes_on(tmp_path):
    (tmp_path / "file").write_text("")
    assert "estimates go on" in str(StateStore(tmp_path / "file" / "below").lock())


def test_files_are_not_for_everybody(tmp_path):
    StateStore(tmp_path).save({}, wall_ns=1)
    assert (tmp_path / "state").stat().st_mode & 0o007 == 0
    assert json.loads((tmp_path / "state").read_text().split("\n", 1)[1])["saved_ns"] == 1
    assert os.listdir(tmp_path) == ["state"]
