"""A state that cannot be read may be a good one: nothing replaces it, and whoever only looks moves nothing."""

import errno
import os
import stat
import subprocess
import sys
import time

import pytest

from bms_gateway.errors import StateError
from bms_gateway.store import StateStore
from bms_gateway.store.state import KEPT_MOST
from tests.support.states import saved


class Disk:
    """Some of its files cannot be opened, or read; renamed they stay what they are."""

    def __init__(self, monkeypatch, folder):
        self.folder, self.bad, self.code, self.call = folder, set(), errno.EACCES, "open"
        real_open, real_read = os.open, os.read

        def open_(path, flags, *more, **options):
            looks = self.call == "open" and not flags & (os.O_WRONLY | os.O_DIRECTORY)
            if looks and self.is_bad(os.stat(path, dir_fd=options.get("dir_fd"))):
                raise OSError(self.code, os.strerror(self.code))
            return real_open(path, flags, *more, **options)

        def read(handle, size):
            if self.call == "read" and self.is_bad(os.fstat(handle)):
                raise OSError(self.code, os.strerror(self.code))
            return real_read(handle, size)

        monkeypatch.setattr(os, "open", open_)
        monkeypatch.setattr(os, "read", read)

    def is_bad(self, found):
        return stat.S_ISREG(found.st_mode) and found.st_ino in self.bad

    def spoil(self, *names):
        self.bad |= {(self.folder / name).stat().st_ino for name in names}

    def mend(self):
        self.bad.clear()


@pytest.fixture
def disk(monkeypatch, tmp_path):
    return Disk(monkeypatch, tmp_path)


def generation(file):
    return int(file.read_text().split('"generation":')[1].split(",")[0].split("}")[0])


@pytest.mark.parametrize(("code", "call"), [(errno.EACCES, "open"), (errno.EIO, "open"), (errno.EIO, "read")])
def test_both_generations_survive_any_number_of_saves_while_they_cannot_be_read(tmp_path, disk, code, call):
    """After two saves both were erased, and with them the baseline of R_e."""
    saved(tmp_path)
    disk.code, disk.call = code, call
    disk.spoil("state", "state.previous")
    store = StateStore(tmp_path)
    found = store.load()
    assert found.state is None
    assert [os.strerror(code) in str(p) for p in found.problems] == [True, True]
    assert "cannot be read" in store.unread
    for n in (3, 4, 5):
        assert store.save({"generation": n}, wall_ns=n) is None
    assert "kept as state.previous.unread, state.unread: stop the service and move it back" in store.unread
    assert store.load().state == {"generation": 5}
    disk.mend()
    found = {f.name: generation(f) for f in tmp_path.iterdir()}
    assert found == {"state": 5, "state.previous": 4, "state.unread": 2, "state.previous.unread": 1}


def test_a_newer_state_that_cannot_be_read_gets_a_name_of_its_own_beside_the_one_before(tmp_path, disk):
    store = saved(tmp_path)
    for n in (3, 4):
        disk.spoil("state")
        assert store.save({"generation": n}, wall_ns=n) is None
    disk.mend()
    assert (generation(tmp_path / "state.unread"), generation(tmp_path / "state.unread.2")) == (2, 3)
    assert store.load().state == {"generation": 4}


def test_where_names_run_out_nothing_is_saved_and_nothing_is_lost(tmp_path, disk):
    store = saved(tmp_path)
    assert KEPT_MOST == 5
    for n in range(KEPT_MOST):
        disk.spoil("state")
        assert store.save({"generation": 3 + n}, wall_ns=n) is None
    disk.spoil("state")
    before = {f.name: f.stat().st_ino for f in tmp_path.iterdir() if f.name != "state.new"}
    problem = store.save({"generation": 99}, wall_ns=99)
    assert isinstance(problem, StateError)
    assert f"{KEPT_MOST} others are kept as state.unread*" in str(problem)
    assert {f.name: f.stat().st_ino for f in tmp_path.iterdir() if f.name != "state.new"} == before
    disk.mend()
    (tmp_path / "state.unread").unlink()
    assert store.save({"generation": 99}, wall_ns=99) is None


def test_a_link_to_what_is_not_there_is_no_fresh_start(tmp_path):
    """A state on another disk, which is not mounted today."""
    disk, folder = tmp_path / "disk", tmp_path / "state"
    disk.mkdir()
    folder.mkdir()
    (folder / "state").symlink_to(disk / "state")
    store = StateStore(folder)
    assert "a link to what is not there" in str(store.load().problems[0])
    assert store.save({"generation": 1}, wall_ns=1) is None
    assert (folder / "state.unread").is_symlink()
    assert store.load().state == {"generation": 1}


