"""Lines of candump text against a reader that takes each apart by its words, and written lines against their format."""

import random
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from bms_gateway.bus import candump
from bms_gateway.bus.candump import LogNotes, format_block, parse_block
from bms_gateway.frames.batch import EXTENDED
from tests.bus.frames import make, rows

HEX = b"0123456789abcdefABCDEF"
WHITE = b" \t\n\r\v\f"


def digits(text, most, known=b"0123456789"):
    return 1 <= len(text) <= most and all(c in known for c in text)


def plain(line):
    """What a line says: a frame (time, id, payload), or a word for what it is instead."""
    if not line.strip(WHITE):
        return "blank"
    stamp, closed, rest = line.partition(b")")
    seconds, dot, fraction = stamp[1:].partition(b".")
    whole = line.startswith(b"(") and closed and digits(seconds, 12) and (not dot or digits(fraction, 9))
    words = rest.split()
    if not whole or rest[:1] not in list(map(bytes, zip(WHITE))) or len(words) not in (2, 3):
        return "broken"
    if words[2:] not in ([], [b"R"], [b"T"]):
        return "broken"
    name, mark, data = words[1].partition(b"#")
    if data[-2:-1] == b"_" and data[-1] in HEX:
        data = data[:-2]
    flexible = data.startswith(b"#")
    payload = data[2:] if flexible else data
    remote = data in (b"R", *(b"R" + bytes([c]) for c in HEX))
    if not mark or not digits(name, 8, HEX) or (flexible and not digits(data[1:2], 1, HEX)):
        return "broken"
    number, most = int(name, 16), 0x3FFF_FFFF if len(name) > 3 else 0x7FF
    if int(seconds) >= 9_000_000_000 or number > most:
        return "broken"
    if remote:
        return "remote"
    if len(payload) % 2 or len(payload) > (128 if flexible else 16) or any(c not in HEX for c in payload):
        return "broken"
    if number & 0x2000_0000:
        return "error"
    time_ns = int(seconds) * 10**9 + int((fraction or b"0").ljust(9, b"0"))
    return time_ns, number | (EXTENDED if len(name) > 3 else 0), bytes.fromhex(payload.decode())


def check(lines, first=1):
    """Read lines as one block, and hold what comes out against what each of them says."""
    notes = LogNotes()
    batch, count = parse_block(b"".join(line + b"\n" for line in lines), first, notes)
    said = [plain(line) for line in lines]
    assert count == len(lines)
    assert rows(batch) == [s for s in said if isinstance(s, tuple)]
    broken = [(first + k, lines[k][:80].decode("ascii", "replace")) for k, s in enumerate(said) if s == "broken"]
    assert (notes.frames, notes.remote, notes.errors) == (len(batch), said.count("remote"), said.count("error"))
    assert (notes.broken, notes.broken_at) == (len(broken), broken[:20])


STANDARD = b"(1700000000.000123) can0 123#0011AABBccddEEff"
TYPICAL = [
    STANDARD,
    b"(1700000000.987654) vcan0 1ABCDEF0#A1 R",
    b"(1746032768.123456789) c0 7ff# T\r",
    b"(5.5) can0 12#R",
    b"(12) can1 00000123##3" + b"5A" * 12 + b"_9 T",
]


def hurt(line):
    """The line with every byte replaced, left out and doubled; not with names of two words, which no interface has."""
    for k in range(len(line)):
        changed = [line[:k] + line[k + 1 :], line[:k] + line[k : k + 1] + line[k:]]
        changed += [line[:k] + bytes([c]) + line[k + 1 :] for c in b" \t\r\v\x1c\0().#_+-/:@G`gRT09aFx\x80\xb2\xff"]
        yield from (other for other in changed if len(other.split()) <= len(line.split()))


@pytest.mark.parametrize("line", TYPICAL)
def test_a_line_that_is_damaged_in_one_place_says_what_it_says(line):
    lines = list(hurt(line))
    for k in range(0, len(lines), 7):
        check([STANDARD, *lines[k : k + 7], line], k)
    random.Random(1).shuffle(lines)
    check(lines)


