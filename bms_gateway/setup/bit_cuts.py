"""Choice among overlapping cuts of one field: only the likeliest cut is proposed.

Two bytes are cut into both bytes, twelve bits from either end and all sixteen. The parts of a correct cut move like the
digits of one number:

* when the upper part changes, the lower part changes too, and jumps from one end to the other (the carry);
* while the upper part is constant, the lower part changes less than a random number.

Of the cuts with such parts, the one with the most changing bits is the field: a shorter one loses digits, a longer one
includes bits that never change or belong to another field.
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
"""Mean step of the lower part, relative to its range, from which it counts as random while the upper part
is constant; a random number has a third."""
FAST: Final = 0.25
"""Share of samples with a change of the upper part, above which the last digits are random anyway."""
COUNTS: Final = 0.85
"""Share of the steps of a counter that are the same."""
JUDGED: Final = 20
"""Least number of samples with a constant upper part."""
FEWEST_TURNS: Final = 4
"""Number of changes of the upper part that is enough to decide whether both parts are one number."""
BYTE: Final = 8
NIBBLE: Final = 4

Joint = Literal["one", "apart", "not told"]


@dataclass(frozen=True, slots=True)
class Cut:
    """Evidence for a field as a cut of its two bytes.

    Attributes
    ----------
    whole : bool
        Whether nothing shows that its parts belong to different fields.
    across : bool
        Whether the data show that one number extends over its two bytes.
    alive : int
        Number of bits from the lowest to the highest changing one.
    idle : int
        Number of other bits. The highest four of sixteen do not count: fields of two bytes are more common than fields
        of twelve bits.
    """

    whole: bool
    across: bool
    alive: int
    idle: int

    @property
    def rank(self) -> tuple[bool, int, int]:
        """Rank of the cut: a greater one is likelier."""
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
        Without cuts that are part of a likelier one, or mix it with bits of another field.
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
    for orders in found.values():  # one number extends over these bytes in one byte order: the other order is no number
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
    """Decide whether the bits from `m` upwards and the `m` bits below are digits of one number."""
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
