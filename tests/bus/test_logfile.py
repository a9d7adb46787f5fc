"""The rules of reading and writing logs: names, folders, where reading gives up, and what is told."""

import gzip
import itertools
import subprocess

import numpy as np
import pytest

from bms_gateway.bus import logfile
from bms_gateway.bus.candump import CUT_SHORT
from bms_gateway.bus.logfile import LONGEST_LINE, LogNotes, read_log, write_log
from bms_gateway.errors import DataError, UsageError
from bms_gateway.frames.batch import FrameBatch
from tests.bus.frames import make, rows

LINE = b"(1700000000.000000) can0 123#11\n"
ONE = make((1_700_000_000_000_000_000, 0x123, b"\x11"))


def read(path, **options):
    return rows(FrameBatch.concat(list(read_log(path, **options))))


def test_the_bounds():
    assert (logfile.CHUNK, LONGEST_LINE, logfile.GIVE_UP) == (512 * 1024, 64 * 1024, 1_000_000)


@pytest.mark.parametrize("name", ["a.log", "A.LOG", "a.b.log", "a.log.gz", "A.Log.GZ"])
def test_a_log_is_known_by_its_last_suffix_and_read_as_it_was_written(tmp_path, name):
    path = tmp_path / name
    assert write_log(path, [ONE, ONE]) == 2
    packed = name.lower().endswith("gz")
    assert (gzip.decompress(path.read_bytes()) if packed else path.read_bytes()) == 2 * LINE
    assert read(path) == 2 * rows(ONE)
    assert list(tmp_path.iterdir()) == [path]


def test_the_same_frames_give_the_same_bytes_whatever_the_name_and_the_time(tmp_path, monkeypatch):
    write_log(tmp_path / "a.log.gz", [ONE])
    monkeypatch.setattr("time.time", lambda: 1e9)
    write_log(tmp_path / "b.log.gz", [ONE])
    assert (tmp_path / "a.log.gz").read_bytes() == (tmp_path / "b.log.gz").read_bytes()
    assert (tmp_path / "a.log.gz").read_bytes()[3:8] == bytes(5)  # no name, and no time


def test_the_name_of_the_interface_is_that_given(tmp_path):
    write_log(tmp_path / "a.log", [ONE], "vcan7")
    assert b" vcan7 123#" in (tmp_path / "a.log").read_bytes()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("a.zip", "packed as .zip: unpack it first; only gzip (.gz) is read as it is"),
        ("a.log.xz", "packed as .xz: unpack it first"),
        ("a.zip.gz", "packed as .zip: unpack it first"),
        ("a", "no log format (no suffix); valid: .log, .asc, .blf, .csv, .mf4, .trc, also with .gz"),
        ("a.gz", "no log format (no suffix); valid:"),
        ("a.log.txt", "no log format .txt; valid:"),
        ("a.log.gz.gz", "no log format .gz; valid:"),
    ],
)
def test_another_format_is_told_with_those_that_are_read(tmp_path, name, told):
    (tmp_path / name).write_bytes(LINE)
    for call in (read, lambda path: write_log(path, [])):
        with pytest.raises(UsageError) as error:
            call(tmp_path / name)
        assert str(error.value).startswith(f"{tmp_path / name}: {told}")


def test_only_candump_text_is_written(tmp_path):
    with pytest.raises(UsageError, match=r"^logs are written as candump text: name a.asc '.log' or '.log.gz'$"):
        write_log(tmp_path / "a.asc", [ONE])


def test_what_is_no_plain_file_is_told(tmp_path):
    with pytest.raises(UsageError, match=r"^no such log: .*/a.log$"):
        read(tmp_path / "a.log")
    (tmp_path / "d.log").mkdir()
    with pytest.raises(UsageError, match=r"d.log: is a directory; expected a log$"):
        read(tmp_path / "d.log")
    with pytest.raises(UsageError, match=r"^no such log: .*/x/a.log \(no such folder: .*/x\)$"):
        read(tmp_path / "x" / "a.log")
    (tmp_path / "null.log").symlink_to("/dev/null")
    with pytest.raises(UsageError, match=r"null.log: is no plain file; expected a log$"):
        read(tmp_path / "null.log")


@pytest.mark.parametrize(("name", "near"), [("drive.log", True), ("dxyze.log", True), ("other", False)])
def test_the_nearest_name_is_told_once(tmp_path, name, near):
    (tmp_path / name).write_bytes(LINE)
    (tmp_path / (name + ".bak")).write_bytes(LINE)
    with pytest.raises(UsageError) as error:
        read(tmp_path / "drvie.log")
    assert (f"did you mean '{tmp_path / name}'?" in str(error.value)) is near
    assert ".bak" not in str(error.value)


