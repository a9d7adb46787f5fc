"""Ring of the recent decoded signals on disk; `export` makes tables of it.

Samples are collected in memory. About once a minute they are written as one block at the end of the newest *segment*:
few writes, all of them appended, which suits flash memory. When the ring is full, its oldest segment is deleted. A
power cut loses the minute in memory; a block that was written in part is recognised by its check sum and dropped. Every
block is complete in itself: it says which string has which columns. A reader therefore needs no config, and damage
costs only the damaged blocks.

A block::

    "bmsrec1", line feed: 8 bytes
    size         4 bytes, little-endian, of what is packed
    check sum    4 bytes, CRC-32 of the size and what is packed
    packed       zlib: one line of JSON, then for each input in turn its times (µs since the one before, uint32) and
                 its values (float32), both with their bytes sorted by weight, which packs to a third

float32 holds every raw value of a signal of 24 bits.
"""

import json
import math
import re
import struct
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.engine import Engine
from bms_gateway.engine.events import Decoded
from bms_gateway.errors import StateError
from bms_gateway.frames.vocabulary import CELL, INPUTS, WHOLE
from bms_gateway.store.dear import is_dear
from bms_gateway.store.files import append, make_directory, read_file, sync_directory
from bms_gateway.thermal import Floats

MAGIC = b"bmsrec1\n"
_HEAD = struct.Struct("<8sII")
_SIZE = struct.Struct("<I")
MAX_PACKED = 8 << 20
MAX_BLOCK = 16 << 20  # unpacked; a block of this program takes some hundred kilobytes
MOST_SAMPLES = 50_000  # of a block: packing takes some thirty bytes for each meanwhile
LONGEST_US = 1_800_000_000  # µs since a block's start fit into 32 bits
SEGMENTS = 16  # share of the ring that is deleted when it is full
SEGMENT_BYTES = (64 << 10, 4 << 20)  # a reader holds one in memory
_NAME = re.compile(r"recent-(\d{8,})")
_PLAIN = re.compile(r"[A-Za-z0-9_.-]{1,200}")  # names of strings and columns
_CELLS = "(?:[1-9][0-9]{0,2}|1000)"  # as many as a string model may have
_COLUMN = re.compile("|".join([INPUTS[q].column for q in WHOLE] + [INPUTS[q].column.format(_CELLS) for q in CELL]))

Layout = Mapping[str, Mapping[str, int | float]]
"""Columns of each string, by the names that tables have: the input that fills it (int), or its constant (float)."""


