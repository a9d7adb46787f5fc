"""Guessed signals as a DBC, each marked as a guess."""

from collections.abc import Sequence
from typing import Final

from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.dbc_text import format_dbc
from bms_gateway.frames.signal_info import MessageInfo, SignalInfo, Switch
from bms_gateway.setup.bit_fields import Field
from bms_gateway.setup.without_dbc import Guess

GUESS: Final = "GUESS_"
"""Prefix of the names of messages that were guessed."""
COMMENT: Final = (
    "GUESSED by bms-gateway init from the traffic alone, without the DBC of the maker: which bits, their scale and "
    "their offset may all be wrong. Hold each against a clamp meter and a thermometer before anything is built on it."
)
_PAGE: Final = "page"
_UNITS: Final = {"current": "A", "voltage": "V", "surface": "degC"}
_NAMES: Final = {"current": "guess_current_{}", "voltage": "guess_pack_voltage_{}", "surface": "guess_cell_temp_{}"}


def guessed_dbc(guesses: Sequence[Guess], length: dict[int, int]) -> str:
    """Write the guesses as a DBC; of guesses that share bits only the likeliest one.

    Parameters
    ----------
    guesses : sequence of Guess
    length : dict of int to int
        Bytes of each message.
    """
    taken: list[Field] = []
    signals: dict[int, dict[str, SignalInfo]] = {}
    count = dict.fromkeys(_NAMES, 0)
    first_group = next((g for g in guesses if g.role == "surface"), None)
    for g in guesses:
        if g.role == "surface" and g is not first_group:
            continue  # a reader of the file would take another group for further cells of the same pack
        for f in sorted((g.field, *g.beside), key=lambda f: (f.page or 0, f.place.first_bit)):
            if any(f.overlaps(other) for other in taken) or (f.page is None and _has_pages(f, taken)):
                continue
            taken.append(f)
            count[g.role] += 1
            s = _signal(f, _NAMES[g.role].format(count[g.role]), g.scale, g.offset, _UNITS[g.role])
            mine = signals.setdefault(f.can_id, {})
            if f.page is not None:
                page = Field(f.can_id, None, f.selector, f.t, f.x)
                mine.setdefault(_PAGE, _signal(page, _PAGE, 1.0, 0.0, "", selects=True))
            mine[s.name] = s
    messages = [
        MessageInfo("guessed.dbc", _message(i), i, length[i], ("Vehicle",), None, None, "", mine)
        for i, mine in signals.items()
    ]
    wanted = [s for mine in signals.values() for s in mine.values() if not s.is_multiplexer]
    return format_dbc(messages, wanted, COMMENT)


def _has_pages(f: Field, taken: Sequence[Field]) -> bool:
    return any(f.can_id == other.can_id and other.page is not None for other in taken)


def _message(can_id: int) -> str:
    return f"{GUESS}{can_id & ~EXTENDED:X}"


def _signal(f: Field, name: str, scale: float, offset: float, unit: str, *, selects: bool = False) -> SignalInfo:
    mux = () if f.page is None else (Switch(_PAGE, (f.page,)),)
    raw = (-(1 << f.place.size - 1), (1 << f.place.size - 1) - 1) if f.place.signed else (0, (1 << f.place.size) - 1)
    low, high = (round(scale * end + offset, 9) for end in raw)
    return SignalInfo(
        "guessed.dbc", _message(f.can_id), name, f.place, False, scale, offset, low, high, unit, "", {}, mux,
        selects, None, False, f.can_id, None,
    )  # fmt: skip
