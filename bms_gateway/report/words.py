"""Sentences as people read them: what an effect is called before its identifier, a true minus sign, no unit of 1.

JSON documents keep the sentences with identifiers alone.
"""

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from bms_gateway.thermal import KINDS
from bms_gateway.thermal.effects import catalogue, effect_named

_MINUS: Final = re.compile(r"(?<![\w.)])-(?=\d)")
_BEFORE: Final = r"(?<![\w(/.\-])"
"""An identifier in brackets stands there already; one in the name of a file is a part of it."""
_PLACE: Final = r"(?: \(((?:after )?cell \d+)\))?"
_AFTER: Final = r"(?![\w:/\-]|\.\w)"


@lru_cache(1)
def _names() -> tuple[re.Pattern[str], re.Pattern[str], dict[str, str]]:
    titles = {name: e.title for name, e in catalogue().items()}
    by_length = sorted(titles, key=len, reverse=True)
    keys = "|".join(n for n in by_length if "_" in n)  # others are words of their own
    both = "|".join(rf"{n}(?::\d+)?{_PLACE}: {re.escape(titles[n])}" for n in by_length)
    alone = rf"{_BEFORE}(?P<name>{keys})(?::(?P<cell>\d+))?{_PLACE}{_AFTER}"
    return re.compile(f"{_BEFORE}({both})"), re.compile(alone), titles


def named(key: str, place: str = "") -> str:
    """Give an effect by its label, its identifier in brackets.

    Examples
    --------
    >>> named("ambient_loss"), named("phase_change:2")
    ('second heat path to the surroundings (ambient_loss)', 'latent heat at the surface (phase_change:2)')
    """
    inside = f"{key}, {place}" if place else key
    return f"{effect_named(key.partition(':')[0]).title} ({inside})"


def named_all(keys: Iterable[str]) -> str:
    """Give several effects so."""
    return " and ".join(named(key) for key in keys)


def labelled(text: str) -> str:
    """Put the label of each effect before its identifier.

    Examples
    --------
    >>> labelled("Missing: entropic_heat: reversible (entropic) heat. See /tmp/end_plate.csv")
    'Missing: reversible (entropic) heat (entropic_heat). See /tmp/end_plate.csv'
    >>> labelled("coolant_delay looks like phase_change (cell 2).")
    'coolant arrives late (coolant_delay) looks like latent heat at the surface (phase_change, cell 2).'
    """
    both, alone, titles = _names()

    def once(m: re.Match[str]) -> str:
        key, _, title = m[0].partition(": ")
        name, _, place = key.partition(" (")
        return f"{title} ({name}{', ' + place.rstrip(')') if place else ''})"

    def label(m: re.Match[str]) -> str:
        key = f"{m['name']}:{m['cell']}" if m["cell"] else m["name"]
        return f"{titles[m['name']]} ({key}{', ' + m[3] if m[3] else ''})"

    return alone.sub(label, both.sub(once, text))


def parameters_labelled(text: str) -> str:
    """Put the label of each parameter of the cells before its symbol.

    Examples
    --------
    >>> parameters_labelled("R_e ends at its bound."), parameters_labelled("all along (R_e)")
    ('internal electrical resistance (R_e) ends at its bound.', 'all along (R_e)')
    """
    symbols = "|".join(sorted(KINDS, key=len, reverse=True))
    return re.sub(rf"{_BEFORE}({symbols}){_AFTER}", lambda m: f"{KINDS[m[1]].description} ({m[1]})", text)


def in_words(text: str) -> str:
    """Write a sentence for a page.

    Examples
    --------
    >>> in_words("Missing: entropic_heat: reversible (entropic) heat. At rest -3.7 A; g = 0.02 ± 0.01 1")
    'Missing: reversible (entropic) heat (entropic_heat). At rest −3.7 A; g = 0.02 ± 0.01'
    """
    return re.sub(r"(± [\d.]+) 1(?=$|;)", r"\1", _MINUS.sub("−", labelled(text)))
