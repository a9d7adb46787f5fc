"""Descriptions of a cell in words: `lg_m50 forced 2p`, `21700 5Ah 69g 25mOhm`, `pouch 290x216x7.1mm 33Ah plate`."""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from bms_gateway.errors import UsageError, did_you_mean
from bms_gateway.thermal.cells.facts import CellFacts
from bms_gateway.thermal.cells.published import FORMATS, PUBLISHED

_NUMBER = r"(\d+(?:[.]\d+)?)"
_MEASURE = re.compile(rf"{_NUMBER}\s*(Ah|mAh|g|kg|mOhm|mΩ|Ohm|Ω|uOhm|p|mm)(dc|ac)?", re.IGNORECASE)
_BOX = re.compile(rf"{_NUMBER}x{_NUMBER}(?:x{_NUMBER})?(?:mm)?", re.IGNORECASE)
_APART = re.compile(r"(\d)\s+(Ah|mAh|g|kg|mOhm|mΩ|Ohm|Ω|uOhm|mm)\b", re.IGNORECASE)
_TIMES = re.compile(r"(?<=\d)(?:(?:\s*mm)?\s+[x×*]\s+|(?:mm)?[x×*])(?=\d)", re.IGNORECASE)
_MODEL = re.compile(
    r"(?=[A-Z]|\d+[-_])(?:[IUN][NCMF]?R|US)?(14500|18650|20700|21700|26650)[-_]?([A-Z]?(\d\d)[A-Z]{0,2}\d?|[A-Z]{0,3}\d?)",
    re.IGNORECASE,
)
"""A maker's model, as INR21700-50E: letters of chemistry and shape, the format, tenths of Ah, letters of the series."""
_DENSE = 400.0
"""Ah/l; more than any cell has."""
_SAID: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "cooling": ("still", "forced", "plate", "liquid"),
        "orientation": ("standing", "lying"),
        "chemistry": ("LFP", "NMC", "NCA", "LMO", "LCO"),
        "resistance_kind": ("dc", "ac"),
    }
)
_PLAIN: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {word.lower(): (field, word) for field, all_words in _SAID.items() for word in all_words}
)
_ALSO: Final[Mapping[str, str]] = MappingProxyType(
    {
        r"still\s+air": "still",
        r"(?:a\s+)?fan": "forced",
        r"(?:a\s+)?cold\s+plate": "plate",
        r"a\s+liquid": "liquid",
    }
)
"""What the form of the workbench calls the ways of cooling."""
_VALID: Final = "; ".join(f"{field.replace('_kind', '')}: {', '.join(all_words)}" for field, all_words in _SAID.items())
SHAPES: Final = ("pouch", "prismatic", "cylinder")
WORDS: Final = (*PUBLISHED, *FORMATS, *SHAPES, *_PLAIN)
EXAMPLE: Final = "as in '21700 5Ah 69g 25mOhm forced 2p' or 'pouch 290x216x7.1mm 33Ah 787g still'"
_LIGHT, _HEAVY = 900.0, 4500.0  # kg/m³: half and one and a half times what cells have
_BOUNDS: Final[Mapping[str, tuple[float, float, str]]] = MappingProxyType(
    {
        "capacity_Ah": (0.01, 1000.0, "0.01 to 1000 Ah"),
        "mass": (1e-3, 20.0, "1 g to 20 kg"),
        "resistance": (1e-5, 1.0, "0.01 mOhm to 1 Ohm"),
        "parallel": (1, 500, "1p to 500p"),
        "spacing": (0.0, 0.1, "0 to 100 mm"),
        "size": (1e-3, 2.0, "1 mm to 2 m"),
    }
)


