"""A parsed DBC as compact text, and back. It is cached, because parsing takes a hundred times as long.

The text is JSON: reading it cannot execute anything, and its numbers are restored bit for bit. There is one message per
line. Value tables and other content that many signals share are written once.
"""

import json
from collections.abc import Iterator, Sequence
from typing import Any

from bms_gateway.frames.bits import Place
from bms_gateway.frames.signal_info import E2E, MessageInfo, SignalInfo, Switch

__all__ = ["pack", "unpack"]


def pack(messages: Sequence[MessageInfo]) -> str:
    """Write the messages of one DBC; the name of its file is left out.

    Returns
    -------
    str
        First a line of what signals share, then a line of each message. The same messages give the same text.
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
        The text is not of `pack`. Texts that look like its are believed: whoever keeps them guards them.
    """
    kinds, *lines = [json.loads(line) for line in text.splitlines()]
    shared = [(*kind[:-1], dict(kind[-1])) for kind in kinds]
    muxes: dict[str, tuple[Switch, ...]] = {}
    return [_read(name, line, shared, muxes) for line in lines]


def _message(m: MessageInfo, shared: dict[str, int]) -> Iterator[Any]:
    data_id = None if m.e2e is None else m.e2e.data_id
    yield from (m.name, m.can_id, m.length, m.senders, m.cycle_ns, data_id, m.comment, m.any_sender)
    for s in m.signals.values():
        p = s.place
        bits = (p.size, p.big_endian, p.signed, s.is_float)
        numbers = (s.scale, s.offset, s.minimum, s.maximum, s.unit)
        kind = _json((*bits, *numbers, s.is_multiplexer, s.start_raw, s.j1939, list(s.choices.items())))
        yield [
            s.name,
            p.start,
            shared.setdefault(kind, len(shared)),
            s.comment,
            [[step.signal, step.values] for step in s.mux],
        ]


def _read(
    database: str, line: list[Any], shared: Sequence[tuple[Any, ...]], muxes: dict[str, tuple[Switch, ...]]
) -> MessageInfo:
    name, can_id, length, senders, cycle_ns, data_id, comment, any_sender, *listed = line
    signals = {}
    for signal, start, kind, told, mux in listed:
        size, big, signed, is_float, scale, offset, least, most, unit, multiplexer, raw, j1939, choices = shared[kind]
        steps = muxes.get(key := str(mux))
        if steps is None:
            steps = muxes[key] = tuple(Switch(by, tuple(values)) for by, values in mux)
        signals[signal] = SignalInfo(
            database, name, signal, Place(start, size, big, signed), is_float, scale, offset, least, most, unit, told,
            choices, steps, multiplexer, raw, j1939, can_id, cycle_ns,
        )  # fmt: skip
    e2e = None if data_id is None else E2E(data_id)
    return MessageInfo(database, name, can_id, length, tuple(senders), cycle_ns, e2e, comment, signals, any_sender)


def _json(x: object) -> str:
    return json.dumps(x, ensure_ascii=True, separators=(",", ":"))