@pytest.mark.parametrize("fraction", range(10))
def test_stamps_of_any_number_of_digits(fraction):
    lines = []
    for whole in range(1, 13):
        for seconds in {
            "987654321098"[:whole],
            "123456789012"[:whole],
            "0" * whole,
            "9" * whole,
            "8".ljust(whole, "9"),
        }:
            for part in {"123456789"[:fraction], "9" * fraction, "0" * fraction}:
                lines.append(f"({seconds}{'.' * bool(part)}{part}) can0 123#11".encode())
    for line in lines:
        check([line])
    random.Random(2).shuffle(lines)
    check(lines)
    for seconds in (b"8999999999", b"9000000000", b"9000000001"):
        check([b"(%s.%s) can0 123#11" % (seconds, b"9" * max(1, fraction))])


def test_identifiers_of_any_number_of_digits_up_to_what_there_is():
    numbers = [0, 1, 0xF, 0x7FE, 0x7FF, 0x800, 0x801, 0xFFF, 0xFFFF, 0xFFFFF, 0x1FFFFFFE, 0x1FFFFFFF]
    numbers += [0x20000000, 0x20000001, 0x3FFFFFFE, 0x3FFFFFFF, 0x40000000, 0x80000123, 0xFFFFFFFF, 0x100000000]
    numbers += [16**k * d for k in range(8) for d in range(16)]
    lines = [b"(1.000001) can0 %s#AB" % (b"%0*x" % (n, x)) for x in numbers for n in range(1, 10)]
    check(lines + [line.upper() for line in lines])
    for line in lines[:180]:
        check([line])


def test_payloads_of_any_length_with_every_digit_in_every_place():
    lines = [b"(1.000001) can0 123#" + b"0123456789abcdefABCDEF"[:n] for n in range(23)]
    lines += [
        b"(1.000001) can0 123#" + b"0" * k + bytes([c]) + b"0" * (n - k - 1)
        for n in (2, 8, 10, 16)
        for k in range(n)
        for c in HEX
    ]
    lines += [b"(1.000001) can0 123##0" + b"C3" * n + b"0" * odd for n in range(66) for odd in (0, 1)]
    check(lines)
    for line in lines[:23]:
        check([line])


def test_names_blanks_and_tails():
    tails = (b"", b" R", b"  T ", b"\r", b" \r", b" R\r", b" X", b"R", b" R T", b"_8", b"_")
    parts = product((b" ", b"  ", b"\t", b""), (b"c", b"c#d", b""), (b" ", b" \t", b""), tails)
    lines = [b"(1.5)%s%s%s7#01%s" % part for part in parts]
    check(lines)
    for line in lines:
        check([line, STANDARD])
    short = [b"x", b"(0.0) 0#", b"(0.0) a 0#", b"(0.0)a 0#", b"#", b"(", b"\0"]
    check([b"", b" ", b"\t\r", STANDARD, b"", *short, STANDARD])
    check([STANDARD, b" " * 12, STANDARD, b"(1) can0 123#11"])
    for last in (b"(1.000001) can0 123", b"(1.000001)  123#AA", b"no mark"):
        check([last])
        check([STANDARD, STANDARD, last])


def test_what_candump_writes_is_read_by_columns_and_not_line_by_line(monkeypatch):
    """Line by line it would take twenty times as long."""

    def one_by_one(*_):
        raise AssertionError("a line was read by itself")

    monkeypatch.setattr(candump, "_read_odd", one_by_one)
    draw = random.Random(3)
    lines = []
    for k in range(3000):
        name = b"%03X" % draw.randrange(0x800) if k % 2 else b"%08X" % draw.randrange(1 << 30)
        stamp = b"%010d.%06d" % (draw.randrange(9 * 10**9), draw.randrange(10**6))
        data = draw.randbytes(draw.randrange(9)).hex().encode()
        tail = draw.choice([b"", b" R", b" T", b"\r"])
        channel = draw.choice([b"can0", b"vcan1", b"b3d5f7", b"9"])
        lines.append(b"(%s) %s %s#%s%s" % (stamp, channel, name, data.upper() if k % 5 else data, tail))
    lines += [
        b"(1.000000) can0 7FF#",
        b"(1.000000) can0 1FFFFFFF#",
        b"(1.000000) can0 000#",
        b"(1.000000) can0 00000000#",
    ]
    check(lines)
    for line in lines[-8:]:
        check([line])
    for n in (1, 4, 8, 9, 10):
        check([f"({'8' * n}.{'7' * m}) can0 123#AA".encode() for m in range(1, 9)])


