"""Parse one DBC text into its messages and signals, by cantools."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from math import isfinite
from typing import TYPE_CHECKING, Final, cast

from bms_gateway.errors import ConfigError
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.bits import Place
from bms_gateway.frames.j1939 import PROTOCOL
from bms_gateway.frames.signal_info import E2E, MessageInfo, SignalInfo, Switch

if TYPE_CHECKING:
    from cantools.database.can import Database as Parsed
    from cantools.database.can import Message, Signal
    from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics

__all__ = ["parse", "parse_lenient"]

E2E_PROFILE = "AUTOSAR_P01_1A"
"""Value of the attribute `E2EProfile` of messages whose CRC and counter are checked."""
MOST_SIGNALS = 20_000
"""More than the buses of a whole vehicle have; cantools takes 3.5 s and 75 MB for them."""
LONGEST = 1785
"""Bytes of the longest message: of J1939's transport protocol, 255 packets of 7."""
LONGEST_TEXT = 1 << 18
"""Characters between two quotation marks. For each, cantools takes some twenty bytes at once."""
LONGEST_DIGITS = 5
MOST_WORDS = 2_000_000
"""Words and marks outside of comments. cantools keeps each, in some 150 bytes; a whole vehicle has a twentieth."""
MOST_SELECTING = 1_000_000
"""Most multiplexer values in ranges, of all signals together: sixteen signals that any value of 16 bits selects."""
MOST_DIGITS = 10
LONGEST_CYCLE_MS = 86_400_000.0
MOST_DATA_ID = 0xFFFF
MOST_ID = 0xFFFFFFFF
MOST_SHOWN = 200
MOST_LISTED = 5
"""Most lines that one message names."""
_QUOTE = re.compile(r'(?<!\\)"')
_WORD = re.compile(r'"[^"]*"|[\w.+-]+|[^\s\w]')
_SIGNAL = re.compile(r"^[ \t]*SG_[ \t]", re.M)
_MESSAGE = re.compile(r"^[ \t]*BO_\s+\d+\s+(\w+)\s*:\s*(\d+)", re.M)
_ID = re.compile(r"^[ \t]*BO_\s+(\d+)", re.M)
_WHOLE_SIGNAL = re.compile(r"\[[^\]|]*\|[^\]]*\]\s*\"[^\"]*\"\s+\S")
_WHOLE_MESSAGE = re.compile(r"BO_\s+\d+\s+\w+\s*:\s*\d+\s+\w")
_PLACE = re.compile(r"\bSG_\s+(\w+)[^:\"]*:\s*(\d+)\s*\|\s*(\d+)")
_SELECTED = re.compile(r"^[ \t]*SG_MUL_VAL_\s[^;]*;", re.M)
_OF_A_SIGNAL = re.compile(r"[ \t]*(VAL_|SIG_VALTYPE_)\s+(\d+)\s+(\w+)")
_STATED = re.compile(rf"^{_OF_A_SIGNAL.pattern}\b[^;]*;", re.M)
_RANGE = re.compile(r"(\d+)\s*-\s*(\d+)")
_DATA_ID = re.compile(r"[0-9]{1,5}")
_UNFORESEEN = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


def parse(name: str, text: str) -> list[MessageInfo]:
    """Parse one DBC text strictly.

    Parameters
    ----------
    name : str
        Of its file, for the messages and for error lines.
    text : str

    Raises
    ------
    ConfigError
        Not a valid DBC: names the file, the line and what to do.
    """
    # cantools loads python-can, which takes 0.1 s: it is loaded only when a DBC is parsed
    from cantools.database import load_string
    from cantools.database.errors import Error

    _refuse_extremes(name, text)
    try:
        parsed = load_string(text, database_format="dbc", strict=True)
        return _messages(name, cast("Parsed", parsed))
    except Error as problem:
        raise ConfigError(_explain(name, text, str(problem))) from problem
    except RecursionError:
        raise ConfigError(f"{name}: multiplexers nested too deep; correct the file") from None
    except _UNFORESEEN as problem:  # errors of the parser, which is not ours, in a file that is not a sound DBC
        what = " ".join(f"{type(problem).__name__}: {problem}".split())[:MOST_SHOWN]
        raise ConfigError(f"{name}: refused as a DBC ({what}); correct the file") from problem


