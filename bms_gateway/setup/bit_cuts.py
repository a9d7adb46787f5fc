"""Overlapping cuts of one field: which of them is the likeliest, so that one field is proposed once.

Two bytes are cut into both bytes, twelve bits from either end and all sixteen. Where the parts of a cut belong to each
other, they move as the digits of one number do:

* where the upper part changes, the lower part changes too, and jumps from one end to the other (the carry);
* while the upper part stays, the lower part moves less than at random.

Of the cuts whose parts belong together, the one with the most bits that live is the field: a shorter one cuts digits
off, a longer one takes bits in that never change or that belong to something else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from bms_gateway.setup.bit_fields import Field

CHANGES_TOO: Final = 0.75
"""Least share of the changes of the upper part at which the lower part changes; 15 of 16 for digits of one number."""
CARRIES: Final = 0.2
"""Least mean jump of the lower part at changes of the upper, over its range; a third for a number that moves fast."""
AT_RANDOM: Final = 0.8 / 3.0
"""Mean step of the lower part over its range from which on it goes on at random while the upper stays; a third."""
FAST: Final = 0.25
"""Share of the samples at which the upper part changes: above it, the last digits are random anyway."""
COUNTS: Final = 0.85
"""Share of the steps of a counter that are the same."""
JUDGED: Final = 20
"""Least samples with an upper part that stays."""
FEWEST_TURNS: Final = 4
"""Changes of the upper part, from which on it is known whether both are one number."""
BYTE: Final = 8
NIBBLE: Final = 4

Joint = Literal["one", "apart", "not told"]


@dataclass(frozen=True, slots=True)
class Cut:
    """What a field is as a cut of its two bytes.

    Attributes
    ----------
    whole : bool
        Nothing tells that its parts are of different fields.
    across : bool
        The data tell that one number goes across its two bytes.
    alive : int
        Bits from the lowest to the highest that change.
    idle : int
        Other bits. The highest four of sixteen do not count: fields of two bytes are commoner than such of twelve bits.
    """

    whole: bool
    across: bool
    alive: int
    idle: int

    @property
    def rank(self) -> tuple[bool, int, int]:
        """The greater, the likelier."""
        return self.whole, self.alive, -self.idle


def likeliest_cuts(fields: Sequence[Field]) -> list[Field]:
    """Keep one cut of each field.

    Parameters
    ----------
    fields : sequence of Field
        Cuts of messages; their order is kept.

    Returns
    -------
    list of Field
        Without the cuts that are parts of a likelier one, or mix it with something else.
    """
    of_two: dict[tuple[int, int | None, bool, int], list[Field]] = {}
    of_one: dict[tuple[int, int | None, int], Field] = {}
    for f in fields:
        first = min(f.place.bits) // BYTE
        if f.place.size == BYTE:
            of_one[f.can_id, f.page, first] = f
        else:
            of_two.setdefault((f.can_id, f.page, f.place.big_endian, first), []).append(f)
    dropped: set[int] = set()
    found: dict[tuple[int, int | None, int], list[tuple[bool, list[Field]]]] = {}
    for (can_id, page, _, first), mine in of_two.items():
        cuts = [cut_of(f) for f in mine]
        best = max(range(len(mine)), key=lambda k: cuts[k].rank)
        halves = [of_one[key] for k in (0, 1) if (key := (can_id, page, first + k)) in of_one]
        across = cuts[best].whole and cuts[best].across
        if across or (cuts[best].whole and not halves):
            dropped |= {id(f) for k, f in enumerate(mine) if k != best} | {id(f) for f in halves}
        elif halves:
            dropped |= {id(f) for f, c in zip(mine, cuts, strict=True) if not c.whole}
        found.setdefault((can_id, page, first), []).append((across, mine))
    for orders in found.values():  # one number goes across these bytes in one order: the other one is no number
        if any(across for across, _ in orders):
            dropped |= {id(f) for across, mine in orders if not across for f in mine}
    return [f for f in fields if id(f) not in dropped]


def cut_of(f: Field) -> Cut:
    """Judge a cut of twelve or sixteen bits."""
    size = f.place.size
    raw = f.x.astype(np.int64) & ((1 << size) - 1)
    changed = int(np.bitwise_or.reduce(raw[1:] ^ raw[:-1])) if len(raw) > 1 else 0
    top = changed.bit_length()
    bottom = (changed & -changed).bit_length() - 1 if changed else 0
    bottom -= bottom % NIBBLE  # a number may be sent in steps of two
    joints = {m: _joint(raw, m) for m in range(NIBBLE, size, NIBBLE)}
    above = max(size - top - (NIBBLE if size == 2 * BYTE else 0), 0)
    return Cut("apart" not in joints.values(), joints[_border(f)] == "one", top - bottom, above + bottom)


def _border(f: Field) -> int:
    """Bits of a cut that lie in the byte of its lower part."""
    lowest = f.place.first_bit if not f.place.big_endian else 7 - (f.place.first_bit + f.place.size - 1) % BYTE
    return BYTE - lowest % BYTE


def _joint(raw: NDArray[np.int64], m: int) -> Joint:
    """Tell whether what lies above bit `m` and the `m` bits below are digits of one number."""
    upper, lower = raw >> m, raw & ((1 << m) - 1)
    step = np.diff(lower)
    turns, jump = np.diff(upper) != 0, np.abs(step) / (1 << m)
    if turns.sum() < FEWEST_TURNS or not step.any():
        return "not told"
    at_turns, between = jump[turns], jump[~turns]
    if (at_turns > 0).mean() < CHANGES_TOO or at_turns.mean() < CARRIES:
        return "apart"
    if np.unique(step & ((1 << m) - 1), return_counts=True)[1].max() > COUNTS * len(step) and step.all():
        return "apart"
    return "apart" if turns.mean() < FAST and len(between) >= JUDGED and between.mean() > AT_RANDOM else "one"