def cell_of(text: str) -> CellFacts:
    """Read a cell's description.

    Parameters
    ----------
    text : str
        Words separated by blanks or commas: a published name, a format or a maker's model (`INR21700-50E`), then
        capacity (`5Ah`), mass (`69g`), resistance (`25mOhm`, `25mOhm ac` at 1 kHz), parallel count (`2p`), gap (`2mm`),
        cooling, orientation,
        chemistry. The size of flat cells is `290x216x7.1mm`, length, width and thickness; of odd cylinders
        `cylinder 32x113mm`.

    Raises
    ------
    UsageError
        A word is not known, or something is missing or not plausible; with the nearest valid choice.

    Examples
    --------
    >>> cell_of("INR21700-48X").capacity_Ah, cell_of("prismatic 174 x 207 x 72 mm 280 Ah").capacity_Ah
    (4.8, 280.0)
    >>> c = cell_of("21700, 5Ah, 69g, 25mOhm, forced, 2p")
    >>> c.capacity_Ah, c.parallel, c.cooling
    (5.0, 2, 'forced')
    >>> cell_of("21700,5Ah,69g").capacity_Ah
    5.0
    >>> cell_of("21700 5Ah, a fan").cooling, cell_of("pouch 290x216x7.1mm cold plate").name
    ('forced', 'pouch 290x216x7.1mm plate')
    """
    text = re.sub(r"\b(\d{4,5}),(?=\d)", r"\1 ", text)  # after a format, a comma parts two words
    if (comma := re.search(r"\d+,\d+[a-zA-ZΩ]*", text)) is not None:
        raise UsageError(f"cell: '{comma[0]}': decimals take a point, as '{comma[0].replace(',', '.')}'")
    told = _APART.sub(r"\1\2", _TIMES.sub("x", text.strip()))  # "280 Ah", "174 x 207 x 72 mm"
    for pattern, word in _ALSO.items():
        told = re.sub(rf"\b{pattern}\b", word, told, flags=re.IGNORECASE)
    words = [w for w in re.split(r"[\s,;]+", told) if w]
    if not words:
        raise UsageError(f"cell: says nothing; {EXAMPLE}")
    cell, rest = _kind(words)
    _refuse_twice(rest)
    for word in rest:
        cell = _told(cell, word)
    if not cell.size:
        shown = "127x43x9.5mm" if cell.shape != "cylinder" else "32x113mm"
        raise UsageError(f"cell '{text}': the size of a {cell.shape} cell is needed, as {shown}")
    if cell.capacity_Ah is not None and cell.capacity_Ah > 1e3 * cell.volume * _DENSE:
        raise UsageError(
            f"cell '{text}': {cell.capacity_Ah:g} Ah in {1e6 * cell.volume:.3g} cm³ is no cell; "
            f"valid: up to {1e3 * cell.volume * _DENSE:.3g} Ah"
        )
    if cell.mass is not None and not _LIGHT <= cell.mass / cell.volume <= _HEAVY:
        raise UsageError(
            f"cell '{text}': {1e3 * cell.mass:g} g in {1e6 * cell.volume:.3g} cm³ is no cell; "
            f"valid: {_LIGHT / 1e3:g} to {_HEAVY / 1e3:g} g/cm³"
        )
    if cell.name in SHAPES or cell.name in FORMATS or rest:
        cell = replace(cell, name=" ".join(words))
    return cell


def _refuse_twice(words: list[str]) -> None:
    """Refuse two different counts in parallel, capacities or masses."""
    said: dict[str, str] = {}
    for word in words:
        measure = _MEASURE.fullmatch(word)
        unit = "" if measure is None else measure[2].lower()
        kind = {"p": "p", "ah": "Ah", "mah": "Ah", "g": "g", "kg": "g"}.get(unit)
        if kind is not None and said.setdefault(kind, word.lower()) != word.lower():
            raise UsageError(f"cell: '{said[kind]}' and '{word}' contradict each other: say one of them")


