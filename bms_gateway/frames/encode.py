"""Physical values to frames, many at once: the inverse of `decode`, with not-available values, counter and check sum.

A *row* is one frame layout: a message and, if it is multiplexed, the multiplexer values. All rows are tabulated when
the encoder is made; encoding then takes a few numpy calls for any number of frames. No value raises an exception: a
value that a signal cannot carry is sent as not available or, without such a convention, as the nearest limit.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.frames.bits import BitFields
from bms_gateway.frames.database import Database
from bms_gateway.frames.e2e import COUNTER_STATES, id_crc, protect
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo, j1939_limits

__all__ = ["LARGEST_BITS", "Encoder", "not_available"]

Index = NDArray[np.intp]
T = TypeVar("T")

LARGEST_BITS = 53
"""Most bits of an integer that every float64 represents exactly."""
MAX_ROWS = 4096
"""Most layouts of one message; more come only from products of independent multiplexers, which no sender uses."""


class _Raw(NamedTuple, Generic[T]):
    """Conversion of a signal's physical value to a raw one; for many signals, with an array for each number.

    Attributes
    ----------
    scale, offset
        Physical = raw · scale + offset.
    low, high
        Valid range.
    below, above, missing, failed
        Sent below and above that range, for NaN and for an error.
    """

    scale: T
    offset: T
    low: T
    high: T
    below: T
    above: T
    missing: T
    failed: T


_NOTHING = _Raw(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Value of a column that a row does not use."""


