"""Check sums and counters against published check values and an independent bit-by-bit implementation."""

import random

import numpy as np
import pytest

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.counter import CounterGuard
from bms_gateway.frames.database import Database
from bms_gateway.frames.decode import decode
from bms_gateway.frames.e2e import check, crc8, id_crc, protect
from bms_gateway.frames.encode import Encoder
from bms_gateway.frames.quality import Quality
from tests.frames.payloads import OWN, loaded


def whole(data: np.ndarray, data_id: int, length: int = 8) -> bool:
    return bool(check(data.view("<u8").ravel(), np.array([length], np.uint8), id_crc(np.array([data_id])))[1][0])


def by_bits(data: bytes, start: int, final: int) -> int:
    """CRC of polynomial x^8 + x^4 + x^3 + x^2 + 1 as long division, one bit after the other."""
    register = start
    for byte in data:
        for k in range(7, -1, -1):
            top = (register >> 7) & 1
            register = (register << 1) & 0xFF
            if top ^ ((byte >> k) & 1):
                register ^= 0x1D
    return register ^ final


@pytest.mark.parametrize(
    ("data", "crc"),
    [
        # AUTOSAR Specification of CRC Routines, CRC-8-SAE-J1850, test vectors
        ("00000000", 0x59),
        ("F20183", 0x37),
        ("0FAA0055", 0x79),
        ("00FF5511", 0xB8),
        ("332255AABBCCDDEEFF", 0xCB),
        ("926B55", 0x8C),
        ("FFFFFFFF", 0x74),
        (b"123456789".hex(), 0x4B),
    ],
)
def test_the_polynomial_is_that_of_sae_j1850(data: str, crc: int) -> None:
    assert crc8(bytes.fromhex(data)) == crc
    assert by_bits(bytes.fromhex(data), 0xFF, 0xFF) == crc


def test_profile_1_starts_and_ends_with_zero() -> None:
    # the same parameters are catalogued as CRC-8/GSM-A, check value 0x37
    assert crc8(b"123456789", 0, 0) == 0x37 == by_bits(b"123456789", 0, 0)


def test_frames_are_protected_as_a_bitwise_implementation_does() -> None:
    rng = random.Random(3)
    for _ in range(200):
        payload, data_id, counter = rng.randbytes(8), rng.randrange(1 << 16), rng.randrange(15)
        data = np.frombuffer(payload, np.uint8).reshape(1, 8).copy()
        protect(data, np.array([counter], np.uint8), id_crc(np.array([data_id])))
        expected = bytearray(payload)
        expected[1] = payload[1] & 0xF0 | counter
        expected[0] = by_bits(bytes([data_id & 0xFF, data_id >> 8, *expected[1:]]), 0, 0)
        assert data.tobytes() == bytes(expected)
        assert whole(data, data_id)


def test_every_single_bit_error_and_a_foreign_id_are_found() -> None:
    data = np.zeros((1, 8), np.uint8)
    protect(data, np.array([7], np.uint8), id_crc(np.array([0xFF51])))
    for bit in range(64):
        broken = data.copy()
        broken[0, bit // 8] ^= 1 << bit % 8
        assert not whole(broken, 0xFF51)
    assert not whole(data, 0xFF52)
    assert not whole(data, 0xFF51, 7)


def surfaces(n: int) -> tuple[Database, FrameBatch]:
    """Frames of two multiplexer values in turn, n each."""
    db = loaded(OWN)
    encoder = Encoder(db, ["string_1_surface"])
    rows = np.tile([encoder.row("string_1_surface", 0), encoder.row("string_1_surface", 1)], n)
    can_id, length, data = encoder.encode(rows, np.full((2 * n, encoder.width), 25.0))
    return db, FrameBatch(np.arange(2 * n, dtype=np.int64), can_id, length, data)


def test_a_broken_frame_costs_its_own_samples_only() -> None:
    db, batch = surfaces(10)
    table = db.compile([f"string_1_surface.surface_{c:02d}" for c in range(1, 7)])
    assert (decode(table, batch).flag == Quality.GOOD).all()
    batch.data[5, 3] ^= 0x10
    samples = decode(table, batch)
    assert set(samples.frame[samples.flag == Quality.CRC]) == {5}
    assert (samples.flag == Quality.CRC).sum() == 3


@pytest.mark.parametrize("cut", [1, 2, 3, 7, 100])
@pytest.mark.plain_cases(2)
def test_lost_frames_pass_repeated_and_jumping_ones_do_not_however_batches_are_cut(cut: int) -> None:
    db, batch = surfaces(40)
    table = db.compile([f"string_1_surface.surface_{c:02d}" for c in range(1, 7)])
    # of multiplexer value 0 (even frames): 6 twice, two lost before 16, seven lost before 40
    order = [i for i in range(80) if i not in (10, 12, *range(26, 40, 2))]
    order.insert(order.index(6) + 1, 6)
    sent = FrameBatch(batch.time_ns[order], batch.can_id[order], batch.length[order], batch.data[order])
    guard = CounterGuard(table)
    bad = []
    for start in range(0, len(sent), cut):
        part = sent[start : start + cut]
        samples = decode(table, part)
        flag = guard.update(samples)
        bad += [start + f for f in np.unique(samples.frame[flag == Quality.COUNTER])]
    assert bad == [order.index(6) + 1, order.index(40)]
