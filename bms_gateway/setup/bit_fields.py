"""Cuts frames into fields of usual sizes: bytes, pairs of bytes, twelve bits that begin at a nibble; by pages too."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.bits import Place
from bms_gateway.setup.bit_contradictions import BOTH_ENDS, NEAR, SMOOTHER
from bms_gateway.setup.intervals import silences
from bms_gateway.thermal import Floats

FEWEST: Final = 20
"""Least number of frames of a message, or of one page of it, whose bits are judged."""
MOST_PAGES: Final = 64
FEWEST_OF_PAGE: Final = 12
STAYS: Final = 0.3
SELECTORS: Final = (Place(0, 8), Place(12, 4), Place(8, 4), Place(4, 4), Place(0, 4))
"""Places of the bits that may select the meaning of the others: the first byte, or half of one of the first two beside
a counter or a check sum."""
OF_ITS_OWN: Final = 0.5


@dataclass(slots=True)
class Field:
    """Some bits of a message, or of one page of it.

    Attributes
    ----------
    can_id : int
    page : int or None
        Value of `selector`, if these bits select the meaning of the others.
    place : Place
    t, x : ndarray (n,)
        Seconds from the begin; raw values.
    silent_s : float
        Part of the time from the first to the last sample in which the bus had no frame.
    selector : Place
    """

    can_id: int
    page: int | None
    place: Place
    t: Floats
    x: Floats
    silent_s: float = 0.0
    selector: Place = SELECTORS[0]

    @property
    def rate_Hz(self) -> float:
        """Samples per second while the bus is not silent; 0 if all samples have the same time stamp."""
        seconds = float(self.t[-1] - self.t[0]) - self.silent_s
        return (len(self.t) - 1) / seconds if seconds > 0.0 else 0.0

    def overlaps(self, other: "Field") -> bool:
        """Whether both fields contain the same bits of one message."""
        if self.can_id != other.can_id or self.page != other.page:
            return False
        return not self.place.bits.isdisjoint(other.place.bits)


def name_of(f: Field) -> str:
    """Say where the bits are.

    Examples
    --------
    >>> name_of(Field(0x1DB, None, Place(7, 12, True), np.zeros(1), np.zeros(1)))
    '0x1DB bits 7|12@0+'
    """
    page = "" if f.page is None else f" page {f.page}"
    order, sign = int(not f.place.big_endian), "-" if f.place.signed else "+"
    return f"0x{f.can_id & 0x1FFFFFFF:X}{page} bits {f.place.start}|{f.place.size}@{order}{sign}"


def fields_of(frames: FrameBatch) -> Iterator[Field]:
    """Cut all messages that are frequent enough."""
    t = (frames.time_ns - frames.time_ns[0]) * 1e-9
    silent = np.cumsum(silences(frames.time_ns) * 1e-9)
    order = np.argsort(frames.can_id, kind="stable")
    ids, starts = np.unique(frames.can_id[order], return_index=True)
    for can_id, part in zip(ids.tolist(), np.split(order, starts[1:]), strict=True):
        length = int(np.median(frames.length[part]))
        rows = part[frames.length[part] == length]
        if len(rows) < FEWEST or length < 1:
            continue
        data = frames.data[rows, :length].astype(np.int64)
        selector, pages = _selected(data)
        chosen: list[int | None] = [*pages] or [None]
        for page in chosen:
            of_it = np.ones(len(data), np.bool_) if page is None else _bits(data, selector) == page
            if of_it.sum() >= FEWEST_OF_PAGE:
                ends = silent[rows][of_it][[0, -1]]
                for f in _cut(int(can_id), page, t[rows][of_it], data[of_it]):
                    f.silent_s, f.selector = float(ends[1] - ends[0]), selector
                    if page is None or f.place.bits.isdisjoint(selector.bits):
                        yield f


def _selected(data: NDArray[np.int64]) -> tuple[Place, list[int]]:
    """Find the bits that select the meaning of the other bytes, and their values; none if nothing is selected.

    The whole first byte comes first. Of the halves, the one with the fewest values: a counter repeats with the selector
    if its period is a multiple.
    """
    found: list[tuple[Place, list[int]]] = []
    for place in SELECTORS:
        if data.shape[1] >= 3 and (pages := _pages(_bits(data, place), data[:, 1 + place.first_bit // 8 :])):
            found.append((place, pages))
            if place == SELECTORS[0]:
                break
    return min(found, key=lambda x: len(x[1]), default=(SELECTORS[0], []))


def _bits(data: NDArray[np.int64], place: Place) -> NDArray[np.int64]:
    """Read bits that lie in one byte."""
    byte, low = divmod(place.first_bit, 8)
    return data[:, byte] >> low & ((1 << place.size) - 1)


def _pages(first: NDArray[np.int64], rest: NDArray[np.int64]) -> list[int]:
    """Values of bits that select the meaning of the bytes behind them; empty if these bits select nothing."""
    values = np.unique(first)
    if not 2 <= len(values) <= MOST_PAGES:
        return []
    if (np.diff(first) == 0).mean() > STAYS or len(first) < FEWEST_OF_PAGE * len(values):
        return []
    from_frame = np.abs(np.diff(rest, axis=0)).mean()
    own = [np.abs(np.diff(rest[first == v], axis=0)) for v in values if (first == v).sum() > 1]
    from_page = np.concatenate(own).mean() if own else np.inf
    return [int(v) for v in values] if from_page < OF_ITS_OWN * from_frame else []


def _cut(can_id: int, page: int | None, t: Floats, data: NDArray[np.int64]) -> Iterator[Field]:
    """Cut frames into bytes, pairs of bytes in both orders, and twelve bits that begin at a nibble."""
    n = data.shape[1]
    for k in range(0 if page is None else 1, n):
        b = data[:, k]
        yield _field(can_id, page, t, b, Place(8 * k, 8))
        if k + 1 == n:
            continue
        c = data[:, k + 1]
        yield _field(can_id, page, t, b | c << 8, Place(8 * k, 16))
        yield _field(can_id, page, t, b << 8 | c, Place(8 * k + 7, 16, big_endian=True))
        yield _field(can_id, page, t, b | (c & 15) << 8, Place(8 * k, 12))
        yield _field(can_id, page, t, b >> 4 | c << 4, Place(8 * k + 4, 12))
        yield _field(can_id, page, t, b << 4 | c >> 4, Place(8 * k + 7, 12, big_endian=True))
        yield _field(can_id, page, t, (b & 15) << 8 | c, Place(8 * k + 3, 12, big_endian=True))


def _field(can_id: int, page: int | None, t: Floats, raw: NDArray[np.int64], place: Place) -> Field:
    """Read the values as signed if they lie at both ends of the range and are smooth across the wrap."""
    whole = 1 << place.size
    none = raw == whole - 1  # all ones: most manufacturers send this for "not available"
    signed = False
    x = raw
    if place.size > 8 and min((raw < NEAR * whole).mean(), (raw > (1 - NEAR) * whole).mean()) > BOTH_ENDS:
        turned = np.where(raw >= whole // 2, raw - whole, raw)
        if np.abs(np.diff(turned)).mean() < SMOOTHER * np.abs(np.diff(raw)).mean():
            x, signed = turned, True
    elif none.any() and none.mean() < 0.5:
        t, x = t[~none], x[~none]
    return Field(can_id, page, replace(place, signed=signed), t, x.astype(np.float64))
