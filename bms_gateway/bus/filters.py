"""Kernel receive filters for a set of identifiers.

The kernel takes at most 512 filters on a raw socket and looks up exact ones by hash, masked ones one after the other.
Up to the limit, every id gets its exact filter. Beyond it, low bits are dropped, as few as necessary. The unwanted ids
that then pass cost a little copying, and the decoder skips them.
"""

from collections.abc import Iterable
from typing import Final

from bms_gateway.bus.canframe import RTR
from bms_gateway.frames.batch import EXTENDED
from bms_gateway.frames.j1939 import group_mask

LIMIT: Final = 512  # CAN_RAW_FILTER_MAX


MOST_GROUPS: Final = 256
"""Filters of parameter groups; further ones are read from the address of the DBC only."""


def group_filters(can_ids: Iterable[int]) -> list[tuple[int, int]]:
    """Cover parameter groups of J1939, whoever sends them and with whatever priority.

    Examples
    --------
    >>> [f"{i:X}/{m:X}" for i, m in group_filters([0x98FEF156, 0x8CEF2117])]
    ['80EF0000/C3FF0000', '80FEF100/C3FFFF00']
    """
    masks = {c: group_mask(c) for c in can_ids}
    return sorted({(c & m | EXTENDED, m | EXTENDED | RTR) for c, m in masks.items()})


def join_filters(can_ids: Iterable[int], limit: int = LIMIT) -> list[tuple[int, int]]:
    """Cover identifiers by few (id, mask) pairs.

    Parameters
    ----------
    can_ids : iterable of int
        Wanted, `EXTENDED` set for 29-bit ones.
    limit : int
        Most pairs allowed, at least 2.

    Returns
    -------
    list of (int, int)
        Every wanted id passes one of them: ``can_id & mask == id & mask``. A standard id never passes for an extended
        one, nor a remote frame for a data frame.

    Examples
    --------
    >>> [f"{i:X}/{m:X}" for i, m in join_filters([0x100, 0x101, 0x200], limit=2)]
    ['100/C00007FE', '200/C00007FE']
    """
    wanted = set(can_ids)
    dropped = 0
    while len(bases := {c >> dropped << dropped | c & EXTENDED for c in wanted}) > limit and dropped < 29:
        dropped += 1
    low = (1 << dropped) - 1
    # EFF and RTR in the mask: without them the kernel does not use its hash table
    return [(base, ((0x1FFF_FFFF if base & EXTENDED else 0x7FF) & ~low) | EXTENDED | RTR) for base in sorted(bases)]
