"""Frames as the kernel and as python-can have them: to batches and back, at the limits of what a bus carries."""

import math

import can
import numpy as np
import pytest

from bms_gateway.bus.canframe import ROW, error_classes, from_wire, to_batch, to_wire
from bms_gateway.bus.message import to_batch as from_messages
from bms_gateway.bus.message import to_message
from bms_gateway.bus.port import Counters
from bms_gateway.frames.batch import EXTENDED
from tests.bus.frames import make, rows

SECOND = 1_000_000_000
LATEST_S = 9_000_000_000


def kernel_rows(*frames: tuple[int, int, bytes, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Buffers, sizes and times of (id, length, bytes after the header, size of the datagram)."""
    table = np.zeros(len(frames), ROW)
    for row, (can_id, length, data, _) in zip(table, frames, strict=True):
        row["can_id"], row["length"] = can_id, length
        row["data"][: len(data)] = np.frombuffer(data, np.uint8)
    sizes = np.array([f[3] for f in frames], np.uint32)
    return table, sizes, np.arange(len(frames), dtype=np.int64)


@pytest.mark.parametrize(
    ("frame", "counted"),
    [
        ((0x123, 8, b"12345678", 16), "received"),
        ((0x123, 9, b"123456789", 16), "malformed"),
        ((0x123, 8, b"12345678", 17), "malformed"),
        ((0x123, 64, bytes(range(64)), 72), "received"),
        ((0x123, 65, bytes(range(64)), 72), "malformed"),
        ((0x123, 3, b"abc", 72), "received"),
        ((0x4000_0123, 2, b"", 16), "remote"),
        ((0x4000_0123, 9, b"", 16), "malformed"),
        ((0x2000_0008, 8, b"", 16), "errors"),
        ((0x6000_0008, 8, b"", 16), "errors"),
        ((0x2000_0008, 9, b"", 16), "malformed"),
    ],
)
@pytest.mark.parametrize("beside", [[], [(0x7, 2, b"\x01\x02\xff", 16)]])
def test_what_no_bus_carries_is_counted_and_is_no_data(frame, counted, beside) -> None:
    counters = Counters()
    batch, errors = to_batch(*kernel_rows(frame, *beside), counters)
    kept = [frame] if counted == "received" else []
    assert [(c, d) for _, c, d in rows(batch)] == [(c, d[:n]) for c, n, d, _ in [*kept, *beside]]
    assert batch.time_ns.tolist() == list(range(1 - len(kept), 1 + len(beside)))
    assert counters.received == len(kept) + len(beside)
    assert counters.malformed == (counted == "malformed")
    assert counters.remote == (counted == "remote")
    assert counters.errors == ({"protocol": 1} if counted == "errors" else {})
    assert errors == (["protocol"] if counted == "errors" else [])
    assert batch.data.shape[1] == (64 if kept and frame[3] == 72 else 8)


def test_an_error_frame_may_be_of_several_classes_or_of_none() -> None:
    bits = {1: "tx-timeout", 2: "lost-arbitration", 4: "controller", 8: "protocol", 16: "transceiver"}
    bits |= {32: "no-acknowledge", 64: "bus-off", 128: "bus-error", 256: "restarted"}
    for bit, name in bits.items():
        assert error_classes(0x2000_0000 | bit) == [name]
    assert error_classes(0x2000_01FF) == list(bits.values())
    assert error_classes(0x2000_0000) == error_classes(0x2000_0200) == ["other"]


@pytest.mark.parametrize(("length", "size"), [(0, 16), (8, 16), (9, 72), (64, 72)])
def test_a_frame_takes_as_many_bytes_as_its_kind_and_comes_back(length: int, size: int) -> None:
    payload = bytes(range(1, length + 1))
    for can_id in (0x7FF, 0x1FFF_FFFF | EXTENDED):
        wires = to_wire(make((0, can_id, payload), (1, 5, b"ab")))
        assert [len(w) for w in wires] == [size, 16]
        assert [from_wire(w) for w in wires] == [(can_id, payload), (5, b"ab")]


def message(can_id: int = 1, at: float = 5.0, data: bytes = b"", extended: bool = False, **more: bool) -> can.Message:
    made = can.Message(is_extended_id=extended, timestamp=at, data=data, is_fd=len(data) > 8, **more)
    made.arbitration_id = can_id
    return made


@pytest.mark.parametrize(
    ("one", "possible"),
    [
        (message(0), True),
        (message(0x1FFF_FFFF, extended=True), True),
        (message(0x2000_0000, extended=True), False),
        (message(-1), False),
        (message(at=math.nan), False),
        (message(at=LATEST_S - 1.0), True),
        (message(at=LATEST_S), False),
        (message(at=-LATEST_S), False),
        (message(at=LATEST_S + 1.0), False),
        (message(at=-LATEST_S + 1.0), True),
        (message(at=-LATEST_S - 1.0), False),
        (message(data=bytes(8)), True),
        (message(data=bytes(9)), True),
        (message(data=bytes(64)), True),
    ],
)
def test_messages_that_no_bus_carries_are_counted(one: can.Message, possible: bool) -> None:
    counters = Counters()
    batch = from_messages([one, message(7, data=b"ab")], counters)
    assert (len(batch), counters.malformed) == (1 + possible, 1 - possible)
    assert (batch.can_id[-1], batch.length[-1], batch.data[-1, :2].tobytes()) == (7, 2, b"ab")
    if possible:
        assert batch.can_id[0] == one.arbitration_id | (EXTENDED if one.is_extended_id else 0)
        assert batch.length[0] == len(one.data)
    assert batch.data.shape[1] == (64 if len(one.data) > 8 else 8)


def test_a_message_of_more_than_a_frame_holds_is_none() -> None:
    long = message(data=bytes(64))
    long.data = bytearray(65)
    counters = Counters()
    assert len(from_messages([long], counters)) == 0
    assert counters.malformed == 1


def test_stamps_are_moved_and_rounded_to_whole_microseconds() -> None:
    batch = from_messages([message(at=5.000_001_4), message(at=5.000_001_6)], Counters(), 100.0)
    assert batch.time_ns.tolist() == [105_000_001_000, 105_000_002_000]
    counters = Counters()
    assert len(from_messages([message(at=LATEST_S - 50.0)], counters, 100.0)) == 0
    assert len(from_messages([message(at=LATEST_S + 50.0)], counters, -100.0)) == 1
    assert counters.malformed == 1


def test_error_and_remote_messages_are_counted_each_as_one() -> None:
    counters = Counters()
    told = [message(is_error_frame=True), message(is_remote_frame=True), message(3), message(is_error_frame=True)]
    assert from_messages(told, counters).can_id.tolist() == [3]
    assert (counters.errors, counters.remote) == ({"other": 2}, 1)
    assert len(from_messages([message(4)], counters)) == 1
    assert (counters.errors, counters.remote) == ({"other": 2}, 1)


@pytest.mark.parametrize("length", [0, 8, 9, 64])
@pytest.mark.parametrize("can_id", [0x7FF, 0x1FFF_FFFF | EXTENDED, EXTENDED])
def test_a_frame_becomes_a_message_of_its_kind(can_id: int, length: int) -> None:
    payload = bytes(range(length))
    made = to_message(can_id, payload)
    assert (made.arbitration_id, made.is_extended_id) == (can_id & 0x1FFF_FFFF, can_id >= EXTENDED)
    assert (bytes(made.data), made.is_fd) == (payload, length > 8)
