"""Requests of a person: whole or not there, readable by the service, and no file that is none stands in their way."""

import json
import os
import stat
from pathlib import Path

import pytest

from bms_gateway.errors import StateError
from bms_gateway.store.requests import Acknowledgement, BaselineReset, ask, asked

RESET = BaselineReset("string_1", 1, "a new cell", 5)
SEEN = Acknowledgement(None, "looked at", 6)


def wishes(folder):
    return [wish for _, wish in asked(folder)]


def laid(folder, **content):
    (folder / "baseline.5.request").write_text(
        json.dumps({"string": "s", "cell": 1, "reason": "r", "time_ns": 5} | content)
    )
    return wishes(folder)


@pytest.mark.parametrize("wish", [RESET, SEEN])
def test_a_request_is_on_the_disk_whole_and_for_the_service_to_read_whatever_the_umask(tmp_path, monkeypatch, wish):
    synced, real = [], os.fsync

    def fsync(handle):
        there = Path(f"/proc/self/fd/{handle}")
        synced.append((stat.S_IFMT(os.fstat(handle).st_mode), None if there.resolve().is_dir() else there.read_bytes()))
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    before, open_before = os.umask(0o077), len(os.listdir("/proc/self/fd"))
    try:
        path = ask(tmp_path, wish)
    finally:
        os.umask(before)
    assert len(os.listdir("/proc/self/fd")) == open_before
    assert list(tmp_path.iterdir()) == [path]
    assert stat.S_IMODE(path.stat().st_mode) == 0o644
    assert synced == [(stat.S_IFREG, path.read_bytes()), (stat.S_IFDIR, None)]
    assert wishes(tmp_path) == [wish]


def test_what_cannot_be_written_is_told_and_leaves_nothing(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(StateError, match="the request cannot be written: No space left on device"):
        ask(tmp_path, RESET)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_directory_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StateError, match="the request cannot be written: Not a directory"):
        ask(tmp_path / "file", RESET)


def test_what_is_no_request_stands_in_nobodys_way(tmp_path):
    os.mkfifo(tmp_path / "baseline.1.request")
    (tmp_path / "baseline.2.request").write_text("{")
    (tmp_path / "baseline.3.request").mkdir()
    ask(tmp_path, RESET)
    assert wishes(tmp_path) == [None, None, None, RESET]


@pytest.mark.parametrize(
    "content",
    [
        *({"time_ns": time} for time in ("5", True, 5.0)),
        *({"cell": cell} for cell in (0, -1, 1.0, True, "1")),
        {"reason": 1},
        {"string": None},
        {"more": 1},
    ],
)
def test_a_request_for_something_else_is_none(tmp_path, content):
    assert laid(tmp_path, **content) == [None]


def test_a_request_for_a_whole_string_is_one_and_so_is_one_for_its_first_cell(tmp_path):
    assert laid(tmp_path, cell=None) == [BaselineReset("s", None, "r", 5)]
    assert laid(tmp_path) == [BaselineReset("s", 1, "r", 5)]


@pytest.mark.parametrize(("string", "sound"), [(None, True), ("s", True), (1, False), (["s"], False)])
def test_an_acknowledgement_is_for_a_string_or_for_all(tmp_path, string, sound):
    (tmp_path / "acknowledged.6.request").write_text(json.dumps({"string": string, "reason": "r", "time_ns": 6}))
    assert wishes(tmp_path) == [Acknowledgement(string, "r", 6) if sound else None]


@pytest.mark.parametrize(
    "reason", ["new\nCRITICAL forged", "new\x1b[2J\tCRITICAL  forged", "new\x00\u2028CRITICAL forged "]
)
def test_a_reason_is_one_printable_line_whoever_wrote_the_request(tmp_path, reason):
    (found,) = laid(tmp_path, reason=reason)
    assert found.reason.isprintable()
    assert found.reason.startswith("new")
    assert found.reason.endswith("CRITICAL forged")


def test_a_reason_has_two_hundred_characters_at_most(tmp_path):
    (found,) = laid(tmp_path, reason="é" * 300)
    assert found.reason == "é" * 200


def test_a_request_has_ten_thousand_bytes_at_most(tmp_path):
    bare = len(json.dumps({"string": "s", "cell": 1, "reason": "", "time_ns": 5}))
    assert laid(tmp_path, reason="x" * (10_000 - bare)) != [None]
    assert laid(tmp_path, reason="x" * (10_001 - bare)) == [None]


@pytest.mark.parametrize("gone", [True, False])
def test_one_that_vanishes_meanwhile_or_is_none_hides_no_other(tmp_path, monkeypatch, gone):
    for k in (1, 2, 3):
        ask(tmp_path, BaselineReset("string_1", None, "x", k))
    first = tmp_path / "baseline.1.request"
    first.write_text("{")
    is_file = Path.is_file

    def vanishes(path):
        there = is_file(path)
        if gone and path == first:
            path.unlink()
        return there

    monkeypatch.setattr(Path, "is_file", vanishes)
    found = [None if wish is None else wish.time_ns for _, wish in asked(tmp_path)]
    assert found == ([2, 3] if gone else [None, 2, 3])


def test_one_that_cannot_be_read_hides_no_other(tmp_path, monkeypatch):
    for k in (1, 2):
        ask(tmp_path, BaselineReset("string_1", None, "x", k))
    real = Path.open

    def fails(path, *words):
        if path.name == "baseline.1.request":
            raise OSError(5, "Input/output error")
        return real(path, *words)

    monkeypatch.setattr(Path, "open", fails)
    found = [wish for _, wish in asked(tmp_path)]
    assert [type(wish) for wish in found] == [OSError, BaselineReset]
