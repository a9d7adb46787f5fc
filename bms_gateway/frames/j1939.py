"""J1939 identifiers: what a message is about, and who sends it.

An identifier of 29 bits is priority (3), data page (2), PDU format (8), PDU specific (8), source address (8). A DBC can
name one sender only, often 0xFE, which is none; the vehicle's may have any address. SAE J1939-21.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.signal_info import MessageInfo

__all__ = ["LAST_ADDRESS", "PROTOCOL", "parameter_group", "sent_from"]

PROTOCOL: Final = "J1939"
"""What a DBC of such messages has in the text of its attributes: `VFrameFormat "J1939PG"`, `ProtocolType "J1939"`."""
LAST_ADDRESS: Final = 253
"""254 is who has none, 255 all."""
_PDU1_BELOW: Final = 240
_BITS: Final = 0x03FFFF00


def parameter_group(can_id: int) -> int:
    """Give the number of the content, without priority, source and (where there is one) destination.

    Examples
    --------
    >>> hex(parameter_group(0x18FEF200)), hex(parameter_group(0x0CEF2117))
    ('0xfef2', '0xef00')
    """
    group = (can_id & _BITS) >> 8
    return group & 0x3FF00 if (group >> 8) & 0xFF < _PDU1_BELOW else group


def sent_from(messages: Iterable[MessageInfo], address: int) -> list[MessageInfo]:
    """Give messages of 29 bits the source address of the sender that there is; others stay."""
    found = []
    for m in messages:
        can_id = (m.can_id & ~0xFF) | address if m.can_id & EXTENDED else m.can_id
        signals = {name: replace(s, can_id=can_id) for name, s in m.signals.items()}
        found.append(replace(m, can_id=can_id, signals=signals))
    return found
