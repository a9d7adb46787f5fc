"""A parsed DBC as compact text, and back. It is cached, because parsing takes a hundred times as long.

The text is JSON: reading it cannot execute anything, and its numbers are restored bit for bit. There is one message per
line. Value tables and other content that many signals share are written once.
"""

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from bms_gateway.frames.bits import Place
from bms_gateway.frames.signal_info import E2E, MessageInfo, SignalInfo, Switch

__all__ = ["pack", "unpack"]


def pack(messages: Sequence[MessageInfo]) -> str:
    """Write the messages of one DBC; the name of its file is left out.

    Returns
    -------
    str
        One line of shared content, then a line per message. The same messages give the same text.
    """
    shared: dict[str, int] = {}
    lines = [_json(list(_message(m, shared))) for m in messages]
    return "\n".join([f"[{','.join(shared)}]", *lines]) + "\n"


def unpack(name: str, text: str) -> list[MessageInfo]:
    """Read back what `pack` wrote.

    Parameters
    ----------
    name : str
        Of the DBC file.
    text : str

    Raises
    ------
    ValueError, TypeError, IndexError
        The text is not from `pack`. Texts of the same form are not checked further: whoever stores them must protect
        them.
    """
    kinds, *lines = [json.loads(line) for line in text.splitlines()]
    shared = [_Kind._make([*kind[:-1], dict(kind[-1])]) for kind in kinds]
    muxes: dict[str, tuple[Switch, ...]] = {}
    return [_read(name, line, shared, muxes) for line in lines]


class _Head(NamedTuple):
    """Part of a line about the message, before the signals."""

    name: str
    can_id: int
    length: int
    senders: Sequence[str]
    cycle_ns: int | None
    data_id: int | None
    comment: str
    any_sender: bool


class _Kind(NamedTuple):
    """Common part of many signals."""

    size: int
    big_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float
    minimum: float | None
    maximum: float | None
    unit: str
    is_multiplexer: bool
    start_raw: float | None
    j1939: bool
    choices: Any
    """A mapping; as pairs where it is written."""


def _message(m: MessageInfo, shared: dict[str, int]) -> Iterator[Any]:
    data_id = None if m.e2e is None else m.e2e.data_id
    yield from _Head(m.name, m.can_id, m.length, m.senders, m.cycle_ns, data_id, m.comment, m.any_sender)
    for s in m.signals.values():
        p = s.place
        kind = _Kind(
            p.size, p.big_endian, p.signed, s.is_float, s.scale, s.offset, s.minimum, s.maximum, s.unit,
            s.is_multiplexer, s.start_raw, s.j1939, list(s.choices.items()),
        )  # fmt: skip
        yield [
            s.name,
            p.start,
            shared.setdefault(_json(kind), len(shared)),
            s.comment,
            [[step.signal, step.values] for step in s.mux],
        ]


def _read(database: str, line: list[Any], shared: Sequence[_Kind], muxes: dict[str, tuple[Switch, ...]]) -> MessageInfo:
    head, listed = _Head(*line[: len(_Head._fields)]), line[len(_Head._fields) :]
    signals = {}
    for signal, start, kind, told, mux in listed:
        k = shared[kind]
        steps = muxes.get(key := str(mux))
        if steps is None:
            steps = muxes[key] = tuple(Switch(by, tuple(values)) for by, values in mux)
        signals[signal] = SignalInfo(
            database, head.name, signal, Place(start, k.size, k.big_endian, k.signed), k.is_float, k.scale, k.offset,
            k.minimum, k.maximum, k.unit, told, k.choices, steps, k.is_multiplexer, k.start_raw, k.j1939,
            head.can_id, head.cycle_ns,
        )  # fmt: skip
    return MessageInfo(
        database, head.name, head.can_id, head.length, tuple(head.senders), head.cycle_ns,
        None if head.data_id is None else E2E(head.data_id), head.comment, signals, head.any_sender,
    )  # fmt: skip


def _json(x: object) -> str:
    return json.dumps(x, ensure_ascii=True, separators=(",", ":"))