def parse_lenient(name: str, text: str) -> list[MessageInfo] | None:
    """Parse the readable part of a DBC that `parse` refuses: overlapping signals, value tables without a signal.

    Returns
    -------
    list of MessageInfo or None
        None if nothing can be read.
    """
    from cantools.database import load_string
    from cantools.database.errors import Error

    _refuse_extremes(name, text)
    for _ in range(2):
        try:
            parsed = load_string(text, database_format="dbc", strict=False)
            return _messages(name, cast("Parsed", parsed))
        except Error as problem:
            unused = re.findall(r"^ *(VAL_|SIG_VALTYPE_) (\d+) (\w+)$", str(problem).removesuffix('"'), re.M)
            if not unused:
                return None
            text = _without(text, set(unused))
        except (ConfigError, RecursionError, *_UNFORESEEN):
            return None
    return None


_HEAD: Final = 200
"""Characters at the start of a DBC that contain its first word."""


def _without(text: str, stray: set[tuple[str, str, str]]) -> str:
    """Leave out the statements about these signals, by kind of statement, number of the message and signal."""
    return _STATED.sub(lambda found: "" if found.groups() in stray else found[0], text)


def _refuse_extremes(name: str, text: str) -> None:
    """Refuse content that no bus carries and for which a parser needs minutes or gigabytes."""
    if "\0" in text:
        wide = "VERSION" in text[:_HEAD].replace("\0", "")
        why = "is a DBC in UTF-16; save it as UTF-8 or Windows-1252"
        other = "holds zero bytes, so it is no text of a DBC; give the vehicle's DBC file"
        raise ConfigError(f"{name}: {why if wide else other}")
    _refuse_long_texts(name, text)
    signals = sum(1 for _ in _SIGNAL.finditer(text))
    if signals > MOST_SIGNALS:
        raise ConfigError(
            f"{name}: {signals} signals; at most {MOST_SIGNALS} are read: leave out the messages that are not needed"
        )
    for found in _MESSAGE.finditer(text):
        if len(found[2]) > LONGEST_DIGITS or int(found[2]) > LONGEST:
            line = text.count("\n", 0, found.start(2)) + 1
            raise ConfigError(f"{name}: line {line}: message {found[1]} is longer than {LONGEST} bytes; correct it")
    for found in _ID.finditer(text):
        if len(found[1]) > MOST_DIGITS or int(found[1]) > MOST_ID:
            line = text.count("\n", 0, found.start(1)) + 1
            raise ConfigError(f"{name}: line {line}: the identifier {found[1][:20]} is beyond 32 bits; correct it")
    if cut := _cut_short(text):
        raise ConfigError(f"{name}: line {text.rstrip().count(chr(10)) + 1}: the file ends within {cut}; is it whole?")
    for found in _PLACE.finditer(text):
        if any(len(n) > LONGEST_DIGITS or int(n) > 8 * LONGEST for n in found.groups()[1:]):
            line = text.count("\n", 0, found.start(2)) + 1
            raise ConfigError(
                f"{name}: line {line}: signal {found[1]} lies beyond {8 * LONGEST} bits; correct its start or length"
            )
    _refuse_ranges(name, text)
    _refuse_many_words(name, text)


def _refuse_many_words(name: str, text: str) -> None:
    """Refuse more words and marks than a real DBC has: a parser makes an object of each."""
    if len(text) > MOST_WORDS and next(islice(_WORD.finditer(text), MOST_WORDS, None), None) is not None:
        raise ConfigError(
            f"{name}: over {MOST_WORDS:,} words and marks, more than the buses of a whole vehicle have: is it the "
            "vehicle's DBC? Leave out of it what the gateway does not need"
        )


def _refuse_long_texts(name: str, text: str) -> None:
    """Refuse comments, units and labels of a length that a parser multiplies."""
    quotes = (found.start() for found in _QUOTE.finditer(text))
    for begin in quotes:
        if (length := next(quotes, len(text)) - begin - 1) > LONGEST_TEXT:
            line = text.count("\n", 0, begin) + 1
            raise ConfigError(
                f"{name}: line {line}: a text of {length:,} characters; at most {LONGEST_TEXT:,} are read: shorten it"
            )


def _cut_short(text: str) -> str | None:
    """Say within which statement a file ends, whose last line a parser would drop silently; None if it is complete."""
    last = text.rstrip().rpartition("\n")[2].strip()
    if last.startswith("SG_ "):
        return None if _WHOLE_SIGNAL.search(last) else "a signal"
    if last.startswith("BO_ "):
        return None if _WHOLE_MESSAGE.match(last) else "a message"
    return "a statement" if last.startswith(("CM_ ", "BA_", "VAL_ ", "SIG_")) and not last.endswith(";") else None


