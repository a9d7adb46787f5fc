"""J1939 identifiers: content of a message, and its sender.

An identifier of 29 bits is priority (3), data page (2), PDU format (8), PDU specific (8), source address (8). A DBC can
name one sender only, often 0xFE, which is no address; the vehicle's sender may have any address. SAE J1939-21.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.frames.signal_info import MessageInfo

__all__ = ["LAST_ADDRESS", "MARK", "PROTOCOL", "Senders", "group_mask", "parameter_group", "sent_from"]

PROTOCOL: Final = "J1939"
"""Value of the attribute `ProtocolType` of a DBC whose messages of 29 bits are all parameter groups."""
MARK: Final = f'BA_DEF_ "ProtocolType" STRING; BA_ "ProtocolType" "{PROTOCOL}";'
"""Line of a DBC that contains it."""
LAST_ADDRESS: Final = 253
"""254 means no address, 255 all addresses."""
_PDU1_BELOW: Final = 240
_TO_ALL: Final = 0x03FF_FF00
_TO_ONE: Final = 0x03FF_0000


def group_mask(can_id: int) -> int:
    """Return the bits of the content: without priority, source and (if there is one) destination.

    Examples
    --------
    >>> hex(group_mask(0x18FEF200)), hex(group_mask(0x0CEF2117))
    ('0x3ffff00', '0x3ff0000')
    """
    return _TO_ONE if can_id >> 16 & 0xFF < _PDU1_BELOW else _TO_ALL


def parameter_group(can_id: int) -> int:
    """Return the number of the content, without priority, source and (if there is one) destination.

    Examples
    --------
    >>> hex(parameter_group(0x18FEF200)), hex(parameter_group(0x0CEF2117))
    ('0xfef2', '0xef00')
    """
    return (can_id & group_mask(can_id)) >> 8


def sent_from(messages: Iterable[MessageInfo], address: int) -> list[MessageInfo]:
    """Give messages of 29 bits the source address of the sender on the bus; others are kept."""
    found = []
    for m in messages:
        can_id = (m.can_id & ~0xFF) | address if m.can_id & EXTENDED else m.can_id
        signals = {name: replace(s, can_id=can_id) for name, s in m.signals.items()}
        found.append(replace(m, can_id=can_id, signals=signals, any_sender=False))
    return found


class Senders:
    """Senders of the parameter groups that are read: the address of the DBC, or the first one that is received.

    The first sender of a group is kept, so that two packs with the same group are never mixed. A frame from the address
    of the DBC changes this: this address is then the sender.

    Parameters
    ----------
    can_ids : iterable of int
        Identifiers that are read.
    known : iterable of int, optional
        All parameter groups of the DBC. A group with two senders in the DBC is read from these senders only.

    Examples
    --------
    >>> senders = Senders([0x98FEF1FE])
    >>> frames = FrameBatch(np.zeros(2, np.int64), np.array([0x98FEF156, 0x98FEF157], np.uint32),
    ...                     np.full(2, 8, np.uint8), np.zeros((2, 8), np.uint8))
    >>> [hex(i) for i in senders.named(frames).can_id.tolist()]
    ['0x98fef1fe', '0x98fef157']
    >>> senders.heard
    {2566844926: 86}
    """

    def __init__(self, can_ids: Iterable[int], known: Iterable[int] = ()) -> None:
        read = set(can_ids)
        groups = Counter(parameter_group(i) for i in read.union(known))
        named = {parameter_group(i): i for i in read if groups[parameter_group(i)] == 1}
        self._named = dict(sorted(named.items()))
        self._groups = np.array(list(self._named), np.uint32)
        self._sender: dict[int, int] = {}

    @property
    def can_ids(self) -> list[int]:
        """Identifiers of the DBC whose sender may differ."""
        return list(self._named.values())

    @property
    def heard(self) -> dict[int, int]:
        """Address from which the frames of a DBC identifier come, where it is not the address in the DBC."""
        return {self._named[g]: i & 0xFF for g, i in self._sender.items() if i != self._named[g]}

    def named(self, frames: FrameBatch) -> FrameBatch:
        """Replace the identifiers of the senders' frames by those of the DBC."""
        if not len(self._groups) or not len(frames):
            return frames
        group = _groups_of(frames.can_id)
        at = np.minimum(self._groups.searchsorted(group), len(self._groups) - 1)
        ours = (self._groups[at] == group) & (frames.can_id & EXTENDED != 0)
        if not ours.any():
            return frames
        can_id, place = frames.can_id, np.arange(len(frames))
        for g in np.unique(group[ours]).tolist():
            named, mine = self._named[g], (ours & (group == g)).nonzero()[0]
            sender = self._sender.setdefault(g, int(frames.can_id[mine[0]]))
            own = mine[frames.can_id[mine] == named]
            if len(own):
                self._sender[g] = named
            if sender != named:
                until = own[0] if len(own) else len(frames)
                can_id = np.where((frames.can_id == sender) & (place < until), np.uint32(named), can_id)
        return frames if can_id is frames.can_id else FrameBatch(frames.time_ns, can_id, frames.length, frames.data)


def _groups_of(can_id: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Parameter groups of many identifiers, as `parameter_group`."""
    to_one = (can_id >> np.uint32(16) & np.uint32(0xFF)) < _PDU1_BELOW
    return (can_id & np.where(to_one, np.uint32(_TO_ONE), np.uint32(_TO_ALL))) >> np.uint32(8)
