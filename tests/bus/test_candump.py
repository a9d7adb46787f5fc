import gzip
import random
import tracemalloc

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.candump import LogNotes, format_block, parse_block
from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.errors import DataError, UsageError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from tests.bus.frames import ids, make, payloads, rows, same
from tests.data import need

LOGS = [
    "leaf_ze0_24kwh.log.gz",
    "leaf_ze1_62kwh_eco_drive.log.gz",
    "uwfe_autocross_2025-04-30_run10.log.gz",
    "uwfe_july7_run12.log.gz",
    "uwfe_pitt_autocross_02.log.gz",
]


def parse(text: bytes) -> tuple[list[tuple[int, int, bytes]], LogNotes]:
    notes = LogNotes()
    batch, _ = parse_block(text, 1, notes)
    return rows(batch), notes


@pytest.mark.parametrize("name", LOGS)
def test_real_logs_equal_python_can_frame_by_frame(name, tmp_path):
    raw = b"".join(gzip.decompress(need("can", name).read_bytes()).splitlines(keepends=True)[:20_000])
    path = tmp_path / "part.log"
    path.write_bytes(raw)
    notes = LogNotes()
    got = rows(FrameBatch.concat(list(read_log(path, notes=notes))))
    expected = []
    for line, message in zip(raw.splitlines(), can.CanutilsLogReader(path), strict=True):
        number = int(line.split(b"#")[0].split()[-1], 16)
        if number > 0x1FFF_FFFF:  # garbage of a bad recording: python-can cuts the id, we pass such lines over
            continue
        stamp = int(line[1:18].replace(b".", b"")) * 1_000
        assert abs(message.timestamp - stamp * 1e-9) < 1e-6
        expected.append((stamp, message.arbitration_id | EXTENDED * message.is_extended_id, bytes(message.data)))
    assert got == expected
    assert notes.frames + notes.broken + notes.errors == raw.count(b"\n")


@pytest.mark.parametrize("name", LOGS[-2:])
def test_writing_gives_the_very_bytes_that_were_read(name, tmp_path):
    path = need("can", name)
    assert write_log(tmp_path / "out.log", read_log(path), "can0") > 10_000
    assert (tmp_path / "out.log").read_bytes() == gzip.decompress(path.read_bytes())
    write_log(tmp_path / "out.log.gz", read_log(path), "can0")
    assert gzip.decompress((tmp_path / "out.log.gz").read_bytes()) == gzip.decompress(path.read_bytes())


stamps = st.one_of(
    st.builds(lambda s, u: f"{s}.{u:06d}", st.integers(0, 8_999_999_999), st.integers(0, 999_999)),
    st.builds(lambda s, u: f"{s:010d}.{u:06d}", st.integers(0, 4_000_000_000), st.integers(0, 999_999)),
    st.builds(lambda s, n: f"{s}.{n:09d}", st.integers(0, 4_000_000_000), st.integers(0, 999_999_999)),
)
good_lines = st.builds(
    lambda stamp, channel, can_id, payload, lower, tail: (
        f"({stamp}) {channel} {can_id & 0x1FFFFFFF:0{8 if can_id & EXTENDED else 3}{'x' if lower else 'X'}}"
        f"#{payload.hex() if lower else payload.hex().upper()}{tail}"
    ),
    stamps,
    st.sampled_from(["can0", "vcan0", "0", "can12"]),
    ids,
    payloads,
    st.booleans(),
    st.sampled_from(["", "", "", " R", " T", "\r"]),
)
odd_lines = st.one_of(
    st.sampled_from(
        [
            "(1700000000.000001) can0 123##1" + "AB" * 12,
            "(1700000000.000001) can0 12345678##0",
            "(1700000000.000001) can0 123#R",
            "(1700000000.000001) can0 123#R4",
            "(1700000000.000001) can0 20000080#0000000000000000",
            "(1700000000.000001) can0 1234#AA",
            "(1700000000) can0 123#AA",
            "",
            "   ",
            "(1700000000.000001) can0 123#ABC",
            "(1700000000.000001) can0 123#AABBCCDDEEFF001122",
            "(1700000000.000001) can0 12Z#AA",
            "(1700000000.000001) can0 FFF#AA",
            "(1700000000.000001) can0 123",
            "(1700000000.00000A) can0 123#AA",
            "(99999999999.000000) can0 123#AA",
            "(1700000000.000001)can0 123#AA",
            "(1700000000.000001)  123#AA",
            "#",
            "(",
        ]
    ),
    st.text(st.characters(codec="latin-1", exclude_characters="\n"), max_size=40),
    good_lines.flatmap(lambda line: st.integers(0, len(line)).map(lambda n: line[:n])),
)
texts = st.lists(st.one_of(good_lines, odd_lines), max_size=30).map(lambda lines: "\n".join(lines).encode("latin-1"))


