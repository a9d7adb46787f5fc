"""One process at a time keeps its state in a directory."""

import errno
import fcntl
import os
from pathlib import Path

import pytest

from bms_gateway.errors import StateError
from bms_gateway.store import StateStore


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_directory_is_made_and_locked_until_it_is_given_back(tmp_path):
    folder = tmp_path / "a" / "b"
    first, second, before = StateStore(folder), StateStore(folder), open_files()
    assert first.lock() is None
    assert folder.is_dir()
    assert list(folder.iterdir()) == []  # no file is left behind, whatever ends the process
    with pytest.raises(StateError, match=r"a/b: another bms-gateway keeps its state there: stop it, or give this one"):
        second.lock()
    first.unlock()
    assert second.lock() is None
    second.unlock()
    second.unlock()
    assert open_files() == before


def test_a_child_of_the_service_does_not_keep_the_lock(tmp_path):
    store = StateStore(tmp_path)
    assert store.lock() is None
    held = [int(f.name) for f in Path("/proc/self/fd").iterdir() if os.path.realpath(f) == str(tmp_path)]
    assert [os.get_inheritable(handle) for handle in held] == [False]
    store.unlock()


@pytest.mark.parametrize("code", [errno.EWOULDBLOCK, errno.EACCES])
def test_both_words_for_a_lock_of_others_mean_it(tmp_path, monkeypatch, code):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", refuse)
    before = open_files()
    with pytest.raises(StateError, match="another bms-gateway"):
        StateStore(tmp_path).lock()
    assert open_files() == before


def test_a_file_system_without_locks_is_told_and_used(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", refuse)
    store, before = StateStore(tmp_path), open_files()
    assert "cannot be locked against a second process: No locks available" in str(store.lock())
    assert open_files() == before
    assert store.save({}, wall_ns=1) is None


def test_a_place_that_is_no_directory_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        problem = StateStore(place).lock()
        assert "no state can be kept there: Not a directory; estimates go on without it" in str(problem)
