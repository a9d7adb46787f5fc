"""One DBC text to what it says of its messages and signals, by cantools."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, cast

from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.bits import Place
from bms_gateway.frames.signals import E2E, MessageInfo, SignalInfo, Switch

if TYPE_CHECKING:
    from cantools.database.can import Database as Parsed
    from cantools.database.can import Message, Signal
    from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics

__all__ = ["parse"]

E2E_PROFILE = "AUTOSAR_P01_1A"
"""Value of the attribute `E2EProfile` of messages whose CRC and counter are checked."""


def parse(name: str, text: str) -> list[MessageInfo]:
    """Parse one DBC text strictly.

    Parameters
    ----------
    name : str
        Of its file, for the messages and for what is told of faults.
    text : str

    Raises
    ------
    ConfigError
        Not a valid DBC: names the file, the line and what to do.
    """
    # cantools brings python-can along, 0.1 s: only who has a DBC parsed pays for it
    from cantools.database import load_string
    from cantools.database.errors import Error

    try:
        parsed = load_string(text, database_format="dbc", strict=True)
    except Error as problem:
        raise ConfigError(_explain(name, text, str(problem))) from problem
    return [_message(name, message) for message in cast("Parsed", parsed).messages]


def _message(database: str, m: "Message") -> MessageInfo:
    can_id = m.frame_id | EXTENDED if m.is_extended_frame else m.frame_id
    cycle_ns = round(m.cycle_time * 1_000_000) if m.cycle_time else None
    protected = m.dbc is not None and _attribute(m.dbc, "E2EProfile") == E2E_PROFILE
    e2e = E2E(int(m.dbc.attributes["E2EDataID"].value)) if m.dbc is not None and protected else None
    by_name = {s.name: s for s in m.signals}
    signals = {s.name: _signal(database, m, s, by_name, can_id, cycle_ns) for s in m.signals}
    return MessageInfo(
        database=database,
        name=m.name,
        can_id=can_id,
        length=m.length,
        senders=tuple(m.senders),
        cycle_ns=cycle_ns,
        e2e=e2e,
        comment=m.comment or "",
        signals=signals,
    )


def _signal(
    database: str, m: "Message", s: "Signal", by_name: Mapping[str, "Signal"], can_id: int, cycle_ns: int | None
) -> SignalInfo:
    place = Place(s.start, s.length, s.byte_order == "big_endian", bool(s.is_signed) and not s.conversion.is_float)
    choices = {int(raw): str(label) for raw, label in (s.conversion.choices or {}).items()}
    return SignalInfo(
        database=database,
        message=m.name,
        name=s.name,
        place=place,
        is_float=s.conversion.is_float,
        scale=float(s.conversion.scale),
        offset=float(s.conversion.offset),
        minimum=None if s.minimum is None else float(s.minimum),
        maximum=None if s.maximum is None else float(s.maximum),
        unit=s.unit or "",
        comment=s.comment or "",
        choices=choices,
        mux=_switches(s, by_name),
        is_multiplexer=s.is_multiplexer,
        start_raw=None if s.raw_initial is None else float(s.raw_initial),
        j1939=_is_j1939(m, s),
        can_id=can_id,
        cycle_ns=cycle_ns,
    )


def _switches(s: "Signal", by_name: Mapping[str, "Signal"]) -> tuple[Switch, ...]:
    if s.multiplexer_signal is None:
        return ()
    outer = _switches(by_name[s.multiplexer_signal], by_name)
    return (*outer, Switch(s.multiplexer_signal, tuple(sorted(s.multiplexer_ids or ()))))


def _is_j1939(m: "Message", s: "Signal") -> bool:
    """Decide whether all ones mean "not available".

    A DBC says so by our signal attribute `RawConvention`. Messages of the J1939 protocol follow the standard too; there
    the declared range must leave those raw values out, since counters and check sums use them.
    """
    if s.conversion.is_float or s.is_signed or s.length not in (2, 4, 8, 16, 24, 32):
        return False
    convention = _attribute(s.dbc, "RawConvention")
    if convention is not None:
        return convention == "J1939"
    if m.protocol != "j1939" or s.maximum is None or s.is_multiplexer or s.conversion.scale <= 0:
        return False
    error_from = (0xFE << (s.length - 8)) if s.length >= 8 else (1 << s.length) - 2
    return (s.maximum - s.conversion.offset) / s.conversion.scale < error_from


def _attribute(specifics: "DbcSpecifics", name: str) -> str | None:
    """Value of an ENUM attribute as text, or its default; None where the DBC does not define it.

    Files write the value of an ENUM as its number or as its text.
    """
    if name not in specifics.attribute_definitions:
        return None
    definition = specifics.attribute_definitions[name]
    stated = specifics.attributes.get(name)
    value = definition.default_value if stated is None else stated.value
    choices = definition.choices or []
    return str(choices[value]) if isinstance(value, int) and value < len(choices) else str(value)


def _explain(name: str, text: str, problem: str) -> str:
    """Turn cantools' refusal into one line: file, line in it, what is wrong, what to do."""
    detail = problem.removeprefix('DBC: "').removesuffix('"')
    lines = text.splitlines()
    unused = re.findall(r"^ *(VAL_|SIG_VALTYPE_) (\d+) (\w+)$", detail, re.M)
    if unused:
        at = [_line(lines, rf"\s*{kind}\s+{number}\s+{signal}\b") for kind, number, signal in unused]
        listed = ", ".join(f"line {n} ({k} of {s})" for n, (k, _, s) in zip(at, unused, strict=True))
        return f"{name}: {listed}: no message has such a signal; remove {'these lines' if len(at) > 1 else 'this line'}"
    overlap = re.search(r"signals (\S+) and (\S+) are overlapping in message (\S+?)\.?$", detail)
    if overlap:
        first, second, message = overlap.groups()
        n = _signal_line(lines, message, first)
        return (
            f"{name}: line {n}: signals {first} and {second} of message {message} overlap; move or remove one of them"
        )
    outside = re.search(r"signal (\S+) does not fit in message (\S+?)\.?$", detail)
    if outside:
        n = _signal_line(lines, outside[2], outside[1])
        return f"{name}: line {n}: signal {outside[1]} does not fit in message {outside[2]}; correct its bits"
    syntax = re.search(r"Invalid syntax at line (\d+), column (\d+)", detail)
    if syntax:
        n = int(syntax[1])
        shown = lines[n - 1].strip()[:60] if n <= len(lines) else ""
        return f"{name}: line {n}, column {syntax[2]}: not valid DBC syntax at '{shown}'; correct or remove the line"
    return f"{name}: refused as a DBC: {' '.join(detail.split())}; correct the file"


def _line(lines: Sequence[str], pattern: str) -> int:
    """1-based number of the first line that matches; 0 for none."""
    return next((i for i, line in enumerate(lines, 1) if re.match(pattern, line)), 0)


def _signal_line(lines: Sequence[str], message: str, signal: str) -> int:
    start = _line(lines, rf"\s*BO_\s+\d+\s+{re.escape(message)}\b")
    return start + _line(lines[start:], rf"\s*SG_\s+{re.escape(signal)}\b") if start else 0
