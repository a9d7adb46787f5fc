"""Logs of other programs, rule by rule: which record counts as broken, by which number and words, and when to stop."""

import io
import logging
import struct
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import can
import pytest

from bms_gateway.bus import foreign
from bms_gateway.bus.candump import CUT_SHORT, LogNotes
from bms_gateway.bus.foreign import Lines, LongLineError, read_foreign, unraised
from bms_gateway.errors import DataError
from bms_gateway.frames.batch import FrameBatch
from tests.bus.frames import rows

HEADER = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"


def record(k, remote=0):
    return f"{1_700_000_000 + k}.0,0x{0x100 + k:x},0,{remote},0,1,AQ==\n"  # base64 of the byte 1


def read(path, kind=".csv", frames=1000):
    notes = LogNotes()
    return list(read_foreign(path, kind, frames, notes)), notes


@pytest.fixture
def csv(tmp_path):
    def write(*lines):
        (tmp_path / "a.csv").write_text(HEADER + "".join(lines))
        return tmp_path / "a.csv"

    return write


def test_the_bounds():
    assert (foreign.LONGEST_LINE, foreign.MOST_BLANK, foreign.GIVE_UP) == (65_536, 100_000, 1000)
    assert (foreign.MDF_HEADER, foreign.SHOWN) == (168, 60)


# lines


def test_lines_are_counted_and_a_restart_puts_a_blank_one_before_the_next():
    file = io.StringIO("a\nb\n\n  c  ")
    lines = Lines(Path("x.trc"), file)
    assert (lines.number, lines.said(ValueError())) == (0, "")
    assert [next(lines), lines.number] == ["a\n", 1]
    lines.restart()
    assert [next(lines), lines.number] == ["\n", 1]
    assert [next(lines), next(lines), next(lines), lines.number] == ["b\n", "\n", "  c  ", 4]
    assert lines.said(ValueError("of the reader")) == "c"
    assert list(lines) == []
    lines.close()
    assert file.closed


def test_some_blank_lines_are_none_the_worse_but_many_in_a_row_are_no_log(monkeypatch):
    monkeypatch.setattr(foreign, "MOST_BLANK", 5)
    text = "\n" * 5 + "a\n" + " \t\n" * 5 + "b\n"
    assert len(list(Lines(Path("x.trc"), io.StringIO(text)))) == 12
    with pytest.raises(DataError, match=r"^x\.trc, line 18: 6 blank lines in a row: not a log$"):
        list(Lines(Path("x.trc"), io.StringIO(text + "\n" * 7)))


def test_a_line_without_end_is_passed_over_in_pieces_and_named(monkeypatch):
    monkeypatch.setattr(foreign, "LONGEST_LINE", 2048)
    whole = "y" * 2047 + "\n"
    lines = Lines(Path("x.trc"), io.StringIO(f"{whole}{'x' * 5000}\n{whole}{'z' * 2048}\nlast"))
    assert next(lines) == whole
    with pytest.raises(LongLineError, match=r"^a line of over 2 KiB$") as error:
        next(lines)
    assert (lines.number, lines.said(error.value)) == (2, "a line of over 2 KiB")
    assert (next(lines), lines.number) == (whole, 3)
    with pytest.raises(LongLineError):
        next(lines)
    assert [next(lines), lines.number] == ["last", 5]


# records that cannot be read


def test_broken_records_are_counted_by_their_lines_and_the_others_are_read(csv):
    long = "z" * 100
    batches, notes = read(csv(record(0), "rubbish\n", record(1), "1,2\n", f"  {long}\n", record(2)))
    assert [can_id for _, can_id, _ in rows(FrameBatch.concat(batches))] == [0x100, 0x101, 0x102]
    assert (notes.frames, notes.broken) == (3, 3)
    assert notes.broken_at == [(3, "rubbish"), (5, "1,2"), (6, long[:60])]


def test_a_blank_record_is_named_by_the_kind_of_its_error(csv):
    assert read(csv(record(0), "\n", record(1)))[1].broken_at == [(3, "ValueError")]


def test_a_file_is_left_when_so_many_records_in_a_row_are_broken(csv, monkeypatch):
    monkeypatch.setattr(foreign, "GIVE_UP", 3)
    bad = "rubbish\n"
    batches, notes = read(csv(bad, bad, record(0), bad, bad, record(1), bad, bad))
    assert (sum(map(len, batches)), notes.broken) == (2, 6)
    path = csv(record(0), bad, bad, bad, record(1))
    notes = LogNotes()
    reading = read_foreign(path, ".csv", 1, notes)
    assert len(next(reading)) == 1
    with pytest.raises(DataError, match=r"a\.csv: 3 records in a row cannot be read as \.csv: is it another format\?$"):
        next(reading)
    assert notes.broken == 3


def test_no_batch_is_empty_and_no_frame_without_data_counts(csv):
    batches, notes = read(csv(record(0), record(1, remote=1), record(2), record(3)), frames=1)
    assert [len(batch) for batch in batches] == [1, 1, 1]
    assert (notes.frames, notes.remote) == (3, 1)
    assert [len(batch) for batch in read(csv(*map(record, range(5))), frames=2)[0]] == [2, 2, 1]


