import gc
import gzip
import io
import itertools
import logging
import sys
from contextlib import suppress

import can
import numpy as np
import pytest

from bms_gateway.bus.logfile import LogNotes, read_log
from bms_gateway.errors import DataError, MissingExtraError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from tests.bus.frames import rows
from tests.data import data_dir, need

FOLDER = data_dir() / "conformance" / "python-can"
FILES = sorted(p.name for p in FOLDER.glob("*") if p.suffix in (".asc", ".blf", ".trc", ".gz"))


def oracle(path):
    options = {} if path.suffix == ".gz" else {"relative_timestamp": False}
    if path.name.endswith(".asc.gz"):
        text = io.StringIO(gzip.decompress(path.read_bytes()).decode())
        messages = can.ASCReader(text, relative_timestamp=False)
    else:
        messages = can.LogReader(path, **(options if path.suffix == ".asc" else {}))
    return [
        (
            round(m.timestamp * 1e6) * 1000,
            m.arbitration_id | EXTENDED * m.is_extended_id,
            bytes(m.data),
        )
        for m in messages
        if not (m.is_error_frame or m.is_remote_frame)
    ]


@pytest.mark.parametrize("name", FILES or ["absent"])
def test_every_conformance_file_gives_what_python_can_gives(name):
    path = need("conformance", "python-can", name)
    logging.getLogger("can").setLevel(logging.ERROR)
    expected = oracle(path)
    notes = LogNotes()
    assert rows(FrameBatch.concat(list(read_log(path, notes=notes)))) == expected
    assert notes.broken == 0
    assert rows(FrameBatch.concat(list(read_log(path, chunk=1)))) == expected


def write(path, count=50):
    with can.Logger(path) as writer:
        for k in range(count):
            data = bytes([k % 256] * (k % 9))
            writer(can.Message(timestamp=1.7e9 + k / 100, arbitration_id=k, is_extended_id=bool(k % 2), data=data))
    return [(k, k | EXTENDED * (k % 2), bytes([k % 256] * (k % 9))) for k in range(count)]


@pytest.mark.parametrize("suffix", [".asc", ".csv", ".trc", ".blf"])
def test_formats_agree_on_frames_and_intervals(suffix, tmp_path):
    expected = write(tmp_path / f"a{suffix}")
    got = rows(FrameBatch.concat(list(read_log(tmp_path / f"a{suffix}"))))
    assert [(c, p) for _, c, p in got] == [(c, p) for _, c, p in expected]
    assert {b[0] - a[0] for a, b in itertools.pairwise(got)} == {10_000_000}


@pytest.mark.parametrize(
    ("suffix", "break_it"), [(".csv", "not,a,line"), (".trc", "     7)  1.0 DT  1  ZZZZ Rx -  8  11")]
)
def test_a_broken_record_costs_that_record_only(suffix, break_it, tmp_path):
    path = tmp_path / f"a{suffix}"
    write(path)
    lines = path.read_text().splitlines()
    where = len(lines) - 20
    lines[where] = break_it
    lines[where + 5] = break_it
    path.write_text("\n".join(lines) + "\n")
    notes = LogNotes()
    assert sum(len(b) for b in read_log(path, notes=notes)) == 48
    assert [n for n, _ in notes.broken_at] == [where + 1, where + 6]


def test_a_broken_asc_record_costs_that_record_only(tmp_path):
    path = tmp_path / "a.asc"
    write(path)
    lines = path.read_text().splitlines()
    where = next(i for i, line in enumerate(lines) if " 14" in line and " d " in line)
    lines[where] = lines[where].replace(" d ", " d z")
    path.write_text("\n".join(lines) + "\n")
    notes = LogNotes()
    assert sum(len(b) for b in read_log(path, notes=notes)) == 49
    assert notes.broken_at[0][0] == where + 1


