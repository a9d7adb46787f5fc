"""candump's text, `(1700000000.000000) can0 0CFFC001#0011AABB`, to and from batches, column by column.

A block of text is translated to nibbles at once. The fields are then taken as 8-byte words at fixed distances from two
anchors of each line, its start (the stamp) and its first ``#`` (the id before it, the data after it), and a few shifts
and multiplications turn all words of a block into numbers. Lines of another layout (CAN FD, remote frames, odd stamps,
damaged lines) are few and are read one by one with a regular expression. The result for a line depends on this line
only, not on the division into blocks.
"""

import re
from collections import Counter
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.canframe import ERR
from bms_gateway.frames.batch import EXTENDED, FrameBatch

Words = NDArray[np.uint64]
Where = NDArray[np.intp]

PAD: Final = 32  # bytes around a block, so that no word leaves it
LAYOUTS: Final = 8  # lengths of stamps in one block (number of digits); lines with further lengths are read one by one
SHORTEST: Final = 9  # bytes; `(0.0) 0#` has 8, and no name of an interface
NAMED: Final = 20  # broken lines kept with number and text
LATEST_S: Final = 9_000_000_000  # year 2255; later seconds do not fit 64 bits of ns
CUT_SHORT: Final = "the gzip data end too early or are damaged: the rest is lost"

_BAD = 0x80
_NIBBLES = bytes(int(chr(c), 16) if chr(c) in "0123456789abcdefABCDEF" else _BAD for c in range(256))
_HIGH_BITS = np.uint64(0x8080_8080_8080_8080)
_FIRST_BYTES = np.array([(1 << 8 * n) - 1 for n in range(9)], np.uint64)
_LAST_3_BYTES = np.uint64(0xFFFF_FF00_0000_0000)

_INK = np.isin(np.arange(256), list(b" \t\n\r\v\f"), invert=True)
_STAMP = re.compile(rb"\((\d{1,12})\.(\d{1,9})\) ")
LINE = re.compile(
    rb"\((?P<s>\d{1,12})(?:\.(?P<fraction>\d{1,9}))?\)\s+(?P<interface>\S+)\s+(?P<id>[0-9A-Fa-f]{1,8})#"
    rb"(?:(?P<remote>R[0-9A-Fa-f]?)|#[0-9A-Fa-f](?P<fd>(?:[0-9A-Fa-f]{2}){0,64})|(?P<data>(?:[0-9A-Fa-f]{2}){0,8}))"
    rb"(?:_[0-9A-Fa-f])?(?:\s+[RT])?\s*"
)


@dataclass(slots=True)
class LogNotes:
    """Content of a log besides data frames.

    Attributes
    ----------
    frames : int
        Data frames given out.
    remote, errors : int
        Remote and error frames, skipped.
    broken : int
        Records that could not be read, skipped.
    broken_at : list of (int, str)
        The first of them: number of the line or record from 1, and its text or the reason.
    """

    frames: int = 0
    remote: int = 0
    errors: int = 0
    broken: int = 0
    broken_at: list[tuple[int, str]] = field(default_factory=list)

    @property
    def seen(self) -> int:
        """Frames of any kind."""
        return self.frames + self.remote + self.errors

    def note_error(self) -> None:
        """Count an error frame."""
        self.errors += 1

    def note_impossible(self) -> None:
        """Count a record that cannot be a frame."""
        self.note_broken(self.frames + self.broken + 1, "identifier, length or time stamp that no frame has")

    def note_broken(self, number: int, text: str) -> None:
        """Count a broken record and keep the first ones."""
        self.broken += 1
        if len(self.broken_at) < NAMED:
            self.broken_at.append((number, text))


@dataclass(slots=True)
class _Columns:
    """Fields of all lines of a block; only those of `good` lines mean anything."""

    time_ns: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    good: NDArray[np.bool_]