def test_a_disk_that_fails_is_told_by_its_reason(tmp_path, monkeypatch):
    path = tmp_path / "a.log"
    path.write_bytes(LINE)

    def fails(*_):
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as m:
        m.setattr(logfile, "_read_candump", fails)
        with pytest.raises(DataError, match=r"a.log: cannot be read \(Input/output error\)$"):
            read(path)
        m.setattr(logfile, "_read_candump", lambda *_: (_ for _ in ()).throw(OSError("odd")))
        with pytest.raises(DataError, match=r"a.log: cannot be read \(odd\)$"):
            read(path)
    monkeypatch.setattr(logfile, "format_block", fails)
    with pytest.raises(DataError, match=r"a.log: cannot be written \(Input/output error\)$"):
        write_log(path, [ONE])
    assert path.read_bytes() == LINE


def test_a_log_of_which_nothing_can_be_read_is_told_by_its_first_line_and_an_empty_one_is_none(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(b"\nhello\nworld\n")
    with pytest.raises(DataError, match=r"a.log, line 2: not a .log log: 'hello'$"):
        read(path)
    for text in (b"", b"\n\n", b"hello\n(1.0) can0 123#R\n"):  # a remote frame is a frame
        path.write_bytes(text)
        assert read(path) == []
    packed = tmp_path / "b.log.gz"
    packed.write_bytes(gzip.compress(LINE)[:12])
    with pytest.raises(DataError, match=rf"b.log.gz: {CUT_SHORT}; nothing before can be read$"):
        read(packed)


def test_a_cut_gzip_gives_whole_lines_and_notes_where_it_ends(tmp_path):
    rng = np.random.default_rng(0)
    lines = b"".join(b"(%d.%06d) can0 123#11\n" % (k, u) for k, u in enumerate(rng.integers(0, 10**6, 2000)))
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(lines)[:-5000])
    notes = LogNotes()
    found = read(path, chunk=1000, notes=notes)
    whole = lines.split(b"\n")[: len(found)]
    assert 100 < len(found) < 2000
    assert [t // 1000 for t, *_ in found] == [int(line[1 : line.index(b")")].replace(b".", b"")) for line in whole]
    assert notes.broken_at == [(len(found) + 1, CUT_SHORT)]


@pytest.mark.parametrize(("end", "frames"), [(LINE[:-1], 2), (b"bad end", 1), (b" ", 1)])
def test_the_last_line_needs_no_end_and_no_batch_is_empty(tmp_path, end, frames):
    path = tmp_path / "a.log"
    path.write_bytes(LINE + end)
    assert [len(batch) for batch in read_log(path)] == [1] * frames


def test_a_log_under_the_name_of_another_format_is_told(tmp_path):
    (tmp_path / "a.asc").write_bytes(LINE)
    with pytest.raises(DataError, match=r"a.asc: this is a candump log: name it .log$"):
        read(tmp_path / "a.asc")


@pytest.mark.parametrize("chunk", [1, 31, 32, 33, 1000])
def test_lines_are_counted_across_pieces(tmp_path, chunk):
    path = tmp_path / "a.log"
    path.write_bytes(LINE + b"\n" + b"bad one\n" + 2 * LINE + b"bad end")
    notes = LogNotes()
    assert read(path, chunk=chunk, notes=notes) == 3 * rows(ONE)
    assert notes.broken_at == [(3, "bad one"), (6, "bad end")]


def test_pieces_have_the_size_asked_for(tmp_path):
    path = tmp_path / "a.log"
    path.write_bytes(10 * LINE)
    assert [len(b) for b in read_log(path, chunk=2 * len(LINE))] == [2] * 5
    assert [len(b) for b in read_log(path)] == [10]
    assert [len(b) for b in read_log(path, chunk=2 * len(LINE) + 1)] == [2, 2, 2, 2, 2]


@pytest.mark.parametrize("more", [0, 1])
def test_a_line_without_end_is_given_up_when_it_is_too_long(tmp_path, more):
    path = tmp_path / "a.log"
    path.write_bytes(2 * LINE + b"x" * (LONGEST_LINE + more))
    if more:
        with pytest.raises(DataError, match=r"a.log, line 3: no end of line in 64 KiB: not a candump log$"):
            read(path, chunk=2 * len(LINE))
    else:
        assert len(read(path, chunk=2 * len(LINE))) == 2


def test_reading_gives_up_after_so_many_broken_lines_in_a_row(tmp_path, monkeypatch):
    monkeypatch.setattr(logfile, "GIVE_UP", 3)
    path = tmp_path / "a.log"
    path.write_bytes(LINE + b"12345678\n" * 3 + LINE + b"12345678\n" * 2)
    assert len(read(path, chunk=9)) == 2
    path.write_bytes(b"12345678\n" * 3 + LINE)
    assert len(read(path, chunk=9)) == 1
    path.write_bytes(LINE + b"12345678\n" * 4)
    with pytest.raises(DataError, match=r"a.log, line 6: 4 lines in a row cannot be read: not a candump log$"):
        read(path, chunk=9)
    path.write_bytes(b"".join(itertools.chain.from_iterable((LINE, b"1234567890\n" * 3) for _ in range(3))))
    assert len(read(path, chunk=9)) == 3


def test_other_formats_are_read_in_pieces_of_as_many_frames(tmp_path, monkeypatch):
    path = tmp_path / "a.asc"
    path.write_bytes(b"date Mon Jan 1 00:00:00.000 2024\nbase hex  timestamps absolute\n")
    asked = []
    monkeypatch.setattr("bms_gateway.bus.foreign.read_foreign", lambda p, k, n, notes: asked.append((k, n)) or iter(()))
    for chunk in (1, 99, 100, 1000):
        read(path, chunk=chunk)
    assert asked == [(".asc", 1), (".asc", 1), (".asc", 2), (".asc", 20)]


@pytest.mark.parametrize("codec", ["utf-8", "cp1252", "utf-16"])
@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_a_table_in_the_words_of_its_maker_is_called_a_table(codec, mark, tmp_path):
    rows = [["Zeit", "Strom", "Kühlmittel Eintritt", "Zelle 1"], *([str(k), "3", "20", "21"] for k in range(1200))]
    (tmp_path / "t.csv").write_text("\n".join(map(mark.join, rows)), encoding=codec)
    with pytest.raises(DataError, match="this is a table of measurements, no log: encode makes frames of it"):
        list(read_log(tmp_path / "t.csv"))


def test_the_interfaces_of_a_log_are_counted(tmp_path):
    lines = (
        LINE * 3 + b"garbage can7 1\n" + LINE.replace(b"can0", b"vcan1-x") * 5 + LINE.replace(b"123#11", b"123##011")
    )
    (tmp_path / "a.log").write_bytes(lines)
    assert dict(logfile.interfaces_of(tmp_path / "a.log")) == {"can0": 4, "vcan1-x": 5}
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(lines))
    assert dict(logfile.interfaces_of(tmp_path / "a.log.gz")) == {"can0": 4, "vcan1-x": 5}
    (tmp_path / "cut.log.gz").write_bytes(gzip.compress(lines)[:12])
    assert not logfile.interfaces_of(tmp_path / "cut.log.gz")
    (tmp_path / "a.asc").write_text("date\n")
    assert not logfile.interfaces_of(tmp_path / "a.asc")


