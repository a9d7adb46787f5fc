"""Groups signals of many cells by the similarity of their names, and numbers them."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import lettered, numbers

LETTERS: Final = "ABCDEFGH"
Entry = tuple[Series, tuple[int, ...], tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class Member:
    """A signal of a group: its part (0 if there is only one part) and its number, both from its name.

    Attributes
    ----------
    where : tuple of int
        The numbers in its names that identify the part, without those that are equal for all signals or redundant.
    whole : tuple of int
        The same, with its own number added.
    """

    series: Series
    part: int
    number: int
    where: tuple[int, ...] = ()
    whole: tuple[int, ...] = ()


def alike(series: Iterable[Series]) -> list[list[Member]]:
    """Group signals whose names differ by numbers only, or by one letter A, B … that stands for a number.

    The last number of the signal's name counts within a part; an earlier one, or that of the message where numbers
    come again from message to message, tells the part (a module, a stack, a string). A message without a number goes
    with those that have its name and a number: BAT_Temps, BAT_Temps2.

    Returns
    -------
    list of list of Member
        The largest group first; in each the order of part and number. A signal without a number is alone.
    """
    blanked: dict[tuple[str, str, str], dict[tuple[str, ...], list[Entry]]] = defaultdict(lambda: defaultdict(list))
    some = list(series)
    plain = {s.info.message for s in some}
    first = {_base(m) for m in map(_pattern, plain) if m.endswith("#") and _base(m) in plain}
    for s in some:
        pattern, mine = numbers(s.info.name)
        message, theirs = numbers(s.info.message)
        if message in first:
            theirs = (0,)
        elif message.endswith("#") and _base(message) in first:
            message = _base(message)
        (pattern, my_letters), (message, its_letters) = lettered(pattern), lettered(message)
        blanked[message, pattern, s.info.unit][*its_letters, *my_letters].append((s, theirs, mine))
    groups = [_numbered(group) for variants in blanked.values() for group in _by_letter(variants)]
    return sorted(groups, key=len, reverse=True)


def _pattern(message: str) -> str:
    return numbers(message)[0]


def _base(pattern: str) -> str:
    """Name of a message without the number at its end."""
    return pattern.removesuffix("#").rstrip("_ ")


def _by_letter(variants: dict[tuple[str, ...], list[Entry]]) -> list[list[Entry]]:
    """Merge groups whose names differ by one letter that runs from A; the letter counts as a number."""
    letters = []
    for variant in variants:
        changing = {x for k, x in enumerate(variant) if len({other[k] for other in variants}) > 1}
        letters.append(changing.pop() if len(changing) == 1 else "")
    if sorted(letters) != list(LETTERS[: len(letters)]) or len(letters) < 2:
        return list(variants.values())
    return [
        [
            (s, (1 + LETTERS.index(letter), *theirs), mine)
            for letter, group in zip(letters, variants.values(), strict=True)
            for s, theirs, mine in group
        ]
    ]


def _numbered(group: list[Entry]) -> list[Member]:
    inner = _telling([(*theirs, *mine[:-1]) for _, theirs, mine in group])
    whole = _telling([(*theirs, *mine) for _, theirs, mine in group])
    last = [mine[-1] if mine else 0 for _, _, mine in group]
    if len(set(last)) == len(group):
        places = [(0, n) for n in last]
    else:
        places = [(_part((*theirs, *mine[:-1])), mine[-1] if mine else 0) for _, theirs, mine in group]
        if len(set(places)) < len(places) or len({n for _, n in places}) == 1:
            # only the messages differ: Module1.Temp, Module2.Temp
            places = [(0, _part((*theirs, *mine))) for _, theirs, mine in group]
    members = [
        Member(s, part, number, w, all_of)
        for (s, _, _), (part, number), w, all_of in zip(group, places, inner, whole, strict=True)
    ]
    return sorted(members, key=lambda m: (m.part, m.number, m.series.path))


def _telling(rows: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Columns that differ from row to row, each once."""
    columns = [c for c in dict.fromkeys(zip(*rows, strict=True)) if len(set(c)) > 1]
    return [tuple(row) for row in zip(*columns, strict=True)] if columns else [()] * len(rows)


def _part(given: tuple[int, ...]) -> int:
    part = 0
    for n in given:
        part = 1000 * part + n
    return part