def test_only_lines_that_are_odd_are_read_by_themselves(monkeypatch):
    odd = [b"(1.x) can0 123#11", b"rubbish", b"(1.000001) can0 123##1" + b"AB" * 12, b"(2) can0 123#11"]
    alone, pattern = [], candump.LINE
    monkeypatch.setattr(candump, "LINE", SimpleNamespace(fullmatch=lambda x: alone.append(x) or pattern.fullmatch(x)))
    for k in range(4):
        lines = [STANDARD] * 20
        for place in (0, 1, 7):
            lines.insert(place, odd[(k + place) % 4])
        alone.clear()
        check(lines)
        assert alone == [lines[0], lines[1], lines[7]]


@pytest.mark.parametrize(("line", "width"), [(b"(1) can0 1#" + b"AB" * 8, 8), (b"(1) can0 1##0" + b"AB" * 12, 64)])
def test_a_block_is_as_wide_as_its_longest_frame_may_be(line, width):
    for lines in ((line,), (STANDARD, line), (line, STANDARD)):
        assert parse_block(b"\n".join(lines), 1, LogNotes())[0].data.shape == (len(lines), width)


def test_at_most_twenty_broken_lines_are_named_and_cut_to_eighty_characters():
    check([b"x" * 100, *[b"y%d" % k for k in range(30)], STANDARD], 17)


def test_a_last_line_without_its_end():
    for text, frames, lines in ((STANDARD, 1, 1), (STANDARD + b"\n" + STANDARD, 2, 2), (b"\n ", 0, 2), (b"\n", 0, 1)):
        batch, count = parse_block(text, 1, LogNotes())
        assert (len(batch), count) == (frames, lines)


def test_notes_count_each_kind():
    notes = LogNotes()
    assert (notes.frames, notes.remote, notes.errors, notes.broken, notes.broken_at) == (0, 0, 0, 0, [])
    notes.frames, notes.remote = 5, 3
    notes.note_error()
    notes.note_error()
    assert (notes.errors, notes.seen) == (2, 10)
    notes.note_impossible()
    notes.note_impossible()
    reason = "identifier, length or time stamp that no frame has"
    assert (notes.broken, notes.broken_at) == (2, [(6, reason), (7, reason)])


@pytest.mark.parametrize("most", [8, 64])
@pytest.mark.parametrize("channel", ["can0", "v", "a_long_name"])
def test_a_frame_is_written_as_candump_writes_it(most, channel):
    draw = random.Random(most)
    frames = []
    for length in [*range(9), *range(12, most + 1, 4)]:
        for can_id in (0, 0x7FF, 0x123, EXTENDED, EXTENDED | 0x1FFFFFFF, EXTENDED | 0x18FEF123):
            stamp = draw.choice([0, 999, 1_000, 1_999_999_999, 1_700_000_000_123_456_789, 8_999_999_999_999_999_999])
            frames.append((stamp, can_id, draw.randbytes(length)))
    expected = b""
    for stamp, can_id, payload in frames:
        name = b"%08X" % (can_id & 0x1FFFFFFF) if can_id & EXTENDED else b"%03X" % can_id
        head = b"(%010d.%06d) %s " % (stamp // 10**9, stamp % 10**9 // 1000, channel.encode())
        expected += head + name + (b"##0" if len(payload) > 8 else b"#") + payload.hex().upper().encode() + b"\n"
    assert format_block(make(*frames), channel) == expected
    assert rows(parse_block(expected, 1, LogNotes())[0]) == [(t // 1000 * 1000, i, p) for t, i, p in frames]
    assert np.array_equal(format_block(make(*frames[:1]), channel), expected[: expected.index(b"\n") + 1])