def test_a_truncated_blf_gives_its_whole_blocks(tmp_path):
    path = tmp_path / "a.blf"
    write(path, 20_000)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    notes = LogNotes()
    assert sum(len(b) for b in read_log(path, notes=notes)) > 1_000


def test_another_kind_of_file_is_refused_in_one_line(tmp_path):
    path = tmp_path / "a.blf"
    path.write_text("this is text and long enough to be read as a header" * 10)
    with pytest.raises(DataError, match=r"a.blf: not a .blf log"):
        list(read_log(path))
    path = tmp_path / "a.csv"
    path.write_text("this\nis\nnot\nit\n")
    with pytest.raises(DataError, match=r"a.csv, line 2: not a .csv log"):
        list(read_log(path))


def test_mf4_without_its_extra_says_what_to_install(monkeypatch):
    path = need("conformance", "asammdf_css", "2F6913DB_00000004_00000001.MF4")
    for name in ("asammdf", "asammdf.blocks.utils"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'bms-gateway\[mf4\]'"):
        list(read_log(path))


def test_mf4_of_decoded_signals_says_that_it_has_no_frames(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    t = np.arange(50) / 10
    with asammdf.MDF() as made:
        made.append([asammdf.Signal(20 + t, t, name=name, unit="degC") for name in ("ZellTemp_1", "ZellTemp_2")])
        made.save(tmp_path / "decoded.mf4")
    with pytest.raises(DataError, match=r"2 decoded signals, as ZellTemp_1, ZellTemp_2, and no CAN frames: .*encode"):
        list(read_log(tmp_path / "decoded.mf4"))


def test_mf4_is_read_and_what_is_none_is_refused(tmp_path):
    pytest.importorskip("asammdf")
    expected = write(tmp_path / "a.mf4")
    got = rows(FrameBatch.concat(list(read_log(tmp_path / "a.mf4"))))
    assert [(c, p) for _, c, p in got] == [(c, p) for _, c, p in expected]
    (tmp_path / "b.mf4").write_bytes(b"garbage" * 100)
    with pytest.raises(DataError, match=r"b.mf4: not a .mf4 log"):
        list(read_log(tmp_path / "b.mf4"))


@pytest.mark.parametrize("name", ["17BD1DB7_00000006_00000170", "2F6913DB_00000004_00000001"])
def test_mf4_that_its_logger_did_not_finish_is_read(name):
    pytest.importorskip("asammdf")
    batches = list(read_log(need("conformance", "asammdf_css", f"{name}.MF4")))
    assert sum(len(batch) for batch in batches) > 100


@pytest.mark.parametrize("content", [b"MDF     4.00", b"garbage" * 100, b""])
def test_what_has_no_header_of_mdf_leaves_no_traceback(content: bytes, tmp_path, monkeypatch):
    pytest.importorskip("asammdf")
    thrown: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", thrown.append)
    (tmp_path / "b.mf4").write_bytes(content)
    with pytest.raises(DataError, match=r"b.mf4: not a .mf4 log \(it has no header of MDF\)"):
        list(read_log(tmp_path / "b.mf4"))
    gc.collect()
    assert not thrown


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_mf4_that_was_cut_leaves_no_traceback(share, tmp_path, monkeypatch):
    pytest.importorskip("asammdf")
    write(tmp_path / "a.mf4")
    whole = (tmp_path / "a.mf4").read_bytes()
    (tmp_path / "a.mf4").write_bytes(whole[: int(share * len(whole))])
    thrown: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", thrown.append)
    with suppress(DataError):  # what is left of the frames may be readable
        list(read_log(tmp_path / "a.mf4"))
    gc.collect()
    assert not thrown


def test_a_csv_file_that_is_no_log_is_told_by_its_line_not_by_what_its_reader_stumbled_over(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n" + "1,2\n" * 50)
    with pytest.raises(DataError, match=r"a.csv, line 2: not a .csv log: '1,2'$"):
        list(read_log(tmp_path / "a.csv"))