@pytest.mark.parametrize("code", [errno.EMFILE, errno.ENFILE, errno.ENOMEM])
def test_a_shortage_is_no_fault_of_the_file(tmp_path, disk, code):
    store = saved(tmp_path)
    disk.code = code
    disk.spoil("state")
    assert "cannot be saved" in str(store.save({"generation": 3}, wall_ns=3))
    disk.mend()
    assert store.load().state["generation"] == 2
    assert store.save({"generation": 3}, wall_ns=3) is None
    assert {f.name for f in tmp_path.iterdir()} == {"state", "state.previous"}


def test_a_state_kept_unread_is_told_at_every_start_until_a_person_has_seen_to_it(tmp_path, disk):
    store = saved(tmp_path)
    disk.spoil("state")
    assert store.save({"generation": 3}, wall_ns=3) is None
    disk.mend()
    again = StateStore(tmp_path)
    assert again.load().problems == ()
    assert "kept as state.unread" in again.unread
    (tmp_path / "state.unread").unlink()
    assert again.save({"generation": 4}, wall_ns=4) is None
    assert again.unread == ""


def newer(n):
    return b"bms-gateway-state 7 x 3 of version %d" % n


def test_states_of_a_newer_version_are_all_kept(tmp_path):
    for n in (1, 2):
        (tmp_path / "state").write_bytes(newer(n))
        store = StateStore(tmp_path)
        assert store.load().state is None
        assert store.save({"generation": n}, wall_ns=n) is None
    assert (tmp_path / "state.too-new").read_bytes() == newer(1)
    assert (tmp_path / "state.too-new.2").read_bytes() == newer(2)


def test_a_state_that_could_not_be_set_aside_at_the_start_is_set_aside_before_the_first_save(tmp_path, monkeypatch):
    (tmp_path / "state").write_bytes(newer(1))
    store, replace = StateStore(tmp_path), os.replace

    def refuse(a, b, **more):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as m:
        m.setattr(os, "replace", refuse)
        assert "cannot be set aside: Read-only" in str(store.load().problems[0])
        assert "cannot be set aside: Read-only" in str(store.save({"generation": 1}, wall_ns=1))
    assert os.replace is replace
    assert store.save({"generation": 1}, wall_ns=1) is None
    assert (tmp_path / "state.too-new").read_bytes() == newer(1)


def test_who_looks_moves_nothing_whatever_lies_there(tmp_path, disk):
    saved(tmp_path)
    (tmp_path / "state").write_bytes(b"garbage")
    disk.spoil("state.previous")
    before = {f.name: f.stat().st_ino for f in tmp_path.iterdir()}
    found = StateStore(tmp_path).look()
    assert found.state is None
    assert [str(p).rsplit(": ", 1)[1] for p in found.problems] == [
        "it is not a state of this program",
        "Permission denied",
    ]
    assert {f.name: f.stat().st_ino for f in tmp_path.iterdir()} == before


WRITER = """
import sys
import time
from pathlib import Path
from bms_gateway.store import StateStore
store = StateStore(Path(sys.argv[1]))
n = 0
while True:
    n += 1
    assert store.save({"generation": n, "fill": "x" * (n % 7) * 1000}, wall_ns=n) is None
    if n == 2:
        print("up", flush=True)
"""


@pytest.mark.parametrize("read", ["load", "look"])
def test_a_reader_beside_the_writer_finds_a_whole_state_every_time_and_renames_none(tmp_path, read):
    """Head and body were read from two files when the writer came between: 21 of 36,559 loads renamed a good state."""
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE)
    try:
        assert writer.stdout.readline() == b"up\n"
        store, newest, read_times = StateStore(tmp_path), 0, 0
        until = time.monotonic() + 120
        while read_times < 3_000 or newest <= 10:  # a busy disk lets the writer save less often than we read
            assert time.monotonic() < until
            read_times += 1
            found = getattr(store, read)()
            assert found.problems == ()
            assert found.state["generation"] >= newest
            newest = found.state["generation"] - 1  # between the two renames the one before is the newest
    finally:
        writer.kill()
        writer.wait()
        writer.stdout.close()
    assert {f.name for f in tmp_path.iterdir()} <= {"state", "state.previous", "state.new"}
