"""End-to-end protection of frames: AUTOSAR E2E profile 1, variant 1A, for many frames at once.

CRC in byte 0, a counter 0…14 in the low half of byte 1. The CRC has the polynomial of CRC-8-SAE-J1850 (0x1D) with
start and final value zero; it runs over the data ID, low byte first, and then over bytes 1…7. The ID makes a frame
under a foreign identifier fail. With a zero start the CRC is linear: the XOR of one table entry per pair of bytes.

References
----------
AUTOSAR, "Specification of SW-C End-to-End Communication Protection Library", profile 1; "Specification of CRC
Routines", CRC-8-SAE-J1850.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["COUNTER_STATES", "MAX_DELTA", "check", "crc8", "id_crc", "protect"]

POLYNOMIAL = 0x1D
COUNTER_STATES = 15
"""Values of the counter: 15 is never sent, so that a frame of all ones cannot pass."""
MAX_DELTA = 3
"""Largest step of the counter that counts as lost frames and not as a wrong sequence (two lost in a row)."""
PROTECTED_LENGTH = 8
"""Protected messages have eight bytes; a frame of another length fails."""


def _byte_table() -> NDArray[np.uint8]:
    crc: NDArray[np.uint8] = np.arange(256, dtype=np.uint8)
    for _ in range(8):
        top = (crc & 0x80) != 0
        crc = (crc << np.uint8(1)) ^ np.where(top, np.uint8(POLYNOMIAL), np.uint8(0))
    return crc


_TABLE = _byte_table()


def crc8(data: bytes, start: int = 0xFF, final: int = 0xFF) -> int:
    """CRC of some bytes with the SAE J1850 polynomial; with zero `start` and `final`, that of profile 1.

    Examples
    --------
    >>> hex(crc8(b"123456789"))
    '0x4b'
    """
    crc = start
    for byte in data:
        crc = int(_TABLE[crc ^ byte])
    return crc ^ final


def _weights() -> list[NDArray[np.uint8]]:
    """Item k: contribution to the CRC of a byte that is followed by k others."""
    weights = [_TABLE]
    for _ in range(PROTECTED_LENGTH):
        weights.append(_TABLE[weights[-1]])
    return weights


_WEIGHTS = _weights()
_ID_LOW, _ID_HIGH = _WEIGHTS[PROTECTED_LENGTH], _WEIGHTS[PROTECTED_LENGTH - 1]


def _pair_tables() -> NDArray[np.uint8]:
    """Row j: contribution of bytes 2j and 2j + 1, as a little-endian number, to the CRC; byte 0 contributes nothing."""
    low, high = np.arange(1 << 16) & 0xFF, np.arange(1 << 16) >> 8
    rows = []
    for j in range(PROTECTED_LENGTH // 2):
        behind = PROTECTED_LENGTH - 2 - 2 * j
        rows.append(_WEIGHTS[behind][high] ^ (_WEIGHTS[behind + 1][low] if j else np.uint8(0)))
    return np.array(rows)


_PAIRS = _pair_tables()


def id_crc(data_id: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Part of the CRC that comes from the data ID: constant per message."""
    crc: NDArray[np.uint8] = _ID_LOW.take(data_id & 0xFF) ^ _ID_HIGH.take((data_id >> 8) & 0xFF)
    return crc


def _crc(word: NDArray[np.uint64], of_id: NDArray[np.uint8]) -> NDArray[np.uint8]:
    pairs = word.astype("<u8", copy=False).view("<u2").reshape(-1, 4)
    crc = of_id.copy()
    for j, table in enumerate(_PAIRS):
        crc ^= table.take(pairs[:, j])
    return crc


def check(
    word: NDArray[np.uint64], length: NDArray[np.uint8], of_id: NDArray[np.uint8]
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Read the counters and find the intact frames: right length, right check sum, counter in 0…14.

    Parameters
    ----------
    word : ndarray of uint64 (N,)
        First eight bytes as a little-endian number.
    length : ndarray of uint8 (N,)
    of_id : ndarray of uint8 (N,)
        From `id_crc`.

    Returns
    -------
    counter : ndarray of uint8 (N,)
    ok : ndarray of bool (N,)
    """
    low = word.astype(np.uint16)
    counter = ((low >> np.uint16(8)) & np.uint16(0x0F)).astype(np.uint8)
    ok: NDArray[np.bool_] = _crc(word, of_id) == low.astype(np.uint8)
    ok &= length == PROTECTED_LENGTH
    ok &= counter < COUNTER_STATES
    return counter, ok


def protect(data: NDArray[np.uint8], counter: NDArray[np.uint8], of_id: NDArray[np.uint8]) -> None:
    """Write counter and check sum into frames, in place.

    Parameters
    ----------
    data : ndarray of uint8 (N, 8)
        Byte 0 is overwritten, and the low half of byte 1.
    counter : ndarray of uint8 (N,)
    of_id : ndarray of uint8 (N,)
        From `id_crc`.
    """
    data[:, 1] = (data[:, 1] & 0xF0) | counter
    data[:, 0] = _crc(np.ascontiguousarray(data).view("<u8").ravel(), of_id)