def parse_block(text: bytes, first_line: int, notes: LogNotes) -> tuple[FrameBatch, int]:
    r"""Read whole lines.

    Parameters
    ----------
    text : bytes
        Lines, the last one with or without its newline.
    first_line : int
        Number of the first line, for the notes.
    notes : LogNotes
        Added to.

    Returns
    -------
    FrameBatch
        The data frames in order; 64 bytes wide if one of them is longer than 8.
    int
        Number of lines.

    Examples
    --------
    >>> frames, lines = parse_block(b"(1700000000.000123) can0 123#AABB\n", 1, LogNotes())
    >>> frames.time_ns[0], frames.can_id[0] == 0x123, frames.data[0, :2].tolist()
    (np.int64(1700000000000123000), np.True_, [170, 187])
    """
    if text.isspace():  # nothing is computed for blank lines: a file may hold gibibytes of them
        return FrameBatch.empty(), text.count(b"\n") + (not text.endswith(b"\n"))
    padded = b"\n" * PAD + text + (b"" if text.endswith(b"\n") else b"\n") + b"\n" * PAD
    raw = np.frombuffer(padded, np.uint8)
    newline = np.flatnonzero(raw[PAD:-PAD] == 0x0A) + PAD
    start = np.concatenate([[PAD], newline[:-1] + 1])
    lines = len(start)
    number = np.arange(first_line, first_line + lines)
    if (newline - start < SHORTEST).any():  # a block holds many blank lines, and each would take a hundred bytes below
        start, newline, number = (x[_filled(raw, start, newline)] for x in (start, newline, number))
        if not len(start):
            return FrameBatch.empty(), lines
    end = _trim(raw, newline)
    marks = np.flatnonzero(raw[PAD:-PAD] == 0x23) + PAD
    if len(marks) != len(start) or not ((marks > start) & (marks < newline)).all():
        marks = np.append(marks, len(raw) - PAD)
        marks = marks[np.searchsorted(marks, start)]
    words = _words(padded.translate(_NIBBLES))

    time_ns, after_stamp = _stamps(padded, raw, words, start)
    can_id, before_id = _ids(raw, words, marks)
    data, length, whole = _payloads(words, marks, end)
    good = whole & (after_stamp < before_id)
    columns = _Columns(time_ns, can_id, length, data, good)
    if not good.all():
        _read_odd(padded, start, newline, columns, number, notes)
    error = columns.good & (columns.can_id & ERR != 0)
    if error.any():
        notes.errors += int(np.count_nonzero(error))
        columns.good &= ~error
    keep = slice(None) if columns.good.all() else np.flatnonzero(columns.good)
    frames = FrameBatch(columns.time_ns[keep], columns.can_id[keep], columns.length[keep], columns.data[keep])
    notes.frames += len(frames)
    return frames, lines


def interfaces_in(text: bytes) -> Counter[str]:
    r"""Count the lines of each interface.

    Examples
    --------
    >>> interfaces_in(b"(1.0) can1 123#AA\n(1.1) can1 123#AB\ncan0\n")
    Counter({'can1': 2})
    """
    found = map(LINE.fullmatch, text.splitlines())
    return Counter(m["interface"].decode("ascii", "replace") for m in found if m is not None)