@settings(max_examples=150, deadline=None)
@given(texts, st.data())
def test_the_result_does_not_depend_on_how_the_text_is_cut(text, data):
    whole_notes, notes = LogNotes(), LogNotes()
    whole, lines = parse_block(text, 1, whole_notes)
    parts, at = [], 1
    remaining = [line + b"\n" for line in text.removesuffix(b"\n").split(b"\n")]
    while remaining:
        n = data.draw(st.integers(1, len(remaining)))
        part, count = parse_block(b"".join(remaining[:n]), at, notes)
        parts.append(part)
        at += count
        remaining = remaining[n:]
    assert same(FrameBatch.concat(parts), whole)
    assert notes == whole_notes
    assert at - 1 == lines


@settings(max_examples=150, deadline=None)
@given(st.lists(good_lines, min_size=1, max_size=30))
def test_each_line_is_read_as_its_text_says(lines):
    got, notes = parse("\n".join(lines).encode())
    expected = []
    for line in lines:
        stamp, _, frame, *_ = line.split()
        seconds, fraction = stamp[1:-1].split(".")
        can_id, data = frame.split("#")
        number = int(can_id, 16) | (EXTENDED if len(can_id) == 8 else 0)
        expected.append((int(seconds) * 10**9 + int(fraction.ljust(9, "0")), number, bytes.fromhex(data)))
    assert got == expected
    assert notes == LogNotes(frames=len(lines))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 8 * 10**18), ids, st.binary(max_size=12)), max_size=20))