def test_gzip_data_that_end_too_early_give_their_whole_lines(tmp_path):
    packer = zlib.compressobj(wbits=31)
    raw = packer.compress((HEADER + "".join(map(record, range(7)))).encode()) + packer.flush(zlib.Z_SYNC_FLUSH)
    (tmp_path / "a.csv.gz").write_bytes(raw)
    batches, notes = read(tmp_path / "a.csv.gz")
    assert sum(map(len, batches)) == 7
    assert notes.broken_at == [(9, CUT_SHORT)]
    packer = zlib.compressobj(wbits=31)
    text = HEADER + record(0) + "rubbish\n" + record(1)
    (tmp_path / "a.csv.gz").write_bytes(packer.compress(text.encode()) + packer.flush())
    batches, notes = read(tmp_path / "a.csv.gz")
    assert (sum(map(len, batches)), notes.broken_at) == (2, [(3, "rubbish")])


@pytest.mark.parametrize("name", ["can.io.trc", "can.io.asc"])
def test_readers_do_not_log_the_lines_that_are_counted_here(csv, name, monkeypatch):
    monkeypatch.setattr(logging.getLogger(name), "level", logging.NOTSET)
    logging.getLogger(name).manager._clear_cache()
    read(csv(record(0)))
    assert not logging.getLogger(name).isEnabledFor(logging.WARNING)


# BLF


OBJECT = 48
"""Bytes of a classic frame in a BLF."""


def containers(raw):
    """Place of each container of a BLF."""
    at, found = 144, []
    while at < len(raw):
        size, kind = struct.unpack_from("<II", raw, at + 8)
        found += [at] * (kind == 10)
        at += size + size % 4
    return found


@pytest.mark.parametrize("size", [1000, 20 * OBJECT])  # frames lie across the ends of containers, and end there
@pytest.mark.parametrize("damaged", [(0,), (1, 3), (2, 3), (4,), (1, 2, 3), ()])
def test_a_damaged_container_of_a_blf_costs_its_frames_only_and_none_is_made_up(damaged, size, tmp_path):
    path = tmp_path / "a.blf"
    with can.BLFWriter(path, max_container_size=size) as writer:
        for k in range(100):
            writer(can.Message(timestamp=1.7e9 + k, arbitration_id=k, is_extended_id=False, data=bytes([k] * 8)))
    raw = bytearray(path.read_bytes())
    places = containers(raw)
    assert len(places) == -(-100 * OBJECT // size)
    for n in damaged:
        raw[places[n] + 32 : places[n] + 36] = b"\xff" * 4  # where its packed data begin
    path.write_bytes(raw)
    batches, notes = read(path, ".blf")
    lies_in = [{OBJECT * k // size, (OBJECT * (k + 1) - 1) // size} for k in range(100)]
    left = [k for k in range(100) if not lies_in[k] & set(damaged)]
    found = rows(FrameBatch.concat(batches))
    assert [(can_id, payload) for _, can_id, payload in found] == [(k, bytes([k] * 8)) for k in left]
    # as a record counts what was read before it, and what was broken
    before = [sum(max(lies_in[k]) < n for k in left) + nth + 1 for nth, n in enumerate(damaged)]
    assert [number for number, _ in notes.broken_at] == before
    assert all("decompressing" in text for _, text in notes.broken_at)


# MF4


def test_the_header_of_mf4_must_be_whole(tmp_path):
    pytest.importorskip("asammdf")
    for size, whole in ((167, False), (168, True)):
        (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ".ljust(size, b"\0"))
        with pytest.raises(DataError, match=r"a\.mf4: not a \.mf4 log") as error:
            read(tmp_path / "a.mf4", ".mf4")
        assert ("it has no header of MDF" in str(error.value)) is not whole


def test_mf4_packed_by_gzip_is_read_and_a_fault_in_it_ends_the_reading(tmp_path, monkeypatch):
    pytest.importorskip("asammdf")
    with can.Logger(tmp_path / "a.mf4") as writer:
        for k in range(20):
            writer(can.Message(timestamp=1.7e9 + k, arbitration_id=k, is_extended_id=False, data=b"\1"))
    packer = zlib.compressobj(wbits=31)
    whole = packer.compress((tmp_path / "a.mf4").read_bytes()) + packer.flush()
    (tmp_path / "a.mf4.gz").write_bytes(whole)
    batches, notes = read(tmp_path / "a.mf4.gz", ".mf4")
    assert [can_id for _, can_id, _ in rows(FrameBatch.concat(batches))] == list(range(20))
    assert notes.broken == 0

    class Broken:
        def __init__(self, _):
            self.left = iter(range(3))

        def __iter__(self):
            for k in self.left:
                yield can.Message(timestamp=1.7e9, arbitration_id=k, is_extended_id=False, data=b"\1")
            raise ValueError("a damaged record")

    monkeypatch.setattr(can, "MF4Reader", Broken)
    batches, notes = read(tmp_path / "a.mf4", ".mf4")
    assert (sum(map(len, batches)), notes.broken_at) == (3, [(4, "a damaged record")])


def test_errors_in_what_is_thrown_away_are_kept_off_the_terminal_for_one_kind_and_a_while(monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    before = sys.unraisablehook
    with unraised(AttributeError):
        for kind in (AttributeError, ValueError):
            sys.unraisablehook(SimpleNamespace(exc_type=kind))
    assert [said.exc_type for said in told] == [ValueError]
    assert sys.unraisablehook is before
    with pytest.raises(ZeroDivisionError), unraised(AttributeError):
        raise ZeroDivisionError
    assert sys.unraisablehook is before