def format_block(frames: FrameBatch, channel: str) -> bytes:
    r"""Write frames as candump does with `-L`.

    Parameters
    ----------
    frames : FrameBatch
        Stamps are cut to whole µs; frames longer than 8 bytes are written as CAN FD.
    channel : str

    Returns
    -------
    bytes
        One line per frame.

    Examples
    --------
    >>> one = FrameBatch(np.array([1_500_000]), np.array([0x123], np.uint32), np.array([1], np.uint8),
    ...     np.full((1, 8), 0xAB, np.uint8))
    >>> format_block(one, "can0")
    b'(0000000000.001500) can0 123#AB\n'
    """
    n, width = frames.data.shape
    name = channel.encode()
    head = b"(0000000000.000000) " + name + b" 00000000###0"
    at_id, at_mark = len(head) - 12, len(head) - 4
    text = np.empty((n, len(head) - 1 + 2 * width + 1), np.uint8)
    text[:, : len(head) - 1] = np.frombuffer(head[:-2] + b"0", np.uint8)
    text[:, -1] = 0x0A
    shown = np.ones(text.shape, np.bool_)

    micros = frames.time_ns // 1_000
    _write_digits(text[:, 1:11], micros // 1_000_000)
    _write_digits(text[:, 12:18], micros % 1_000_000)
    extended = frames.can_id & EXTENDED != 0
    id_bytes = (frames.can_id & 0x1FFF_FFFF).astype(">u4").view(np.uint8).reshape(n, 4)
    text[:, at_id:at_mark] = _hex(id_bytes)
    shown[:, at_id : at_mark - 3] = extended[:, None]
    shown[:, at_mark + 1 : at_mark + 3] = (frames.length > 8)[:, None]
    text[:, at_mark + 3 : -1] = _hex(frames.data)
    shown[:, at_mark + 3 : -1] = np.arange(2 * width) < 2 * frames.length.astype(np.intp)[:, None]
    return text[shown].tobytes()


def _write_digits(columns: NDArray[np.uint8], number: NDArray[np.int64]) -> None:
    for k in range(columns.shape[1] - 1, -1, -1):
        number, digit = np.divmod(number, 10)
        columns[:, k] = digit + 0x30


def _hex(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    digits = np.frombuffer(b"0123456789ABCDEF", np.uint8)
    return np.stack([digits[data >> 4], digits[data & 15]], axis=-1).reshape(len(data), 2 * data.shape[1])


def _filled(raw: NDArray[np.uint8], start: Where, newline: Where) -> NDArray[np.bool_]:
    """Select the lines that contain more than white space."""
    ink = np.cumsum(_INK[raw], dtype=np.intp)
    return np.asarray(ink[newline - 1] > ink[start - 1])


def _trim(raw: NDArray[np.uint8], newline: Where) -> Where:
    """End of the data: before a carriage return, and before the direction that some programs write."""
    end: Where = newline - (raw[newline - 1] == 0x0D)
    last = raw[end - 1]
    end -= 2 * (((last == 0x52) | (last == 0x54)) & (raw[end - 2] == 0x20))
    return end


def _words(nibbles: bytes) -> Words:
    """View the 8 bytes at every position as one little-endian word."""
    return np.ndarray((len(nibbles) - 7,), "<u8", nibbles, strides=(1,))


def _decimal(words: Words, digits: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Value of the first 1…8 digits of each word, and whether they are digits; three multiplications add neighbours."""
    v = words << np.uint64(8 * (8 - digits))
    valid = ((v + np.uint64(0x7676_7676_7676_7676)) | v) & _HIGH_BITS == 0  # 10…15 carry into the high bit
    v = (v * np.uint64(2561)) >> np.uint64(8) & np.uint64(0x00FF_00FF_00FF_00FF)
    v = (v * np.uint64(6_553_601)) >> np.uint64(16) & np.uint64(0x0000_FFFF_0000_FFFF)
    v = (v * np.uint64(42_949_672_960_001)) >> np.uint64(32)
    return v.astype(np.int64), valid


def _number(words: Words, at: Where, digits: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Value of 1…16 digits from `at` on."""
    if digits <= 8:
        return _decimal(words[at], digits)
    high, high_valid = _decimal(words[at], digits - 8)
    low, low_valid = _decimal(words[at + (digits - 8)], 8)
    return high * 100_000_000 + low, high_valid & low_valid


def _pairs(nibbles: Words) -> NDArray[np.uint8]:
    """Join 8 nibbles to 4 bytes, (N, 4)."""
    joined = (nibbles << np.uint64(4) | nibbles >> np.uint64(8)) & np.uint64(0x00FF_00FF_00FF_00FF)
    return joined.astype("<u8", copy=False).view(np.uint8).reshape(-1, 8)[:, ::2]


def _stamps(padded: bytes, raw: NDArray[np.uint8], words: Words, start: Where) -> tuple[NDArray[np.int64], Where]:
    """Stamps, and the position after each; for an odd stamp, a position beyond the block."""
    time_ns = np.zeros(len(start), np.int64)
    after = np.full(len(start), len(raw), np.intp)
    rest = np.arange(len(start))
    for _ in range(LAYOUTS):
        rest = rest[raw[start[rest]] == 0x28]
        if not len(rest):
            break
        first = _STAMP.match(padded, int(start[rest[0]]))
        if first is None:
            rest = rest[1:]
            continue
        whole, fraction = len(first[1]), len(first[2])
        at = start[rest]
        fits = (raw[at + whole + 1] == 0x2E) & (raw[at + whole + fraction + 2] == 0x29)
        fits &= raw[at + whole + fraction + 3] == 0x20
        seconds, seconds_valid = _number(words, at + 1, whole)
        parts, parts_valid = _number(words, at + whole + 2, fraction)
        fits &= seconds_valid & parts_valid & (seconds < LATEST_S)
        here = rest[fits]
        time_ns[here] = (seconds * 1_000_000_000 + parts * 10 ** (9 - fraction))[fits]
        after[here] = at[fits] + whole + fraction + 4
        rest = rest[~fits][int(not fits[0]) :]
    return time_ns, after


def _ids(raw: NDArray[np.uint8], words: Words, marks: Where) -> tuple[NDArray[np.uint32], Where]:
    """Ids with 3 or 8 digits, and the position of the blank before each; 0 for an odd id."""
    v = words[marks - 8]
    long = raw[marks - 9] == 0x20
    short = raw[marks - 4] == 0x20
    v = np.where(short, v & _LAST_3_BYTES, v)
    value = np.ascontiguousarray(_pairs(v)).view(">u4").reshape(-1).astype(np.uint32)
    valid = (v & _HIGH_BITS == 0) & (short & (value <= 0x7FF) | long & ~short & (value < EXTENDED >> 1))
    before = np.where(valid, marks - np.where(short, 4, 9), 0)
    return np.where(short, value, value | np.uint32(EXTENDED)), before


def _payloads(words: Words, marks: Where, end: Where) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """Payloads of up to 8 bytes, their lengths, and whether they are complete."""
    digits = end - marks - 1
    fits = (digits >= 0) & (digits <= 16) & (digits & 1 == 0)
    digits = np.where(fits, digits, 0)
    low = words[marks + 1] & _FIRST_BYTES[np.minimum(digits, 8)]
    high = words[marks + 9] & _FIRST_BYTES[np.maximum(digits - 8, 0)]
    data = np.concatenate([_pairs(low), _pairs(high)], axis=1)
    return data, (digits >> 1).astype(np.uint8), fits & ((low | high) & _HIGH_BITS == 0)


def _read_odd(padded: bytes, start: Where, newline: Where, columns: _Columns, number: Where, notes: LogNotes) -> None:
    """Read the lines that the columns did not fit, one by one, into `columns`."""
    for i in np.flatnonzero(~columns.good & (newline > start)).tolist():
        line = padded[start[i] : newline[i]]
        if not line.strip():
            continue
        found = LINE.fullmatch(line)
        extended = found is not None and len(found["id"]) > 3
        can_id = int(found["id"], 16) if found else 0
        if found is None or int(found["s"]) >= LATEST_S or can_id > (0x3FFF_FFFF if extended else 0x7FF):
            notes.note_broken(int(number[i]), line[:80].decode("ascii", "replace"))
            continue
        if found["remote"] is not None:
            notes.remote += 1
            continue
        payload = bytes.fromhex((found["fd"] if found["data"] is None else found["data"]).decode())
        if len(payload) > columns.data.shape[1]:
            columns.data = np.pad(columns.data, ((0, 0), (0, 64 - columns.data.shape[1])))
        columns.time_ns[i] = int(found["s"]) * 1_000_000_000 + int((found["fraction"] or b"0").ljust(9, b"0"))
        columns.can_id[i] = can_id | (EXTENDED if extended else 0)
        columns.length[i] = len(payload)
        columns.data[i] = 0
        columns.data[i, : len(payload)] = np.frombuffer(payload, np.uint8)
        columns.good[i] = True
