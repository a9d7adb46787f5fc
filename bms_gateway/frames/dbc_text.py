"""Write single signals of a parsed DBC as a new DBC, for a file that holds only the needed signals."""

from collections.abc import Iterable, Sequence

from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo

__all__ = ["format_dbc"]

_HEAD = """VERSION ""

NS_ :

BS_:

BU_: Vehicle Gateway
"""
_CONVENTION = """BA_DEF_ SG_ "RawConvention" ENUM "Plain","J1939";
BA_DEF_DEF_ "RawConvention" "Plain";
"""
_GROUPS = """BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
"""


def format_dbc(messages: Iterable[MessageInfo], signals: Iterable[SignalInfo], comment: str = "") -> str:
    """Write a DBC with these signals and the multiplexers that lead to them.

    Parameters
    ----------
    messages : iterable of MessageInfo
        At least those of the signals.
    signals : iterable of SignalInfo
        To be written with their own place, scale and range, not with those of the message.
    comment : str
        Of the whole file.

    Returns
    -------
    str
        `dbc.parse` gives these signals again, and which messages are parameter groups of J1939.
    """
    wanted: dict[str, dict[str, SignalInfo]] = {}
    for s in signals:
        wanted.setdefault(s.message, {})[s.name] = s
    blocks: list[str] = []
    values: list[str] = []
    switches: list[str] = []
    kinds: list[str] = []
    raw: list[str] = []
    groups: list[str] = []
    for m in messages:
        if m.name not in wanted:
            continue
        mine = dict(wanted[m.name])
        for s in list(mine.values()):
            for step in s.mux:
                mine.setdefault(step.signal, m.signals[step.signal])
        inner = {step.signal for s in mine.values() for step in s.mux}
        length = max([m.length, *(s.place.bytes_needed for s in mine.values())])
        lines = [f"BO_ {_number(m.can_id)} {m.name}: {length} Vehicle"]
        for s in mine.values():
            lines.append(_signal(s, s.name in inner))
            _beside(s, _number(m.can_id), switches, kinds, values, raw)
        blocks.append("\n".join(lines))
        if m.any_sender:
            groups.append(f'BA_ "VFrameFormat" BO_ {_number(m.can_id)} 3;')
    told = [f'CM_ "{_plain(comment)}";'] if comment else []
    parts: list[Sequence[str]] = [
        [_HEAD],
        blocks,
        [""],
        told,
        [_CONVENTION] if raw or groups else [],
        [_GROUPS] if groups else [],
        groups,
        raw,
        values,
        kinds,
        switches,
    ]
    return "\n".join(line for part in parts for line in part) + "\n"


def _beside(
    s: SignalInfo, number: int, switches: list[str], kinds: list[str], values: list[str], raw: list[str]
) -> None:
    """Add the statements of a DBC about a signal outside its message."""
    if s.mux and (len(s.mux) > 1 or len(s.mux[-1].values) > 1):
        ranges = ", ".join(f"{v}-{v}" for v in s.mux[-1].values)
        switches.append(f"SG_MUL_VAL_ {number} {s.name} {s.mux[-1].signal} {ranges};")
    if s.is_float:
        kinds.append(f"SIG_VALTYPE_ {number} {s.name} : {2 if s.place.size == 64 else 1};")
    if s.choices:
        pairs = " ".join(f'{v} "{_plain(label)}"' for v, label in s.choices.items())
        values.append(f"VAL_ {number} {s.name} {pairs} ;")
    if s.j1939:
        raw.append(f'BA_ "RawConvention" SG_ {number} {s.name} 1;')


def _number(can_id: int) -> int:
    return (can_id & ~EXTENDED) | 0x80000000 if can_id & EXTENDED else can_id


def _signal(s: SignalInfo, selects: bool) -> str:
    m = f" m{s.mux[-1].values[0]}{'M' if selects else ''}" if s.mux else " M" if selects else ""
    order, sign = int(not s.place.big_endian), "-" if s.place.signed or s.is_float else "+"
    low, high = (0.0 if x is None else x for x in (s.minimum, s.maximum))
    if (s.minimum is None) != (s.maximum is None):
        ends = sorted(r * s.scale + s.offset for r in s.raw_limits)
        low, high = ends[0] if s.minimum is None else low, ends[1] if s.maximum is None else high
    return (
        f" SG_ {s.name}{m} : {s.place.start}|{s.place.size}@{order}{sign} ({s.scale!r},{s.offset!r}) "
        f'[{low!r}|{high!r}] "{_plain(s.unit)}" Gateway'
    )


def _plain(text: str) -> str:
    return text.replace('"', "'").replace("\\", "/")