@dataclass(frozen=True, slots=True)
class _Tick:
    """Samples of a tick that wait to be written, at half their size, because a full bus sends a million a minute.

    Attributes
    ----------
    time_us : int
        Of the tick.
    offset_us : ndarray of int32 (K,)
        Of each sample, relative to `time_us`.
    input : ndarray of uint32 (K,)
    value : ndarray of float32 (K,)
    """

    time_us: int
    offset_us: NDArray[np.int32]
    input: NDArray[np.uint32]
    value: NDArray[np.float32]
    layout: Layout

    @classmethod
    def of(cls, event: Decoded, layout: Layout) -> "_Tick":
        time_us = event.time_ns // 1000
        offset = (event.sample_ns // 1000 - time_us).astype(np.int32)
        return cls(time_us, offset, event.input.astype(np.uint32), event.value.astype(np.float32), layout)


@dataclass(frozen=True, slots=True)
class Block:
    """Samples of about a minute.

    Attributes
    ----------
    layout : Layout
    samples : mapping of input to (time_us, value)
        Times in µs since 1970, not decreasing.
    place : tuple of int
        Number of its segment and its offset there, which give the order in which blocks were written.
    """

    layout: Layout
    samples: Mapping[int, tuple[NDArray[np.int64], Floats]]
    place: tuple[int, int] = (0, 0)

    @property
    def first_us(self) -> int:
        """Time of the oldest sample."""
        return min(int(t[0]) for t, _ in self.samples.values())

    @property
    def last_us(self) -> int:
        """Time of the newest sample."""
        return max(int(t[-1]) for t, _ in self.samples.values())


def layout_of(engine: Engine) -> Layout:
    """Assign the inputs of an engine to the columns of a string's table."""
    found: dict[str, dict[str, int | float]] = {}
    for string, wire in zip(engine.plan.strings, engine.wires, strict=True):
        columns: dict[str, int | float] = {INPUTS[q].column: i for q, i in wire.whole.items() if i >= 0}
        for q, inputs in wire.cells.items():
            columns |= {INPUTS[q].column.format(k): i for k, i in enumerate(inputs.tolist(), 1) if i >= 0}
        for q, value in wire.constants.items():
            columns.setdefault(INPUTS[q].column, float(value))
        found[string.name] = columns
    return found


class Recent:
    """Writer of the ring; one thread may `add` while another does `flush`.

    Parameters
    ----------
    directory : Path
        Made on the first write.
    megabytes : float
        What the ring may take on the disk, in 10⁶ bytes.
    """

    def __init__(self, directory: Path, megabytes: float) -> None:
        self.directory = directory
        self.limit = int(megabytes * 1e6)
        low, high = SEGMENT_BYTES
        self._segment = min(max(self.limit // SEGMENTS, low), high)
        self._waiting: deque[_Tick] = deque()
        self._engine: Engine | None = None
        self._layout: Layout = {}

    def add(self, event: Decoded, engine: Engine) -> None:
        """Add the samples of a tick; nothing is written."""
        if engine is not self._engine:
            self._engine, self._layout = engine, layout_of(engine)
        if len(event.sample_ns):
            self._waiting.append(_Tick.of(event, self._layout))

    def flush(self) -> StateError | None:
        """Write what was added.

        Returns
        -------
        StateError or None
            None: the samples are on the disk. Otherwise the reason as a value, because the service goes on; these
            samples are lost, earlier ones are not.
        """
        try:
            while ticks := self._take():
                self._write(packed(ticks))
        except OSError as e:
            self._waiting.clear()
            return StateError(f"{self.directory}: recent signals cannot be kept: {e.strerror}")
        return None

    def _take(self) -> list[_Tick]:
        """Take waiting ticks that fit into one block: of one layout, not too many, not too long."""
        ticks: list[_Tick] = []
        count = 0
        while self._waiting and count < MOST_SAMPLES:
            tick = self._waiting[0]
            if ticks and (tick.layout is not ticks[0].layout or not 0 <= tick.time_us - ticks[0].time_us <= LONGEST_US):
                break
            ticks.append(self._waiting.popleft())
            count += len(tick.input)
        return ticks

    def _write(self, block: bytes) -> None:
        make_directory(self.directory)
        segments = _segments(self.directory)
        sizes = [path.stat().st_size for path in segments]
        while segments and sum(sizes) + len(block) > self.limit:
            segments.pop(0).unlink(missing_ok=True)
            sizes.pop(0)
        if segments and sizes[-1] + len(block) <= self._segment:
            append(segments[-1], block)
            return
        last = _number(segments[-1]) if segments else 0
        append(self.directory / f"recent-{last + 1:08d}", block)
        sync_directory(self.directory)


def packed(ticks: list[_Tick]) -> bytes:
    """Pack ticks of one layout into a block."""
    time = np.concatenate([t.time_us + t.offset_us.astype(np.int64) for t in ticks])
    which = np.concatenate([t.input for t in ticks])
    value = np.concatenate([t.value for t in ticks])
    order = np.lexsort((time, which))
    time, which, value = time[order], which[order], value[order]
    start = int(time.min())
    inputs, first, counts = np.unique(which, return_index=True, return_counts=True)
    step = np.diff(time, prepend=start)
    step[first] = time[first] - start
    line = {
        "start_us": start,
        "inputs": inputs.tolist(),
        "counts": counts.tolist(),
        "strings": ticks[0].layout,
    }
    body = json.dumps(line, separators=(",", ":")).encode() + b"\n" + _sorted(step.astype("<u4")) + _sorted(value)
    content = zlib.compress(body, 6)
    size = len(content)
    return _HEAD.pack(MAGIC, size, zlib.crc32(content, zlib.crc32(_SIZE.pack(size)))) + content


def read_recent(directory: Path, problems: list[StateError]) -> Iterator[Block]:
    """Read the ring from the oldest block to the newest; the service may write at the same time.

    Parameters
    ----------
    directory : Path
    problems : list of StateError
        Gets a line for each segment of which something could not be used. A block cut off at the end is no problem:
        it is being written, or power failed.

    Yields
    ------
    Block
    """
    for path in _segments(directory):
        try:
            raw = read_file(path, SEGMENT_BYTES[1] + MAX_PACKED)
        except FileNotFoundError:
            continue  # the ring went on meanwhile
        except OSError as e:
            problems.append(StateError(f"{path}: cannot be read: {e.strerror}; left out"))
            continue
        if raw is None:
            problems.append(StateError(f"{path}: is no file; left out"))
            continue
        yield from _blocks(path, raw, problems)


def _blocks(path: Path, raw: bytes, problems: list[StateError]) -> Iterator[Block]:
    at = damaged = 0
    while at < len(raw):
        block, end = _block(raw, at)
        if block is not None:
            yield replace(block, place=(_number(path), at))
            at = end
            continue
        further = raw.find(MAGIC, at + 1)
        if further < 0:
            if not raw.startswith(MAGIC[: len(raw) - at], at) or end <= len(raw):
                damaged += len(raw) - at
            break
        damaged += further - at
        at = further
    if damaged:
        problems.append(
            StateError(f"{path}: {damaged} of {len(raw)} bytes are damaged or not of this program; left out")
        )


def _block(raw: bytes, at: int) -> tuple[Block | None, int]:
    """Unpack the block at an offset; None if it is not sound; and the end of the block, or where it would end."""
    if len(raw) - at < _HEAD.size:
        return None, at + _HEAD.size
    magic, size, check = _HEAD.unpack_from(raw, at)
    begin, end = at + _HEAD.size, at + _HEAD.size + size
    if magic != MAGIC or end > len(raw) or size > MAX_PACKED:
        return None, end
    content = memoryview(raw)[begin:end]
    if zlib.crc32(content, zlib.crc32(_SIZE.pack(size))) != check:
        return None, end
    try:
        unpack = zlib.decompressobj()
        line, _, body = unpack.decompress(content, MAX_BLOCK).partition(b"\n")
        if is_dear(line):
            return None, end
        return _unpacked(json.loads(line), body), end
    except (zlib.error, ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None, end


def _unpacked(line: Any, body: bytes) -> Block:
    counts = np.array(line["counts"], np.int64)
    N = int(counts.sum())
    wrong = (counts <= 0) | (counts > len(body) // 8)  # the sum of greater counts may overflow
    if len(body) != 8 * N or not N or wrong.any() or len(counts) != len(line["inputs"]):
        raise ValueError("not of the stated length")
    step, value = _unsorted(body[: 4 * N], "<u4"), _unsorted(body[4 * N :], "<f4")
    samples, at = {}, 0
    for i, n in zip(line["inputs"], counts.tolist(), strict=True):
        time = int(line["start_us"]) + np.cumsum(step[at : at + n], dtype=np.int64)
        samples[int(i)] = time, value[at : at + n].astype(np.float64)
        at += n
    return Block({_name(name): _columns(columns) for name, columns in line["strings"].items()}, samples)


def _columns(columns: Any) -> dict[str, int | float]:
    """Return the known columns of a string, as in `Layout`; raise `ValueError` for a source that is not a number."""
    found: dict[str, int | float] = {}
    for name, source in columns.items():
        if type(source) not in (int, float) or not math.isfinite(source):
            raise ValueError(f"the column {name!r} comes from no input and is no constant")
        if _COLUMN.fullmatch(_name(name)):
            found[name] = source
    return found


def _name(text: str) -> str:
    """Clean a name for a line of a table or of an error message."""
    if not _PLAIN.fullmatch(text):
        raise ValueError("no name")
    return text


def _sorted(a: NDArray[Any]) -> bytes:
    """Bytes of numbers, sorted by their significance."""
    return a.view(np.uint8).reshape(-1, a.itemsize).T.tobytes()


def _unsorted(raw: bytes, kind: str) -> NDArray[Any]:
    size = np.dtype(kind).itemsize
    return np.frombuffer(np.frombuffer(raw, np.uint8).reshape(size, -1).T.tobytes(), kind)


def _number(path: Path) -> int:
    return int(path.name.removeprefix("recent-"))


def _segments(directory: Path) -> list[Path]:
    """Segments from the oldest to the newest."""
    try:
        found = [(int(m[1]), path) for path in directory.iterdir() if (m := _NAME.fullmatch(path.name))]
    except (FileNotFoundError, NotADirectoryError):
        return []
    return [path for _, path in sorted(found)]