def test_what_is_written_is_read_back_to_the_microsecond(frames):
    frames = [(t, c, p if len(p) <= 8 else p + b"\0") for t, c, p in frames]
    got, _ = parse(format_block(make(*frames), "can1"))
    assert got == [(t // 1000 * 1000, c, p) for t, c, p in frames]


def test_broken_lines_are_counted_and_named_and_end_nothing():
    good = b"(1700000000.000001) can0 123#AA\n"
    text = good + b"rubbish\n" + good + b"(1700000000.000001) can0 123#ABC\n\n" + good
    got, notes = parse(text)
    assert len(got) == 3
    assert notes.broken == 2
    assert notes.broken_at == [(2, "rubbish"), (4, "(1700000000.000001) can0 123#ABC")]


def test_remote_and_error_frames_are_counted_and_never_data():
    text = b"(1.0) can0 123#R\n(1.000000) can0 123#R8\n(1.000000) can0 20000004#0000000000000000\n"
    got, notes = parse(text)
    assert got == []
    assert (notes.remote, notes.errors, notes.broken) == (2, 1, 0)


def test_long_can_fd_frames_widen_the_batch_and_others_are_padded():
    got, _ = parse(b"(1.000000) can0 001#AA\n(1.000000) can0 002##3" + b"CD" * 64 + b"\n")
    assert got == [(10**9, 1, b"\xaa"), (10**9, 2, b"\xcd" * 64)]


@pytest.mark.parametrize("chunk", [1, 7, 100, 4096])
def test_reading_files_does_not_depend_on_the_chunk(chunk, tmp_path):
    random.seed(3)
    lines = [b"(%d.%06d) can0 %03X#%s\n" % (k, k, k, bytes(k % 9).hex().encode()) for k in range(200)]
    lines.insert(50, b"broken\n")
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(b"".join(lines[:90])) + gzip.compress(b"".join(lines[90:])[:-1]))
    notes, reference = LogNotes(), LogNotes()
    got = FrameBatch.concat(list(read_log(path, chunk=chunk, notes=notes)))
    assert len(got) == 200
    assert same(got, FrameBatch.concat(list(read_log(path, notes=reference))))
    assert notes == reference
    assert notes.broken_at == [(51, "broken")]


def test_a_truncated_gzip_gives_what_it_holds(tmp_path):
    lines = b"".join(b"(%d.%06d) can0 %03X#\n" % (k, random.randrange(10**6), k % 2000) for k in range(20_000))
    path = tmp_path / "cut.log.gz"
    packed = gzip.compress(lines)
    path.write_bytes(packed[: len(packed) // 2])
    notes = LogNotes()
    assert sum(len(b) for b in read_log(path, notes=notes)) > 5_000
    assert any("too early" in text for _, text in notes.broken_at)


def test_errors_say_file_and_nearest_choice(tmp_path):
    (tmp_path / "drive.log").write_text("hello\nworld\n")
    with pytest.raises(UsageError, match=r"no such log: .*drvie.log; did you mean '.*drive.log'\?"):
        list(read_log(tmp_path / "drvie.log"))
    with pytest.raises(DataError, match=r"drive.log, line 1: not a .log log: 'hello'"):
        list(read_log(tmp_path / "drive.log"))
    with pytest.raises(UsageError, match=r"no log format .xlsx; valid: .log, .asc"):
        list(read_log(tmp_path / "a.xlsx"))
    (tmp_path / "zero.log").write_bytes(bytes(1 << 20))
    with pytest.raises(DataError, match="no end of line"):
        list(read_log(tmp_path / "zero.log"))
    with pytest.raises(UsageError, match="written as candump text"):
        write_log(tmp_path / "a.blf", [])


def test_memory_stays_flat_on_long_logs(tmp_path):
    path = tmp_path / "long.log"
    path.write_bytes(b"(1700000000.000001) can0 12345678#0011223344556677\n" * 400_000)
    assert max(len(b) for b in read_log(path)) < 60_000
    assert np.all(next(read_log(path)).can_id == 0x1234_5678 | EXTENDED)


FRAME = b"(1700000000.000000) can0 123#11\n"


@pytest.mark.parametrize("blank", [b"\n", b"\r\n", b" \t\n", b"\v\f  \n"])
def test_blank_lines_are_counted_and_cost_no_memory(blank):
    """Each took a hundred bytes and some microseconds: 1.5 GB of them had no end in 120 s."""
    text = FRAME + blank * 100_000 + b"x\n" + blank * 3 + b"\0\n" + FRAME
    tracemalloc.start()
    notes = LogNotes()
    batch, lines = parse_block(text, 1, notes)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (len(batch), lines) == (2, 100_007)
    assert notes.broken_at == [(100_002, "x"), (100_006, "\0")]
    assert peak < 80 * len(text)
    assert parse_block(blank * 1000, 1, notes)[1] == 1000
    assert parse_block(blank * 10 + b" ", 1, notes)[1] == 11


def test_a_log_of_which_a_million_lines_in_a_row_are_none_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr("bms_gateway.bus.logfile.GIVE_UP", 1000)
    path = tmp_path / "a.log"
    path.write_bytes(FRAME + b"x\n" * 5000)
    with pytest.raises(DataError, match="lines in a row cannot be read: not a candump log"):
        list(read_log(path, chunk=500))
    path.write_bytes((b"x\n" * 600 + FRAME) * 20)
    notes = LogNotes()
    assert sum(map(len, read_log(path, chunk=500, notes=notes))) == 20
    assert notes.broken == 12_000
