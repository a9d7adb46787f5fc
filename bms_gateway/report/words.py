"""Sentences for people: an effect by its label before its identifier, a true minus sign, printed units.

JSON documents contain the sentences with identifiers alone.
"""

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Final

from bms_gateway.thermal import KINDS
from bms_gateway.thermal.effects import catalogue, effect_named

_MAPPED: Final = re.compile(r" \(map (it|them): --columns .*\)")
_PAIR: Final = r"--columns '.*?\]'(?:, or \[°C\] if \w is a name)?"
_CHOSEN: Final = (
    (re.compile(rf"\bsay (?:it|which is right): {_PAIR}"), "choose its unit in the table of the columns"),
    (re.compile(rf"\bSay it: {_PAIR}"), "Choose their unit in the table of the columns"),
    (
        re.compile(r"\(a constant inlet: --columns '.*?'\)"),
        "(a constant inlet is typed above the table of the columns)",
    ),
    (
        re.compile(r"\bFlip it with --columns current_A=-COLUMN"),
        "Tick “Sign −” of the current in the table of the columns",
    ),
)
"""Where a person does on the page what an option does for the commands."""
_UNITS: Final = {"mOhm": "mΩ", "Ohm": "Ω", "degC": "°C", "m2": "m²", "m3/s": "m³/s", "1": ""}
"""Units in model files and JSON, which can be typed, and in print."""
_WRITTEN: Final = re.compile(rf"(?<=\d )({'|'.join(u for u in _UNITS if u != '1')})(?![\w/])")
_MINUS: Final = re.compile(r"(?<![\w.)])-(?=\d)")
_BEFORE: Final = r"(?<![\w(/.\-])"
"""An identifier in brackets already has its label; one in the name of a file is a part of the name."""
_PLACE: Final = r"(?: \(((?:after )?cells? \d+(?:(?: to |, )\d+)*)\))?"
_AFTER: Final = r"(?![\w/\-]|:\S|\.\w)"


@lru_cache(1)
def _names() -> tuple[re.Pattern[str], re.Pattern[str], dict[str, str]]:
    titles = {name: e.title for name, e in catalogue().items()}
    by_length = sorted(titles, key=len, reverse=True)
    keys = "|".join(n for n in by_length if n not in titles[n].split())  # others are words of their own
    both = "|".join(rf"{n}(?::\d+)?{_PLACE}: {re.escape(titles[n])}" for n in by_length)
    alone = rf"{_BEFORE}(?P<name>{keys})(?::(?P<cell>\d+))?{_PLACE}{_AFTER}"
    return re.compile(f"{_BEFORE}({both})"), re.compile(alone), titles


def unit(name: str) -> str:
    """Return the printed form of a unit; nothing for the unit of a share.

    Examples
    --------
    >>> unit("mOhm"), unit("K/W"), unit("1")
    ('mΩ', 'K/W', '')
    """
    return _UNITS.get(name, name)


def named(key: str, place: str = "") -> str:
    """Return an effect by its label, with its identifier in brackets.

    Examples
    --------
    >>> named("ambient_loss"), named("phase_change:2")
    ('second heat path to the surroundings (ambient_loss)', 'latent heat at the surface (phase_change:2)')
    """
    inside = f"{key}, {place}" if place else key
    return f"{effect_named(key.partition(':')[0]).title} ({inside})"


def named_all(keys: Iterable[str]) -> str:
    """Return several effects in this form."""
    return " and ".join(named(key) for key in keys)


def labelled(text: str) -> str:
    """Put the label of each effect before its identifier.

    Examples
    --------
    >>> labelled("To tell it from end_plate: cool it down.")
    'To tell it from end plates cool or warm the end cells (end_plate): cool it down.'
    >>> labelled("Missing: entropic_heat: reversible (entropic) heat. See /tmp/end_plate.csv")
    'Missing: reversible (entropic) heat (entropic_heat). See /tmp/end_plate.csv'
    >>> labelled("They ask for polarization, not for hysteresis.")
    'They ask for slow polarisation (one RC pair) (polarization), not for hysteresis.'
    >>> labelled("coolant_delay looks like phase_change (cell 2).")
    'coolant arrives late (coolant_delay) looks like latent heat at the surface (phase_change, cell 2).'
    >>> labelled("phase_change (cells 2 to 7, 9) looks the same.")
    'latent heat at the surface (phase_change, cells 2 to 7, 9) looks the same.'
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


def parameter_named(effects: Iterable[str], name: str) -> str:
    """Return a number of an effect by its label, with its symbol in brackets; without an effect only the symbol.

    Examples
    --------
    >>> parameter_named(["entropic_heat"], "dUdT"), parameter_named([], "x")
    ('level of the entropic coefficient (dUdT)', 'x')
    """
    known = (p for key in effects for p in effect_named(key.partition(":")[0]).parameters)
    return next((f"{p.description} ({name})" for p in known if p.name == name), name)


def parameters_labelled(text: str) -> str:
    """Put the label of each parameter of the cells, and of an effect, before its symbol.

    Examples
    --------
    >>> parameters_labelled("R_e ends at its bound."), parameters_labelled("all along (R_e)")
    ('internal electrical resistance (R_e) ends at its bound.', 'all along (R_e)')
    >>> parameters_labelled("resistance_drift.a ends 3.3 sd from what was known of it.")
    'growth (resistance_drift.a) ends 3.3 sd from what was known of it.'
    """
    text = _own_parameters().sub(_own_label, text)
    symbols = "|".join(sorted(KINDS, key=len, reverse=True))
    return re.sub(rf"{_BEFORE}({symbols}){_AFTER}", lambda m: f"{KINDS[m[1]].description} ({m[1]})", text)


@lru_cache(1)
def _own_parameters() -> re.Pattern[str]:
    return re.compile(rf"{_BEFORE}(?P<effect>{'|'.join(catalogue())})(?P<place>:\d+)?\.(?P<name>\w+)")


def _own_label(m: re.Match[str]) -> str:
    p = next((p for p in effect_named(m["effect"]).parameters if p.name == m["name"]), None)
    return f"{p.description} ({m[0]})" if p else m[0]


def in_words(text: str) -> str:
    """Write a sentence for a page.

    Examples
    --------
    >>> in_words("Missing: entropic_heat: reversible (entropic) heat. At rest -3.7 A; R_1 = 0.2 ± 0.1 mOhm.")
    'Missing: reversible (entropic) heat (entropic_heat). At rest −3.7 A; R_1 = 0.2 ± 0.1 mΩ.'
    """
    return _WRITTEN.sub(lambda m: unit(m[0]), _MINUS.sub("−", labelled(text)))


def on_page(text: str) -> str:
    """Write a sentence for the page, which has a table of the columns in place of `--columns`.

    Examples
    --------
    >>> on_page("a.csv: no column 'current_A'; 'I (A)' may be it (map it: --columns 'current_A=I (A)')")
    "a.csv: no column 'current_A'; 'I (A)' may be it: say in the table of the columns which one it is"
    >>> on_page("half of its values are above 291 °C: are they in K? Say it: --columns 'surface_1_C=COLUMN [K]'")
    'half of its values are above 291 °C: are they in K? Choose their unit in the table of the columns'
    """
    constant = ", or type the inlet above it" if "; a constant: --columns" in text else ""
    text = _MAPPED.sub(f": say in the table of the columns which one it is{constant}", text)
    for typed, chosen in _CHOSEN:
        text = typed.sub(chosen, text)
    return text