def _refuse_ranges(name: str, text: str) -> None:
    """Refuse ranges of multiplexer values that a parser would expand value by value."""
    count = 0
    for selected in _SELECTED.finditer(text):
        for found in _RANGE.finditer(selected[0]):
            if max(len(found[1]), len(found[2])) > MOST_DIGITS:
                count = MOST_SELECTING + 1
            else:
                count += max(0, int(found[2]) - int(found[1]) + 1)
            if count > MOST_SELECTING:
                line = text.count("\n", 0, selected.start()) + 1
                raise ConfigError(f"{name}: line {line}: over {MOST_SELECTING:,} multiplexer values; correct it")


def _messages(database: str, parsed: "Parsed") -> list[MessageInfo]:
    """Give all messages; those of J1939 are marked one by one by `VFrameFormat`, or all at once by `ProtocolType`."""
    all_groups = parsed.dbc is not None and _attribute(parsed.dbc, "ProtocolType") == PROTOCOL
    return [
        _message(database, m, m.is_extended_frame and (all_groups or m.protocol == "j1939")) for m in parsed.messages
    ]


def _message(database: str, m: "Message", group: bool) -> MessageInfo:
    """Give a message; `group`: it is a parameter group of J1939."""
    can_id = m.frame_id | EXTENDED if m.is_extended_frame else m.frame_id
    protected = m.dbc is not None and _attribute(m.dbc, "E2EProfile") == E2E_PROFILE
    e2e = E2E(_data_id(database, m)) if protected else None
    message = MessageInfo(
        database=database,
        name=m.name,
        can_id=can_id,
        length=m.length,
        senders=tuple(m.senders),
        cycle_ns=_cycle_ns(database, m),
        e2e=e2e,
        comment=m.comment or "",
        any_sender=group,
    )
    by_name = {s.name: s for s in m.signals}
    return replace(message, signals={name: _signal(message, s, by_name) for name, s in by_name.items()})


def _cycle_ns(database: str, m: "Message") -> int | None:
    stated: int | float | str | None = m.cycle_time  # of an attribute that a file may declare as anything
    if not stated:
        return None
    try:
        cycle_ms = float(stated)
    except ValueError:
        text = str(stated)[:MOST_SHOWN]
        raise ConfigError(f"{database}: message {m.name}: the cycle time {text!r} is no number; correct it") from None
    if not 0 < cycle_ms <= LONGEST_CYCLE_MS:
        raise ConfigError(
            f"{database}: message {m.name}: a cycle time of {cycle_ms:g} ms; valid: 0 to {LONGEST_CYCLE_MS:g}"
        )
    return round(cycle_ms * 1_000_000)


def _data_id(database: str, m: "Message") -> int:
    """`E2EDataID` of a message that is protected.

    Raises
    ------
    ConfigError
        It has none, or one that is not of 16 bits.
    """
    stated = None if m.dbc is None else _stated(m.dbc, "E2EDataID")
    if stated is None:
        raise ConfigError(f"{database}: message {m.name} has the attribute E2EProfile, but no E2EDataID; add it")
    digits = str(stated).removesuffix(".0")  # of an attribute that is declared as a FLOAT
    if not _DATA_ID.fullmatch(digits) or int(digits) > MOST_DATA_ID:
        raise ConfigError(f"{database}: message {m.name}: E2EDataID {digits[:20]!r}; valid: 0 to {MOST_DATA_ID}")
    return int(digits)


def _signal(message: MessageInfo, s: "Signal", by_name: Mapping[str, "Signal"]) -> SignalInfo:
    place = Place(s.start, s.length, s.byte_order == "big_endian", bool(s.is_signed) and not s.conversion.is_float)
    choices = {int(raw): str(label) for raw, label in (s.conversion.choices or {}).items()}
    for what, number in (("scale", s.conversion.scale), ("offset", s.conversion.offset)):
        if not isfinite(number):
            raise ConfigError(f"{message.database}: signal {message.name}.{s.name} has the {what} {number}; correct it")
    stated = None if (s.minimum, s.maximum) == (0, 0) else s  # [0.0|0.0] states no range, as [0|0] does
    return SignalInfo(
        database=message.database,
        message=message.name,
        name=s.name,
        place=place,
        is_float=s.conversion.is_float,
        scale=float(s.conversion.scale),
        offset=float(s.conversion.offset),
        minimum=None if stated is None or stated.minimum is None else float(stated.minimum),
        maximum=None if stated is None or stated.maximum is None else float(stated.maximum),
        unit=s.unit or "",
        comment=s.comment or "",
        choices=choices,
        mux=_switches(message, s, by_name),
        is_multiplexer=s.is_multiplexer,
        start_raw=None if s.raw_initial is None else float(s.raw_initial),
        j1939=_is_j1939(s, message.any_sender),
        can_id=message.can_id,
        cycle_ns=message.cycle_ns,
    )


