"""A log with a wrong name, or cut short, says what it is."""

import gzip

import can
import pytest

from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.errors import DataError, UsageError

LINES = [f"(1700000000.{k:06d}) can0 123#AABB{k:04X}" for k in range(3000)]
CANDUMP = ("\n".join(LINES) + "\n").encode()
SCREEN = b"  can0  123   [8]  11 22 33 44 55 66 77 88\n" * 3
STAMPED_SCREEN = b" (1700000000.000000)  can0  123   [2]  11 22\n" * 3


def other(path):
    with can.Logger(path) as writer:
        for k in range(5):
            writer(can.Message(timestamp=1.7e9 + k, arbitration_id=k, data=b"\1"))
    return path.read_bytes()


@pytest.mark.parametrize("name", ["a.asc", "a.csv", "a.trc", "a.blf", "a.mf4", "a.asc.gz"])
def test_candump_text_under_another_name_is_recognised(tmp_path, name):
    (tmp_path / name).write_bytes(gzip.compress(CANDUMP, mtime=0) if name.endswith("gz") else CANDUMP)
    packed = ".gz" if name.endswith("gz") else ""
    with pytest.raises(DataError, match=f"{name}: this is a candump log: name it .log{packed}$"):
        list(read_log(tmp_path / name))


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc", ".blf"])
def test_other_formats_named_as_candump_are_recognised(tmp_path, suffix):
    (tmp_path / "a.log").write_bytes(other(tmp_path / f"b{suffix}"))
    with pytest.raises(DataError, match=rf"a.log: this is a .* log: name it {suffix}$"):
        list(read_log(tmp_path / "a.log"))


@pytest.mark.parametrize("text", [SCREEN, STAMPED_SCREEN, b"can0 123#1122\n", b"can0  RX - -  123   [1]  11\n"])
def test_candump_without_its_stamps_says_how_to_record(tmp_path, text):
    (tmp_path / "a.log").write_bytes(text)
    with pytest.raises(DataError, match="record with candump -l or -L"):
        list(read_log(tmp_path / "a.log"))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.log.gz", CANDUMP, "a.log.gz: not gzip data: leave .gz out of its name"),
        ("a.asc.gz", b"date Sat\n", "not gzip data"),
        ("a.log", gzip.compress(CANDUMP, mtime=0), "this is gzip data: end its name with .gz"),
        ("a.log.gz", gzip.compress(CANDUMP, mtime=0)[:12], "a.log.gz: the gzip data end too early or are damaged"),
    ],
)
def test_packed_or_not_is_told(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=says) as caught:
        list(read_log(tmp_path / name))
    assert "line 0" not in str(caught.value)


@pytest.mark.parametrize("cut", range(-400, -8, 49))
def test_a_packed_log_cut_short_gives_whole_lines_and_the_place(tmp_path, cut):
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(CANDUMP, mtime=0)[:cut])
    notes = LogNotes()
    batches = list(read_log(tmp_path / "a.log.gz", chunk=1000, notes=notes))
    count = sum(len(b) for b in batches)
    assert all((b.length == 4).all() for b in batches)  # no frame is made of half a line
    assert 1000 < count <= 3000
    assert notes.broken_at == [(count + 1, "the gzip data end too early or are damaged: the rest is lost")]


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc"])
def test_other_text_cut_short_is_one_note(tmp_path, suffix):
    raw = gzip.compress(other(tmp_path / f"b{suffix}"))
    (tmp_path / f"a{suffix}.gz").write_bytes(raw[:-8])
    notes = LogNotes()
    assert sum(len(b) for b in read_log(tmp_path / f"a{suffix}.gz", notes=notes)) >= 4
    assert [text for _, text in notes.broken_at] == ["the gzip data end too early or are damaged: the rest is lost"]


@pytest.mark.parametrize("name", ["logs", "logs.log", "logs.asc"])
def test_a_folder_is_called_one(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(UsageError, match=f"{name}: is a directory"):
        list(read_log(tmp_path / name))


def test_remote_frames_of_other_formats_are_counted(tmp_path):
    with can.Logger(tmp_path / "a.asc") as writer:
        writer(can.Message(timestamp=1.7e9, arbitration_id=1, data=b"\1"))
        writer(can.Message(timestamp=1.7e9 + 1, arbitration_id=2, is_remote_frame=True))
    notes = LogNotes()
    assert sum(len(b) for b in read_log(tmp_path / "a.asc", notes=notes)) == 1
    assert notes.remote == 1