def _kind(words: list[str]) -> tuple[CellFacts, list[str]]:
    by_name: dict[str, CellFacts] = {_plain(name): c for name, c in {**PUBLISHED, **FORMATS}.items()}
    for i, word in enumerate(words):
        rest = words[:i] + words[i + 1 :]
        if (known := by_name.get(_plain(word))) is not None:
            return known, rest
        if (known := by_name.get(_plain("".join(words[i : i + 2])))) is not None:
            return known, words[:i] + words[i + 2 :]
        if (model := _MODEL.fullmatch(word)) is not None and model[1] in FORMATS:
            return _of_maker(model), rest
        if word.lower() in SHAPES:
            shape = word.lower()
            bare: Callable[..., CellFacts] = CellFacts
            return bare(shape, shape, ()), rest
    raise UsageError(f"cell '{' '.join(words)}' is not known{did_you_mean(words[0], WORDS)}; {EXAMPLE}")


def _of_maker(model: re.Match[str]) -> CellFacts:
    """Find the published cell of a maker's model, or its format with the capacity in the model's name."""
    form, series = FORMATS[model[1]], _plain(model[2])
    end = series if len(series) > 1 else model[1] + series
    published = [c for name, c in PUBLISHED.items() if series and c.size == form.size and _plain(name).endswith(end)]
    if len(published) == 1:
        return published[0]
    return replace(form, name=model[0], capacity_Ah=int(model[3]) / 10 if model[3] else None)


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _told(cell: CellFacts, word: str) -> CellFacts:
    if (plain := _PLAIN.get(word.lower())) is not None:
        return replace(cell, **{plain[0]: plain[1]})  # type: ignore[arg-type]
    if (box := _BOX.fullmatch(word)) is not None:
        return replace(cell, size=_size(cell, word, [1e-3 * float(x) for x in box.groups() if x is not None]))
    measure = _MEASURE.fullmatch(word)
    if word.lower() in SHAPES or _plain(word) in {_plain(name) for name in (*PUBLISHED, *FORMATS)}:
        raise UsageError(f"cell: '{cell.name}' and '{word}' are two cells: name one of them")
    if measure is None:
        raise UsageError(f"cell: '{word}' is not known{did_you_mean(word, WORDS)}; valid: {_VALID}; {EXAMPLE}")
    return _measured(cell, word, float(measure[1]), measure[2].lower(), (measure[3] or "").lower())


def _measured(cell: CellFacts, word: str, value: float, unit: str, kind: str) -> CellFacts:
    if unit in ("ah", "mah"):
        return replace(cell, capacity_Ah=_bounded("capacity_Ah", value * (1 if unit == "ah" else 1e-3), word))
    if unit in ("g", "kg"):
        return replace(cell, mass=_bounded("mass", value * (1e-3 if unit == "g" else 1), word), source="as given")
    if unit == "p":
        if value != math.floor(value):
            raise UsageError(f"cell: '{word}': cells in parallel are a whole number")
        return replace(cell, parallel=int(_bounded("parallel", value, word)))
    if unit == "mm":
        return replace(cell, spacing=_bounded("spacing", 1e-3 * value, word))
    factor = {"mohm": 1e-3, "mω": 1e-3, "uohm": 1e-6}.get(unit, 1.0)
    told = replace(cell, resistance=_bounded("resistance", factor * value, word), source="as given")
    return replace(told, resistance_kind="ac" if kind == "ac" else "dc") if kind else told


def _size(cell: CellFacts, word: str, measures: list[float]) -> tuple[float, ...]:
    wanted = 2 if cell.shape == "cylinder" else 3
    if len(measures) != wanted:
        raise UsageError(f"cell: '{word}': a {cell.shape} cell has {wanted} measures")
    for x in measures:
        _bounded("size", x, word)
    # the thinnest dimension is across the layers, in any order
    return tuple(measures) if wanted == 2 else tuple(sorted(measures, reverse=True))


def _bounded(what: str, value: float, word: str) -> float:
    low, high, valid = _BOUNDS[what]
    if not low <= value <= high:
        raise UsageError(f"cell: '{word}' is not plausible; valid: {valid}")
    return value