@pytest.mark.parametrize("packed", [False, True])
def test_a_reversed_log_is_refused_with_the_command_that_sorts_it(tmp_path, packed):
    lines = [f"({1.7e9 + k / 10:.6f}) can0 100#{k % 256:02X}\n" for k in range(600)]
    text = "".join(reversed(lines)).encode()
    log = tmp_path / ("back.log.gz" if packed else "back.log")
    log.write_bytes(gzip.compress(text) if packed else text)
    with pytest.raises(DataError, match="its time stamps run backwards, 599 of 599 steps") as told:
        list(read_log(log))
    command = str(told.value).rpartition("by time: ")[2]
    subprocess.run(command, shell=True, cwd=tmp_path, check=True)
    assert (tmp_path / "sorted.log").read_text() == "".join(lines)
    assert sum(map(len, read_log(tmp_path / "sorted.log"))) == 600


def test_frames_that_an_adapter_reorders_and_a_clock_set_back_are_no_reversed_log(tmp_path):
    log = tmp_path / "odd.log"
    order = [k ^ 1 if k < 300 else k - 290 for k in range(600)]
    log.write_text("".join(f"({1.7e9 + k / 10:.6f}) can0 100#{k % 256:02X}\n" for k in order))
    assert sum(map(len, read_log(log, chunk=2000))) == 600
