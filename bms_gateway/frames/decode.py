"""Decode many frames to physical values at once, by a few numpy calls per batch and none per frame or message."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.bits import words_of
from bms_gateway.frames.e2e import check
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_table import Limits, SignalTable, Switches, Values

__all__ = ["Protected", "Samples", "decode"]

_IEEE: dict[int, tuple[type[np.unsignedinteger[Any]], type[np.floating[Any]]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}

Index = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Protected:
    """Frames of the batch that carry a counter and a check sum, in the order of the bus.

    Attributes
    ----------
    frame : ndarray of intp (k,)
        Index into the batch, ascending.
    node : ndarray of intp (k,)
        Node of the table (message and multiplexer value) of the counter.
    counter : ndarray of uint8 (k,)
    crc_ok : ndarray of bool (k,)
    """

    frame: Index
    node: Index
    counter: NDArray[np.uint8]
    crc_ok: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Samples:
    """Values of one batch in the order of the frames; within a frame in the order of the table.

    Attributes
    ----------
    frame : ndarray of intp (n,)
        Index into the batch, ascending.
    signal : ndarray of intp (n,)
        Index into `SignalTable.signals`.
    value : ndarray of float64 (n,)
        Physical value, raw · scale + offset; NaN if the frame was too short. A value whose flag is not GOOD is the
        content of the bits and no measurement.
    flag : ndarray of uint8 (n,)
        `Quality`: GOOD, OUT_OF_RANGE, NOT_AVAILABLE, ERROR or CRC.
    protected : Protected
        Counter and check sum per frame, for the guard.
    unknown : ndarray of intp (u,)
        Frames, ascending, whose multiplexer has a value unknown to the DBC, or that are too short for it.
    """

    frame: Index
    signal: Index
    value: NDArray[np.float64]
    flag: NDArray[np.uint8]
    protected: Protected
    unknown: Index

    def __len__(self) -> int:
        return len(self.frame)


def decode(table: SignalTable, batch: FrameBatch) -> Samples:
    """Decode all wanted signals of a batch.

    Frames of other identifiers, and of multiplexer values without a wanted signal, give no sample; values unknown to
    the DBC are reported. Over-long frames are read like those of the right length. No content of a frame raises an
    exception.

    Parameters
    ----------
    table : SignalTable
        From `Database.compile`.
    batch : FrameBatch

    Notes
    -----
    Equal to cantools' ``decode_message(..., decode_choices=False)`` bit for bit, except integers beyond 2⁵³, which are
    rounded to float64.
    """
    hit, node = table.nodes.find(batch.can_id.astype(np.uint64))
    row = np.arange(len(hit))
    length = batch.length.take(hit)
    words = words_of(batch.data, hit, table.places.words, table.places.stride)
    unknown: list[Index] = []
    if table.switches.several:
        row, node = _through_multiplexers(table, row, node, words, length, unknown)
    elif len(table.switches.listed):
        _follow_multiplexers(table, node, words, length, unknown)
    protected = (
        _protection(table, words, length, hit, row, node) if table.nodes.any_protected and len(row) else _UNPROTECTED
    )
    count = table.nodes.count.take(node)
    at = row.repeat(count)
    # place of sample i: start of its node's run plus its position in that run
    start = table.nodes.first.take(node)
    start += count
    start -= count.cumsum()
    place = start.repeat(count)
    place += np.arange(len(at))
    raw_bits = table.places.raw(words, at, place)
    # an underflow or a signalling NaN in a floating-point payload is a property of the data, not an error of the code
    with np.errstate(all="ignore"):
        raw = _to_float(table.values, raw_bits, place)
        value = raw * table.values.scale.take(place)
        value += table.values.offset.take(place)
    flag = _judge(table.limits, raw, place)
    if len((length.take(row) < table.nodes.needs.take(node)).nonzero()[0]):
        cut = table.places.needs.take(place) > length.take(at)
        value[cut] = np.nan
        flag[cut] = Quality.ERROR
    frame = hit.take(at)
    if len(protected.frame) and not protected.crc_ok.all():
        broken = np.zeros(len(batch), np.bool_)
        broken[protected.frame[~protected.crc_ok]] = True
        flag[broken.take(frame)] = Quality.CRC
    strange = np.unique(hit.take(np.concatenate(unknown))) if any(map(len, unknown)) else _NO_FRAMES
    return Samples(frame, table.values.signal.take(place), value, flag, protected, strange)


def _follow_multiplexers(
    table: SignalTable, node: Index, words: NDArray[np.uint64], length: NDArray[np.uint8], unknown: list[Index]
) -> None:
    """Replace the node of each frame by the innermost one that its multiplexers select."""
    switch = table.switches.of.take(node)
    row = (switch >= 0).nonzero()[0]
    switch = switch.take(row)
    while len(row):
        key = table.switches.bits.raw(words, row, switch)
        key |= table.switches.key.take(switch)
        hit, inner = table.nodes.find(key)
        unknown.append(_strange(table.switches, row, switch, key, hit, length))
        row, switch = row.take(hit), switch.take(hit)
        # a frame that is too short for its multiplexer does not show its signals
        held = (table.switches.bits.needs.take(switch) <= length.take(row)).nonzero()[0]
        if len(held) < len(row):
            row, inner = row.take(held), inner.take(held)
        node[row] = inner
        switch = table.switches.of.take(inner)
        nested = (switch >= 0).nonzero()[0]
        row, switch = row.take(nested), switch.take(nested)


def _through_multiplexers(
    table: SignalTable,
    row: Index,
    node: Index,
    words: NDArray[np.uint64],
    length: NDArray[np.uint8],
    unknown: list[Index],
) -> tuple[Index, Index]:
    """Follow independent multiplexers level by level to all nodes present in each frame, in frame order."""
    rows, nodes = [row], [node]
    while True:
        count = table.switches.count.take(node)
        if not count.any():
            break
        first = table.switches.first.take(node) - (np.cumsum(count) - count)
        switch = table.switches.listed.take(first.repeat(count) + np.arange(int(count.sum())))
        at = row.repeat(count)
        key = table.switches.bits.raw(words, at, switch)
        key |= table.switches.key.take(switch)
        hit, node = table.nodes.find(key)
        unknown.append(_strange(table.switches, at, switch, key, hit, length))
        row, switch = at.take(hit), switch.take(hit)
        # a frame that is too short for its multiplexer does not show its signals
        held = table.switches.bits.needs.take(switch) <= length.take(row)
        if not held.all():
            row, node = row[held], node[held]
        rows.append(row)
        nodes.append(node)
    kept = [table.nodes.count.take(n).nonzero()[0] for n in nodes]
    rows = [r.take(k) for r, k in zip(rows, kept, strict=True) if len(k)]
    nodes = [n.take(k) for n, k in zip(nodes, kept, strict=True) if len(k)]
    if len(rows) == 1:
        return rows[0], nodes[0]
    if not rows:
        return row[:0], node[:0]
    row, node = np.concatenate(rows), np.concatenate(nodes)
    order = np.argsort(row, kind="stable")
    return row.take(order), node.take(order)


def _strange(
    switches: Switches, row: Index, switch: Index, key: NDArray[np.uint64], hit: Index, length: NDArray[np.uint8]
) -> Index:
    """Find the rows that are too short for their multiplexer, or whose multiplexer value is not in the DBC."""
    short = switches.bits.needs.take(switch) > length.take(row)
    if len(hit) == len(row) and not short.any():
        return _NO_FRAMES
    return row.take((short | ~np.isin(key, switches.declared)).nonzero()[0])


def _to_float(values: Values, bits: NDArray[np.uint64], place: Index) -> NDArray[np.float64]:
    """Raw values as numbers: integers of either sign, and IEEE 754 floats by their bits."""
    raw = bits.view(np.int64).astype(np.float64)
    if values.any_wide:
        wide = values.wide_unsigned.take(place).nonzero()[0]
        raw[wide] = bits[wide].astype(np.float64)
    if values.float_sizes:
        width = values.float_bits.take(place)
        for size in values.float_sizes:
            part = (width == size).nonzero()[0]
            narrow, kind = _IEEE[size]
            raw[part] = bits[part].astype(narrow).view(kind)
    return raw


def _judge(limits: Limits, raw: NDArray[np.float64], place: Index) -> NDArray[np.uint8]:
    """Quality by the raw value: declared range, J1939 ranges, labels of the value table, NaN."""
    flag = np.zeros(len(raw), np.uint8)
    # written so that NaN, which compares as false, is refused too
    inside: NDArray[np.bool_] = raw >= limits.low.take(place)
    inside &= raw <= limits.high.take(place)
    part = (~inside).nonzero()[0]
    if len(part):
        r, p = raw.take(part), place.take(part)
        f = np.full(len(part), Quality.OUT_OF_RANGE, np.uint8)
        f[r >= limits.error_from.take(p)] = Quality.ERROR
        f[(r >= limits.na_from.take(p)) | np.isnan(r)] = Quality.NOT_AVAILABLE
        flag[part] = f
    if len(limits.label_keys):
        part = limits.has_labels.take(place).nonzero()[0]
        stated = limits.labels(place.take(part), raw.take(part))
        part, stated = part[stated > 0], stated[stated > 0]
        flag[part] = stated
    return flag


def _protection(
    table: SignalTable, words: NDArray[np.uint64], length: NDArray[np.uint8], hit: Index, row: Index, node: Index
) -> Protected:
    part = table.nodes.protected.take(node).nonzero()[0]
    if table.switches.several and len(part):
        # the inner node comes last and counts
        part = part[np.append(row[part[1:]] != row[part[:-1]], True)]
    if len(part) < len(row):
        row, node = row.take(part), node.take(part)
    word = words.take(row if table.places.stride == 1 else row * table.places.stride)
    counter, ok = check(word, length.take(row), table.nodes.id_crc.take(node))
    return Protected(hit.take(row), node, counter, ok)


_NO_FRAMES = np.empty(0, np.intp)
_UNPROTECTED = Protected(np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0, np.uint8), np.empty(0, np.bool_))
