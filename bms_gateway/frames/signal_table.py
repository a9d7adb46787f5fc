"""Signals compiled for `decode`: the frames of each signal, its bits, scale and limits.

A *node* is a set of signals that appear together: in every frame of an identifier, or in those with one value of its
multiplexer. Nodes are found by a 64-bit key (switch << 32 | value); switch 0 is the identifier itself, the others are
multiplexers. A node lists its signals and the multiplexers that select further nodes. If no message has several
independent multiplexers, an inner node repeats the signals of the outer ones. Each frame then has just one node, found
by following its multiplexers, and a frame with an unknown value keeps the outer node.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.errors import ConfigError
from bms_gateway.frames.bits import BitFields
from bms_gateway.frames.e2e import id_crc
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo, j1939_limits

__all__ = ["SignalTable"]

Index = NDArray[np.intp]
LABEL_BITS = 34
LABEL_RAW = 1 << (LABEL_BITS - 1)
"""Value-table labels count for raw values of up to 32 bits, signed or not; no table labels larger ones."""
NEVER_RAW = np.inf
"""Start of a not-available or error range that no raw value reaches."""


@dataclass(frozen=True, slots=True)
class Nodes:
    """K nodes.

    Attributes
    ----------
    keys : ndarray of uint64 (K,)
        Sorted.
    first, count : ndarray of intp (K,)
        Run of a node in the places.
    needs : ndarray of int64 (K,)
        Bytes that a frame needs for all signals of the node.
    protected, id_crc : ndarray (K,)
        Whether the node's message has end-to-end protection, and the contribution of its data ID to the check sum.
    any_protected : bool
    """

    keys: NDArray[np.uint64]
    first: Index
    count: Index
    needs: NDArray[np.int64]
    protected: NDArray[np.bool_]
    id_crc: NDArray[np.uint8]
    any_protected: bool

    def find(self, key: NDArray[np.uint64]) -> tuple[Index, Index]:
        """Positions in `key` of nodes, and these nodes."""
        if not len(self.keys):
            return np.empty(0, np.intp), np.empty(0, np.intp)
        at = self.keys.searchsorted(key)
        # beyond the last key the clipped index shows another key, which differs
        hit = (self.keys.take(at, mode="clip") == key).nonzero()[0]
        return hit, at.take(hit)


@dataclass(frozen=True, slots=True)
class Switches:
    """W multiplexers; switch w has the key prefix w + 1.

    Attributes
    ----------
    bits : BitFields (W,)
    key : ndarray of uint64 (W,)
        Key prefix.
    first, count : ndarray of intp (K,)
        Run of each node's switches in `listed`.
    listed : ndarray of intp
    of : ndarray of intp (K,)
        First switch of each node; −1 for none.
    several : bool
        Some message has independent multiplexers: its frames have several nodes, and none repeats another's signals.
    declared : ndarray of uint64
        Sorted keys of all values of these multiplexers in the DBC, wanted or not.
    """

    bits: BitFields
    key: NDArray[np.uint64]
    first: Index
    count: Index
    listed: Index
    of: Index
    several: bool
    declared: NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class Values:
    """Conversion of the bits of P places to values.

    Attributes
    ----------
    signal : ndarray of intp (P,)
    scale, offset : ndarray (P,)
    float_bits : ndarray of uint8 (P,)
        Bits of an IEEE 754 number; 0 for an integer.
    wide_unsigned : ndarray of bool (P,)
        Whether the integer may not fit int64.
    float_sizes : tuple of int
        All of `float_bits` that are not 0.
    any_wide : bool
    """

    signal: Index
    scale: NDArray[np.float64]
    offset: NDArray[np.float64]
    float_bits: NDArray[np.uint8]
    wide_unsigned: NDArray[np.bool_]
    float_sizes: tuple[int, ...]
    any_wide: bool

    @classmethod
    def of(cls, listed: Sequence[int], infos: Sequence[SignalInfo]) -> "Values":
        """Tabulate the signals of the places."""
        return cls(
            signal=np.array(listed, np.intp),
            scale=np.array([i.scale for i in infos], np.float64),
            # x + (-0.0) is x for every x: the identity stays one, down to the sign of zero
            offset=np.array([i.offset if i.offset != 0.0 else -0.0 for i in infos], np.float64),
            float_bits=np.array([i.place.size if i.is_float else 0 for i in infos], np.uint8),
            wide_unsigned=np.array([_is_wide(i) for i in infos], np.bool_),
            float_sizes=tuple(sorted({i.place.size for i in infos if i.is_float})),
            any_wide=any(_is_wide(i) for i in infos),
        )


@dataclass(frozen=True, slots=True)
class Limits:
    """Rules for the raw values of P places.

    Attributes
    ----------
    low, high : ndarray (P,)
        Declared range.
    error_from, na_from : ndarray (P,)
        Begin of J1939's ranges; inf for none.
    has_labels : ndarray of bool (P,)
    label_keys, label_quality : ndarray
        Sorted keys (place and raw value) of the value tables, and the quality that each states.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    error_from: NDArray[np.float64]
    na_from: NDArray[np.float64]
    has_labels: NDArray[np.bool_]
    label_keys: NDArray[np.int64]
    label_quality: NDArray[np.uint8]

    @classmethod
    def of(cls, infos: Sequence[SignalInfo]) -> "Limits":
        """Tabulate the signals of the places."""
        valid = np.array([i.raw_valid for i in infos], np.float64).reshape(-1, 2)
        special = [j1939_limits(i.place.size) if i.j1939 else (NEVER_RAW, NEVER_RAW) for i in infos]
        limits = np.array(special, np.float64).reshape(-1, 2)
        labels = sorted(
            (p << LABEL_BITS | (raw + LABEL_RAW), int(q))
            for p, i in enumerate(infos)
            for raw, q in i.labelled.items()
            if abs(raw) < LABEL_RAW
        )
        return cls(
            low=valid[:, 0].copy(),
            high=valid[:, 1].copy(),
            error_from=limits[:, 0].copy(),
            na_from=limits[:, 1].copy(),
            has_labels=np.array([bool(i.labelled) for i in infos], np.bool_),
            label_keys=np.array([k for k, _ in labels], np.int64),
            label_quality=np.array([q for _, q in labels], np.uint8),
        )

    def labels(self, place: Index, raw: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Quality that the value table states for raw values, GOOD for all others."""
        centred = np.clip(raw, -LABEL_RAW, LABEL_RAW - 1).astype(np.int64) + LABEL_RAW
        key = (place.astype(np.int64) << LABEL_BITS) | centred
        at = np.minimum(np.searchsorted(self.label_keys, key), len(self.label_keys) - 1)
        return np.where(self.label_keys[at] == key, self.label_quality[at], np.uint8(Quality.GOOD))


@dataclass(frozen=True, slots=True)
class SignalTable:
    """S signals in the order of the request.

    Attributes
    ----------
    signals : tuple of SignalInfo (S,)
    can_ids : ndarray of uint32
        Identifiers that carry any of them, ascending.
    nodes : Nodes
    switches : Switches
    places : BitFields (P,)
        One per signal and node.
    values : Values
    limits : Limits
    """

    signals: tuple[SignalInfo, ...]
    can_ids: NDArray[np.uint32]
    nodes: Nodes
    switches: Switches
    places: BitFields
    values: Values
    limits: Limits

    @classmethod
    def build(cls, signals: Sequence[SignalInfo], messages: Mapping[str, MessageInfo]) -> "SignalTable":
        """Tabulate signals of known messages.

        Raises
        ------
        ConfigError
            A multiplexer is wider than 32 bits.
        """
        tree = _Tree(messages)
        for number, info in enumerate(signals):
            tree.add(number, info)
        several = any(len(node.switches) > 1 for node in tree.nodes.values())
        if not several:
            tree.inherit()
        keys = sorted(tree.nodes)
        nodes = [tree.nodes[k] for k in keys]
        listed = [n for node in nodes for n in node.signals]
        infos = [signals[n] for n in listed]
        # the longest message determines the number of words, at least eight bytes: the width of classic payloads
        length = max([8, *(i.place.bytes_needed for i in infos), *(s.place.bytes_needed for s in tree.switch_infos)])
        words = (length + 7) // 8
        big = any(i.place.big_endian for i in (*infos, *tree.switch_infos))
        places = BitFields.build([i.place for i in infos], words, big_endian=big)
        counts = np.array([len(node.signals) for node in nodes], np.intp)
        switch_counts = np.array([len(node.switches) for node in nodes], np.intp)
        data_id = np.array([node.data_id for node in nodes], np.int64)
        needs = [max((signals[n].place.bytes_needed for n in node.signals), default=0) for node in nodes]
        return cls(
            tuple(signals),
            np.array(sorted({i.can_id for i in signals}), np.uint32),
            Nodes(
                keys=np.array(keys, np.uint64),
                first=_starts(counts),
                count=counts,
                needs=np.array(needs, np.int64),
                protected=data_id >= 0,
                id_crc=id_crc(data_id),
                any_protected=bool((data_id >= 0).any()),
            ),
            Switches(
                bits=BitFields.build([s.place for s in tree.switch_infos], words, big_endian=big),
                key=np.array([(w + 1) << 32 for w in range(len(tree.switch_infos))], np.uint64),
                first=_starts(switch_counts),
                count=switch_counts,
                listed=np.array([w for node in nodes for w in node.switches], np.intp),
                of=np.array([node.switches[0] if node.switches else -1 for node in nodes], np.intp),
                several=several,
                declared=np.array(sorted(tree.declared()), np.uint64),
            ),
            places,
            Values.of(listed, infos),
            Limits.of(infos),
        )


@dataclass(slots=True)
class _Node:
    signals: list[int]
    switches: list[int]
    data_id: int


class _Tree:
    """Nodes under construction."""

    def __init__(self, messages: Mapping[str, MessageInfo]) -> None:
        self.messages = messages
        self.nodes: dict[int, _Node] = {}
        self.switch_infos: list[SignalInfo] = []
        self._switch_number: dict[str, int] = {}

    def add(self, number: int, info: SignalInfo) -> None:
        nodes = [self._node(0, info.can_id, info)]
        for step in info.mux:
            switch = self.messages[info.message].signals[step.signal]
            w = self._switch(switch)
            for node in nodes:
                if w not in node.switches:
                    node.switches.append(w)
            reachable = [v for v in step.values if _representable(v, switch)]
            nodes = [self._node(w + 1, v, info) for v in reachable]
        for node in nodes:
            node.signals.append(number)

    def declared(self) -> set[int]:
        """Keys of every value that the DBC states of the multiplexers in use."""
        return {
            (w + 1) << 32 | value
            for w, info in enumerate(self.switch_infos)
            for signal in self.messages[info.message].signals.values()
            for step in signal.mux
            if step.signal == info.name
            for value in step.values
            if value >= 0 and _representable(value, info)
        }

    def inherit(self) -> None:
        """Let every inner node carry the signals of the outer ones, outermost first."""
        for key in sorted(k for k in self.nodes if k >> 32 == 0):
            self._hand_down(self.nodes[key], [])

    def _hand_down(self, node: _Node, outer: list[int]) -> None:
        # a multiplexer under several outer values has its inner nodes visited repeatedly, with the same signals
        node.signals[:0] = [n for n in outer if n not in node.signals]
        for w in node.switches:
            for key in sorted(k for k in self.nodes if k >> 32 == w + 1):
                self._hand_down(self.nodes[key], node.signals)

    def _node(self, prefix: int, value: int, info: SignalInfo) -> _Node:
        e2e = self.messages[info.message].e2e
        made = _Node([], [], -1 if e2e is None else e2e.data_id)
        return self.nodes.setdefault(prefix << 32 | value, made)

    def _switch(self, info: SignalInfo) -> int:
        if info.place.size > 32:
            raise ConfigError(f"{info.database}: multiplexer {info.path} is wider than 32 bits, which is not supported")
        if info.path not in self._switch_number:
            self._switch_number[info.path] = len(self.switch_infos)
            self.switch_infos.append(info)
        return self._switch_number[info.path]


def _is_wide(info: SignalInfo) -> bool:
    """Whether the raw value may not fit int64."""
    return info.place.size == 64 and not info.place.signed and not info.is_float


def _representable(value: int, switch: SignalInfo) -> bool:
    """Whether the multiplexer can have this value: a signed one has half the range."""
    low, high = switch.raw_limits
    return low <= value <= high


def _starts(counts: Index) -> Index:
    return np.concatenate([np.zeros(1, np.intp), np.cumsum(counts)[:-1]]).astype(np.intp)[: len(counts)]
