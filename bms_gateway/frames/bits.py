"""Positions of signals in a payload, as numpy tables for reading them from, and writing them to, many frames.

A payload of 8·K bytes is read as K little-endian 64-bit words, followed, if any signal is big-endian, by the same bytes
as K big-endian words. In one of these two readings each signal is one run of bits, low bit first, over at most two
words. So one shift and one mask serve both byte orders, and a second shift serves the few signals that cross words.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BitFields", "Place", "words_of"]

WORD = 64
U64 = NDArray[np.uint64]
Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Place:
    """Start bit (as a DBC counts it), length and byte order of one signal."""

    start: int
    size: int
    big_endian: bool = False
    signed: bool = False

    @property
    def first_bit(self) -> int:
        """Least significant bit counted along the reading of its byte order (big-endian: from the end of the run)."""
        if self.big_endian:
            return 8 * (self.start // 8) + 7 - self.start % 8
        return self.start

    @property
    def bytes_needed(self) -> int:
        """Length a payload must have to hold the signal."""
        return (self.first_bit + self.size + 7) // 8

    @property
    def bits(self) -> frozenset[int]:
        """Its bits, each as eight times its byte plus its position within the byte, the least significant 0.

        Examples
        --------
        >>> sorted(Place(3, 12, big_endian=True).bits)
        [0, 1, 2, 3, 8, 9, 10, 11, 12, 13, 14, 15]
        """
        run = range(self.first_bit, self.first_bit + self.size)
        return frozenset(8 * (k // 8) + 7 - k % 8 for k in run) if self.big_endian else frozenset(run)


@dataclass(frozen=True, slots=True)
class BitFields:
    """F places as arrays.

    Attributes
    ----------
    word, shift, mask : ndarray (F,)
        Word that holds the lowest bit, its position there, and the mask of the value after shifting.
    word2, shift2 : ndarray (F,)
        For a signal that crosses words: the word of the upper bits and their shift upwards; 0 otherwise.
    sign : ndarray of uint64 (F,)
        Weight of the sign bit, 0 for unsigned.
    needs : ndarray of int64 (F,)
        Bytes that a payload must have.
    words : int
        K, 64-bit words of the longest payload.
    stride : int
        K, or 2·K if a big-endian reading is needed.
    """

    word: Index
    shift: U64
    mask: U64
    word2: Index
    shift2: U64
    crosses: NDArray[np.bool_]
    sign: U64
    needs: NDArray[np.int64]
    words: int
    stride: int
    any_crosses: bool
    any_signed: bool

    @classmethod
    def build(cls, places: Sequence[Place], words: int, *, big_endian: bool | None = None) -> "BitFields":
        """Tabulate `places` in payloads of `words` 64-bit words; `big_endian` forces the second reading on or off."""
        has_big = any(p.big_endian for p in places) if big_endian is None else big_endian
        rows = [_run(p, words) for p in places]
        word, shift, word2, shift2 = (np.array([r[i] for r in rows], np.int64) for i in range(4))
        sign = np.array([1 << (p.size - 1) if p.signed else 0 for p in places], np.uint64)
        crosses = shift2 > 0
        return cls(
            word=word.astype(np.intp),
            shift=shift.astype(np.uint64),
            mask=np.array([(1 << p.size) - 1 for p in places], np.uint64),
            word2=word2.astype(np.intp),
            shift2=shift2.astype(np.uint64),
            crosses=crosses,
            sign=sign,
            needs=np.array([p.bytes_needed for p in places], np.int64),
            words=words,
            stride=2 * words if has_big else words,
            any_crosses=bool(crosses.any()),
            any_signed=bool(sign.any()),
        )

    def raw(self, words: U64, row: Index, field: Index) -> U64:
        """Raw bits of sample i: field `field[i]` of payload `row[i]`; signed ones are extended to 64 bits.

        Parameters
        ----------
        words : ndarray of uint64 (n · stride,)
            Payloads as `words_of` lays them out.
        row, field : ndarray of intp (m,)

        Returns
        -------
        ndarray of uint64 (m,)
            Two's complement: view as int64 where the signal is signed.
        """
        at = row if self.stride == 1 else row * self.stride + self.word.take(field)
        value: U64 = words.take(at)
        value >>= self.shift.take(field)
        if self.any_crosses:
            part = (self.crosses.take(field)).nonzero()[0]
            f = field[part]
            value[part] |= words.take(row[part] * self.stride + self.word2.take(f)) << self.shift2.take(f)
        value &= self.mask.take(field)
        if self.any_signed:
            sign = self.sign.take(field)
            value ^= sign
            value -= sign
        return value


def _run(place: Place, words: int) -> tuple[int, int, int, int]:
    """Word and shift of the low bits, word and shift of the upper bits (0, 0 where one word holds all)."""
    first = place.first_bit
    if not place.big_endian:
        word, shift = divmod(first, WORD)
        crosses = shift + place.size > WORD
        return (word, shift, word + 1, WORD - shift) if crosses else (word, shift, 0, 0)
    # in the big-endian words the run starts at its most significant bit and its lowest one ends in the last word
    last = first + place.size - 1
    word, shift = words + last // WORD, WORD - 1 - last % WORD
    crosses = first // WORD != last // WORD
    return (word, shift, word - 1, WORD - shift) if crosses else (word, shift, 0, 0)


def words_of(data: NDArray[np.uint8], frame: Index, words: int, stride: int) -> U64:
    """Lay out the payloads of some frames as 64-bit words.

    Parameters
    ----------
    data : ndarray of uint8 (N, W)
    frame : ndarray of intp (n,)
        Which of them.
    words, stride : int
        As in `BitFields`; a narrower payload is padded with zeros, a wider one cut.

    Returns
    -------
    ndarray of uint64 (n · stride,)
    """
    width = 8 * words
    if data.shape[1] != width:
        fitted = np.zeros((len(data), width), np.uint8)
        kept = min(width, data.shape[1])
        fitted[:, :kept] = data[:, :kept]
        data = fitted
    little = np.ascontiguousarray(data).view("<u8").astype(np.uint64, copy=False)
    if words == 1 and stride == 1:
        return little.ravel().take(frame)
    little = little.take(frame, axis=0)
    if stride == words:
        return little.reshape(-1)
    both = np.empty((len(frame), stride), np.uint64)
    both[:, :words] = little
    both[:, words:] = little.byteswap()
    return both.reshape(-1)