class Encoder:
    """Frames of some messages.

    Parameters
    ----------
    database : Database
    messages : sequence of str
        Names of the messages to send.
    missing : mapping of str to float, optional
        Raw values for "no measurement", by "Message.Signal", for signals without one of their own.

    Attributes
    ----------
    width : int
        S, columns of `values`: the most signals in one row.
    can_id : ndarray of uint32 (R,)
    length : ndarray of uint8 (R,)
    counters : ndarray of uint8 (R,)
        Next alive counter of each row, the only state: a snapshot must contain it.

    Raises
    ------
    ConfigError
        An unknown message, a signal with scale 0, or a message with too many multiplexer combinations.
    """

    def __init__(
        self, database: Database, messages: Sequence[str], missing: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        infos = [database.message(name) for name in messages]
        self._row: dict[tuple[str, tuple[int, ...]], int] = {}
        self._columns: list[dict[str, int]] = []
        rows: list[tuple[MessageInfo, Mapping[str, int], list[SignalInfo]]] = []
        for message in infos:
            for chosen in _layouts(message):
                carried = [s for s in message.signals.values() if _is_carried(message, s, chosen)]
                self._row[message.name, tuple(chosen.values())] = len(rows)
                self._columns.append({s.name: i for i, s in enumerate(carried)})
                rows.append((message, chosen, carried))
        words = max([1, *((m.length + 7) // 8 for m in infos)])
        self.width = max([1, *(len(c) for _, _, c in rows)])
        self.can_id = np.array([m.can_id for m, _, _ in rows], np.uint32)
        self.length = np.array([m.length for m, _, _ in rows], np.uint8)
        self.counters = np.zeros(len(rows), np.uint8)
        data_id = np.array([-1 if m.e2e is None else m.e2e.data_id for m, _, _ in rows], np.int64)
        self._protected, self._id_crc = data_id >= 0, id_crc(data_id)
        self._base = np.zeros((len(rows), 8 * words), np.uint8)
        for base, (message, values, _) in zip(self._base, rows, strict=True):
            _write_switches(base, message, values)
        flat = [s for _, _, c in rows for s in c]
        self._fields = BitFields.build([s.place for s in flat], words)
        self._numbers = np.array([_raw(s, missing.get(s.path)) for s in flat], np.float64).reshape(
            -1, len(_Raw._fields)
        )
        # one more field, without bits, for the columns that a row does not use
        self._field = np.full((len(rows), self.width), len(flat), np.intp)
        starts = np.cumsum([0, *(len(c) for _, _, c in rows)])
        for r, (_, _, carried) in enumerate(rows):
            self._field[r, : len(carried)] = starts[r] + np.arange(len(carried))
        self._numbers = np.vstack([self._numbers, _NOTHING])
        self._float_bits = np.array([*(s.place.size if s.is_float else 0 for s in flat), 0], np.uint8)

    def row(self, message: str, *mux: int) -> int:
        """Find the layout of a message with these multiplexer values, outermost first.

        Raises
        ------
        ConfigError
            The message is not sent, or it has no such multiplexer value.
        """
        if (message, mux) in self._row:
            return self._row[message, mux]
        names = {name for name, _ in self._row}
        if message not in names:
            raise ConfigError(f"message '{message}' is not among those to send{did_you_mean(message, names)}")
        known = [", ".join(map(str, values)) for name, values in self._row if name == message]
        wanted = ", ".join(map(str, mux))
        raise ConfigError(f"message '{message}' has no layout for multiplexer '{wanted}'{did_you_mean(wanted, known)}")

    def column(self, row: int, signal: str) -> int:
        """Column of `values` that holds a signal of a row.

        Raises
        ------
        ConfigError
            The row does not contain it; the encoder itself writes counters, check sums and multiplexers.
        """
        columns = self._columns[row]
        if signal not in columns:
            raise ConfigError(f"no signal '{signal}' to set in this layout{did_you_mean(signal, columns)}")
        return columns[signal]

    def columns(self, row: int) -> tuple[str, ...]:
        """Signals of a row in the order of their columns."""
        return tuple(self._columns[row])

    def encode(
        self, rows: Index, values: NDArray[np.float64], error: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint8], NDArray[np.uint8]]:
        """Encode N frames.

        Parameters
        ----------
        rows : ndarray of intp (N,)
        values : ndarray of float64 (N, S)
            Physical values. NaN is sent as not available (`not_available`); if the signal has no such value, as its
            value of `missing`, else as the start value, else 0. A value outside the valid range, or infinite, is sent
            as not available by the J1939 convention, else as the nearest limit.
        error : ndarray of bool (N, S), optional
            Whether to send the error value instead, if the signal has one.

        Returns
        -------
        can_id : ndarray of uint32 (N,)
        length : ndarray of uint8 (N,)
        data : ndarray of uint8 (N, W)
            Zero beyond the length and in unused bits. W is 8, or what the longest message needs.
        """
        field = self._field.take(rows, axis=0)
        bits = self._raw_bits(field, values, error)
        data = self._base.take(rows, axis=0)
        data |= self._place(bits, np.minimum(field, max(len(self._fields.mask) - 1, 0)))
        part = np.flatnonzero(self._protected.take(rows))
        if len(part):
            framed = data[part, :8]
            protect(framed, self._count(rows[part]), self._id_crc.take(rows[part]))
            data[part, :8] = framed
        return self.can_id.take(rows), self.length.take(rows), data

    def _raw_bits(
        self, field: Index, values: NDArray[np.float64], error: NDArray[np.bool_] | None
    ) -> NDArray[np.uint64]:
        s = _Raw(*np.moveaxis(self._numbers.take(field, axis=0), -1, 0))
        with np.errstate(all="ignore"):
            raw = (values - s.offset) / s.scale
            narrow = self._float_bits.take(field)
            raw = np.where(narrow > 0, raw, np.rint(raw))
            raw = np.where(raw < s.low, s.below, np.where(raw > s.high, s.above, raw))
            raw = np.where(np.isnan(raw), s.missing, raw)
            if error is not None:
                raw = np.where(error, s.failed, raw)
            bits: NDArray[np.uint64] = np.abs(raw).astype(np.uint64)
            bits = np.where(raw < 0, np.uint64(0) - bits, bits)
            if narrow.any():
                bits = np.where(narrow == 32, raw.astype(np.float32).view(np.uint32).astype(np.uint64), bits)
                bits = np.where(narrow == 64, raw.view(np.uint64), bits)
        return bits

    def _place(self, bits: NDArray[np.uint64], field: Index) -> NDArray[np.uint8]:
        """Shift every value to its bits and merge those of a frame; (N, W) bytes."""
        f = self._fields
        words = np.zeros((len(bits), f.stride), np.uint64)
        if len(f.mask):
            bits = bits & f.mask.take(field)
            word = f.word.take(field)
            lower = bits << f.shift.take(field)
            for w in range(f.stride):
                words[:, w] = np.bitwise_or.reduce(np.where(word == w, lower, np.uint64(0)), axis=1)
            if f.any_crosses:
                crosses, word2 = f.crosses.take(field), f.word2.take(field)
                upper = bits >> f.shift2.take(field)
                for w in range(f.stride):
                    words[:, w] |= np.bitwise_or.reduce(np.where(crosses & (word2 == w), upper, np.uint64(0)), axis=1)
        little = words[:, : f.words].astype("<u8")
        if f.stride > f.words:
            little |= words[:, f.words :].byteswap().astype("<u8")
        return np.ascontiguousarray(little).view(np.uint8)

    def _count(self, rows: Index) -> NDArray[np.uint8]:
        """Return the counter of each frame, and store the next ones."""
        order = np.argsort(rows, kind="stable")
        ordered = rows[order]
        fresh = np.ones(len(rows), np.bool_)
        fresh[1:] = ordered[1:] != ordered[:-1]
        start = np.flatnonzero(fresh)
        nth = np.arange(len(rows)) - np.repeat(start, np.diff(np.append(start, len(rows))))
        counter = np.empty(len(rows), np.uint8)
        counter[order] = (self.counters.take(ordered) + nth) % COUNTER_STATES
        sent = np.bincount(rows, minlength=len(self.counters))
        self.counters = ((self.counters + sent) % COUNTER_STATES).astype(np.uint8)
        return counter


def _layouts(message: MessageInfo) -> list[dict[str, int]]:
    found: list[dict[str, int]] = []
    for chosen in _choices(message, {}):
        found.append(chosen)
        if len(found) > MAX_ROWS:
            raise ConfigError(
                f"{message.database}: message {message.name} has over {MAX_ROWS} multiplexer combinations"
            )
    return found


def _choices(message: MessageInfo, chosen: dict[str, int]) -> Iterator[dict[str, int]]:
    """Multiplexer values of every layout: decide the first multiplexer present and open, then the rest."""
    for s in message.signals.values():
        if s.is_multiplexer and s.name not in chosen and _is_present(s, chosen):
            values = {
                v for t in message.signals.values() for step in t.mux if step.signal == s.name for v in step.values
            }
            for value in sorted(values) or [0]:
                yield from _choices(message, {**chosen, s.name: value})
            return
    yield chosen


def _is_present(s: SignalInfo, chosen: Mapping[str, int]) -> bool:
    return all(chosen.get(step.signal) in step.values for step in s.mux)


def _is_carried(message: MessageInfo, s: SignalInfo, chosen: Mapping[str, int]) -> bool:
    """Whether the caller sets this signal: not the multiplexers, nor the protection in bytes 0 and 1."""
    if s.scale == 0.0:
        raise ConfigError(f"{message.database}: signal {s.path} has the scale 0; correct it in the DBC")
    protected = message.e2e is not None and s.place.start < 12 and not s.place.big_endian
    return not s.is_multiplexer and not protected and _is_present(s, chosen)


def _write_switches(base: NDArray[np.uint8], message: MessageInfo, chosen: Mapping[str, int]) -> None:
    for name, value in chosen.items():
        place = message.signals[name].place
        for k in range(place.size):
            if place.big_endian:
                position = place.first_bit + place.size - 1 - k
                byte, bit = position // 8, 7 - position % 8
            else:
                byte, bit = divmod(place.start + k, 8)
            base[byte] |= ((value >> k) & 1) << bit


def not_available(s: SignalInfo) -> float | None:
    """Return the raw value for "no measurement" by J1939, the value table or IEEE 754; None if there is none."""
    if s.j1939:
        return float((1 << s.place.size) - 1)
    if s.is_float:
        return math.nan
    return next((float(raw) for raw, quality in s.labelled.items() if quality is Quality.NOT_AVAILABLE), None)


def _raw(s: SignalInfo, unknown: float | None) -> _Raw[float]:
    """Tell what a signal can carry, and what is sent in place of what it cannot; `unknown` instead of a start value."""
    least, most = s.raw_limits
    if s.is_float:
        widest = float(np.finfo(np.float32 if s.place.size == 32 else np.float64).max)
        least, most = -widest, widest
    elif s.place.size > LARGEST_BITS:
        # the largest float64 below the limit: the limit itself would round up and overflow
        most = math.nextafter(most, 0.0)
    low, high = max(s.raw_valid[0], least), min(s.raw_valid[1], most)
    if low > high:
        low, high = least, most
    missing = not_available(s)
    if s.j1939 and missing is not None:
        error_from = j1939_limits(s.place.size)[0]
        return _Raw(s.scale, s.offset, low, high, missing, missing, missing, failed=float(error_from))
    start = 0.0 if s.start_raw is None else min(max(s.start_raw, least), most)
    if missing is None:
        missing = start if unknown is None else unknown
    return _Raw(s.scale, s.offset, low, high, below=low, above=high, missing=missing, failed=start)
