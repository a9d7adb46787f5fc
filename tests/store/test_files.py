"""The disk operations one by one: what is no file holds nothing up, and nothing stays open."""

import os
import threading
from pathlib import Path

import pytest

from bms_gateway.store.files import append, make_directory, read_file, sync_directory, write_fresh


def opened() -> set[str]:
    return set(os.listdir("/proc/self/fd"))


def test_nothing_stays_open(tmp_path):
    before = opened()
    write_fresh(tmp_path / "a", b"1")
    append(tmp_path / "a", b"2")
    sync_directory(tmp_path)
    assert [read_file(tmp_path / "a", most) for most in (9, 2, 1, 0)] == [b"12", b"12", b"1", b""]
    assert opened() == before


@pytest.mark.parametrize("write", [write_fresh, append])
def test_a_file_is_for_its_owner_and_read_by_its_group(tmp_path, write):
    """It shows where and how a vehicle is driven."""
    mask = os.umask(0)
    try:
        write(tmp_path / "a", b"1")
    finally:
        os.umask(mask)
    assert (tmp_path / "a").stat().st_mode & 0o7777 == 0o640


def test_a_pipe_in_the_place_of_a_file_holds_nobody_up(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    found = []
    reader = threading.Thread(target=lambda: found.append(read_file(tmp_path / "pipe", 9)), daemon=True)
    reader.start()
    reader.join(10.0)
    assert found == [None]


def test_a_file_is_no_directory_to_be_synced(tmp_path):
    (tmp_path / "a").write_bytes(b"")
    with pytest.raises(NotADirectoryError):
        sync_directory(tmp_path / "a")


def test_a_directory_that_another_makes_in_the_same_moment_is_taken(tmp_path, monkeypatch):
    real = Path.mkdir

    def mkdir(path, *words, **options):
        real(path)
        real(path, *words, **options)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    make_directory(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