def _switches(message: MessageInfo, s: "Signal", by_name: Mapping[str, "Signal"]) -> tuple[Switch, ...]:
    """List the steps to a signal, from the outermost multiplexer inwards.

    Raises
    ------
    ConfigError
        Multiplexers that select each other, or one that the message does not have.
    """
    steps: list[Switch] = []
    while s.multiplexer_signal is not None:
        if len(steps) == len(by_name):
            raise ConfigError(
                f"{message.database}: message {message.name}: multiplexer {s.name} is selected by itself; correct it"
            )
        if s.multiplexer_signal not in by_name:
            raise ConfigError(
                f"{message.database}: message {message.name} has no multiplexer {s.multiplexer_signal}, by which "
                f"{s.name} is selected"
            )
        steps.append(Switch(s.multiplexer_signal, tuple(sorted(s.multiplexer_ids or ()))))
        s = by_name[s.multiplexer_signal]
    return tuple(reversed(steps))


def _is_j1939(s: "Signal", group: bool) -> bool:
    """Decide whether all ones mean "not available".

    A DBC says so by our signal attribute `RawConvention`. Parameter groups of J1939 follow the standard too; there the
    declared range must leave those raw values out, since counters and check sums use them.
    """
    if s.conversion.is_float or s.is_signed or s.length not in (2, 4, 8, 16, 24, 32):
        return False
    convention = _attribute(s.dbc, "RawConvention")
    if convention is not None:
        return convention == "J1939"
    if not group or s.maximum is None or s.is_multiplexer or s.conversion.scale <= 0:
        return False
    error_from = (0xFE << (s.length - 8)) if s.length >= 8 else (1 << s.length) - 2
    return (s.maximum - s.conversion.offset) / s.conversion.scale < error_from


def _attribute(specifics: "DbcSpecifics", name: str) -> str | None:
    """Value of an ENUM attribute as text, or its default; None where the DBC does not define it.

    Files write the value of an ENUM as its number or as its text.
    """
    if name not in specifics.attribute_definitions:
        return None
    value = _stated(specifics, name)
    choices = specifics.attribute_definitions[name].choices or []
    return str(choices[value]) if isinstance(value, int) and 0 <= value < len(choices) else str(value)


def _stated(specifics: "DbcSpecifics", name: str) -> object:
    """Value of an attribute as written, or its default; None where there is neither."""
    if name in specifics.attributes:
        return specifics.attributes[name].value
    definition = specifics.attribute_definitions.get(name)
    return None if definition is None else definition.default_value


_OF_A_LOG = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
"""A line of candump."""


def _explain(name: str, text: str, problem: str) -> str:
    """Turn an error of cantools into one line: file, line number, what is wrong, what to do."""
    detail = problem.removeprefix('DBC: "').removesuffix('"')
    lines = text.splitlines()
    unused = re.findall(r"^ *(VAL_|SIG_VALTYPE_) (\d+) (\w+)$", detail, re.M)
    if unused:
        at: dict[tuple[str, ...], int] = {}
        for n, line in enumerate(lines, 1):
            if stated := _OF_A_SIGNAL.match(line):
                at.setdefault(stated.groups(), n)
        listed = ", ".join(f"line {at.get(one, 0)} ({one[0]} of {one[2]})" for one in unused[:MOST_LISTED])
        listed += f" and {len(unused) - MOST_LISTED} more" if len(unused) > MOST_LISTED else ""
        what = "these lines" if len(unused) > 1 else "this line"
        return f"{name}: {listed}: no message has such a signal; remove {what}"
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
    if syntax and not text.strip():
        return f"{name}: is empty; a DBC is needed"
    if syntax and text.lstrip("\ufeff \t\r\n").startswith("<"):
        return f"{name}: is XML, as ARXML, KCD and web pages are, and no DBC; export the database as DBC"
    if syntax and lines and _OF_A_LOG.match(lines[0]):
        return f"{name}: is a candump log and no DBC; name the vehicle's DBC"
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
