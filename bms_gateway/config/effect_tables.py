"""The part of a model file that belongs to effects: `effects`, `[effect.NAME]` and `[correlation]`.

An effect's key is its name. An effect on a cell has `cell = k`; if there are several of one name, their keys are
`NAME:CELL`.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from bms_gateway.config.toml import Section
from bms_gateway.config.units import effect_units
from bms_gateway.errors import MOST_DIGITS, ConfigError, clipped, did_you_mean, whole_number
from bms_gateway.thermal import KINDS, AddedEffect, Floats

if TYPE_CHECKING:
    from bms_gateway.thermal.effects import Effect, EffectParameter

Correlated = tuple[tuple[str, ...], Floats]
MOST_SPANS, MOST_LOG_SPANS = 1000.0, 10.0
"""Greatest standard deviation of an effect's number, over the distance of its bounds: beyond any useful value."""
ROUNDING = 1e-6
"""Tolerance for rounded digits, where a number is compared with its bound or a matrix with a correlation."""
LONGEST_KEY = 100
"""Most characters of a user's key that an error line shows."""
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class EffectNumber(Section):
    """`{ value, unit, sd | rel_sd | fixed = true, start }`; rel_sd for a number that is fitted in its logarithm.

    `start` is the start of a fit, in this unit; by default `value`.
    """

    value: float
    start: float | None = None
    unit: str | None = None
    sd: float | None = Field(default=None, gt=0.0)
    rel_sd: float | None = Field(default=None, gt=0.0)
    fixed: bool = False


class EffectTable(BaseModel):
    """`[effect.NAME]`: the numbers by name, the cell where the effect has one, and what it cannot be told from."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False, strict=True)
    __pydantic_extra__: dict[str, EffectNumber] = Field(init=False)
    cell: int | None = None
    tied_with: list[str] = Field(default_factory=list)

    @property
    def numbers(self) -> Mapping[str, EffectNumber]:
        """By parameter."""
        return self.__pydantic_extra__


class Correlation(Section):
    """`[correlation]`."""

    names: list[str]
    matrix: list[list[float]]


def read_effects(
    listed: Sequence[str], tables: Mapping[str, EffectTable], cells: int, sensors: tuple[int, ...]
) -> tuple[AddedEffect, ...]:
    """Read the effects of a model in the order in which they are listed.

    Raises
    ------
    ConfigError
        Names the key, the fault and what to write.
    """
    try:
        catalogued = [_catalogued(key.partition(":")[0]) for key in listed]
    except ConfigError as e:
        raise ConfigError(f"effects: {e}") from None
    for key in listed:
        if len(key.partition(":")[2]) > MOST_DIGITS:
            raise ConfigError(f"effects: {clipped(key, LONGEST_KEY)!r}: no such cell; valid: 1 to {cells}")
    for key in tables:
        if key not in listed:
            raise ConfigError(f"effect.{key}: is not in effects; add {_quoted(key)} there, or remove the table")
    found: dict[str, str] = {}
    effects = []
    for key, effect in zip(listed, catalogued, strict=True):
        if key not in tables:
            raise ConfigError(f"effects: {key!r} has no numbers; add {example(effect, key)}")
        try:
            added = _effect(effect, key, tables[key], cells, sensors)
        except ConfigError as e:
            raise ConfigError(f"effect.{key}{e}") from None
        if added.key in found:
            twice = "is listed twice" if found[added.key] == key else f"is the same as {found[added.key]!r}"
            raise ConfigError(f"effects: {key!r} {twice}")
        found[added.key] = key
        effects.append(added)
    return tuple(effects)


def example(effect: "Effect", key: str) -> str:
    """Return the table that an effect needs, in one line.

    Examples
    --------
    >>> from bms_gateway.thermal.effects import effect_named
    >>> print(example(effect_named("resistance_temperature"), "resistance_temperature"))
    [effect.resistance_temperature] with B = { value = 500, unit = "K", sd = 1500 }
    """
    numbers = [
        f'{p.name} = {{ value = {p.probe / p.to_si:.6g}, unit = "{p.unit}", '
        f"{f'rel_sd = {p.sd:.6g}' if p.log else f'sd = {p.sd / p.to_si:.6g}'} }}"
        for p in effect.parameters
        if not optional(effect, p)
    ]
    place = [] if effect.place == "string" or ":" in key else ["cell = 1"]
    return f"[effect.{_toml_key(key)}] with {' and '.join(place + numbers)}"


def optional(effect: "Effect", p: "EffectParameter") -> bool:
    """Whether a number may be left out; it then has the value at which the effect vanishes."""
    return p.neutral is not None and p is not effect.parameters[0]


def write_effects(effects: Sequence[AddedEffect]) -> tuple[str, list[str]]:
    """Write the list of effects, as a TOML array, and the lines of their tables."""
    names = [e.name for e in effects]
    keys = [e.name if names.count(e.name) == 1 else e.key for e in effects]
    lines = []
    for key, e in zip(keys, effects, strict=True):
        effect = _catalogued(e.name)
        lines += ["", f"[effect.{_toml_key(key)}]  # {effect.equation}"]
        if e.cell is not None and key == e.name:
            lines.append(f"cell = {e.cell}")
        if e.tied_with:
            lines.append(f"tied_with = {_names(e.tied_with)}  # explain as well the records by which it was added")
        lines += [
            _number_line(p, e.values[p.name], e.sd.get(p.name, p.sd), (e.start or {}).get(p.name))
            for p in effect.parameters
            if p.name in e.values
        ]
    return _names(keys), lines


def read_correlation(
    given: Correlation, symbols: Mapping[str, object], effects: Sequence[AddedEffect]
) -> Correlated | None:
    """Read the correlation; parameters that the model's condition does not have are ignored.

    Raises
    ------
    ConfigError
        A name that the model does not know, or a matrix that is not a correlation matrix.
    """
    known = {s: s for s in symbols}
    known |= {f"{e.name}.{p}": f"{e.key}.{p}" for e in effects for p in e.values}
    known |= {f"{e.key}.{p}": f"{e.key}.{p}" for e in effects for p in e.values}
    for name in given.names:
        if name not in known and name not in KINDS:
            raise ConfigError(f"correlation.names: {name!r} is no number of this model{did_you_mean(name, known)}")
    m = len(given.names)
    if len(given.matrix) != m or any(len(row) != m for row in given.matrix):
        raise ConfigError(f"correlation.matrix: {m} names need {m} rows of {m} numbers")
    kept = [i for i, name in enumerate(given.names) if name in known]
    names = tuple(known[given.names[i]] for i in kept)
    if len(set(names)) < len(names):
        raise ConfigError(f"correlation.names: {next(n for n in names if names.count(n) > 1)!r} is there twice")
    matrix = np.array(given.matrix, dtype=np.float64).reshape(m, m)
    if not np.allclose(matrix, matrix.T, rtol=0.0, atol=ROUNDING):
        raise ConfigError("correlation.matrix: must be symmetric")
    if not np.allclose(np.diag(matrix), 1.0, rtol=0.0, atol=ROUNDING):
        raise ConfigError("correlation.matrix: must have 1 on its diagonal")
    if m and np.linalg.eigvalsh(matrix)[0] < -ROUNDING * m:
        raise ConfigError("correlation.matrix: this is no correlation matrix (it is not positive semidefinite)")
    return (names, matrix[np.ix_(kept, kept)]) if kept else None


def write_correlation(correlation: Correlated) -> list[str]:
    """Write the lines of `[correlation]`."""
    names, matrix = correlation
    rows = [f"  [{', '.join(repr(float(x)) for x in row)}]," for row in matrix]
    return ["", "[correlation]", f"names = {_names(names)}", "matrix = [", *rows, "]"]


def shown(si: Floats, unit: str, units: Mapping[str, float]) -> tuple[list[str], str]:
    """Numbers in the unit for people, with as few digits as restore them exactly; in SI if this unit cannot.

    Parameters
    ----------
    si : (m,)
    unit : str
        For people.
    units : mapping of unit to factor
        It includes SI.
    """
    for digits in (12, 15, 17):
        text = [repr(float(f"{x / units[unit]:.{digits}g}")) for x in si]
        if np.array_equal(np.array(text, dtype=np.float64) * units[unit], si):
            return text, unit
    return [repr(float(x)) for x in si], next(u for u, f in units.items() if f == 1.0)


def _catalogued(name: str) -> "Effect":
    from bms_gateway.thermal.effects import effect_named  # loads the whole catalogue, which most models do not need

    return effect_named(name)


def _effect(effect: "Effect", key: str, table: EffectTable, cells: int, sensors: tuple[int, ...]) -> AddedEffect:
    if cells < effect.least_cells:
        raise ConfigError(f": needs at least {effect.least_cells} cells; this model has {cells}")
    names = [p.name for p in effect.parameters]
    for name in table.numbers:
        if name not in names:
            raise ConfigError(f".{name}: unknown key{did_you_mean(name, [*names, 'cell', 'tied_with'])}")
    values, sd, start = {}, {}, {}
    for p in effect.parameters:
        given = table.numbers.get(p.name)
        if given is not None:
            values[p.name], sd[p.name] = _number(p, given)
            if given.start is not None:
                begin = given.model_copy(update={"value": given.start})
                start[p.name], _ = _number(p, begin)
        elif optional(effect, p) and p.neutral is not None:
            values[p.name], sd[p.name] = p.neutral, 0.0
        else:
            raise ConfigError(f".{p.name}: missing; needed: {example(effect, key)}")
    begins = {**values, **start} if start else None
    for name in table.tied_with:
        try:
            _catalogued(name)
        except ConfigError as e:
            raise ConfigError(f".tied_with: {e}") from None
    place = _cell(effect, key, table, cells, sensors)
    return AddedEffect(effect.name, place, values, sd, begins, tuple(table.tied_with))


def _cell(effect: "Effect", key: str, table: EffectTable, cells: int, sensors: tuple[int, ...]) -> int | None:
    _, colon, named = key.partition(":")
    if effect.place == "string":
        if colon or table.cell is not None:
            raise ConfigError(f": {effect.name} sits on no cell; remove {colon + named if colon else 'cell'}")
        return None
    # a loss of coolant is visible only if two cells lie behind it
    last = cells - 2 if effect.place == "gap" else cells
    valid = sensors if effect.place == "sensor" else range(1, last + 1)
    number = whole_number(named)
    cell = table.cell if number is None else number
    listed = ", ".join(map(str, sensors)) or "none, for there is no sensor"
    what = f"valid: {listed if effect.place == 'sensor' else f'1 to {last}'}"
    if cell is None or (colon and number is None):
        raise ConfigError(f".cell: missing; {effect.name} sits on one {effect.place}; {what}")
    if table.cell not in (None, cell):
        raise ConfigError(f".cell: {table.cell} is not the {cell} of its name")
    if cell not in valid:
        why = "has no sensor" if effect.place == "sensor" and 1 <= cell <= cells else "is no place for it"
        raise ConfigError(f".cell: cell {cell} {why}; {what}")
    return cell


def _number(p: "EffectParameter", given: EffectNumber) -> tuple[float, float]:
    units = effect_units(p.unit, p.to_si)
    unit = given.unit if given.unit is not None else "1"
    if unit not in units:
        if given.unit is None:
            raise ConfigError(f'.{p.name}.unit: missing; write unit = "{p.unit}"')
        raise ConfigError(f".{p.name}: unit {unit!r} does not fit {p.name}{did_you_mean(unit, units)}")
    factor = units[unit]
    x = given.value * factor
    slack = ROUNDING * (p.upper - p.lower)  # a fit that ended at a bound may be beyond it by a rounding error
    if not p.lower - slack <= x <= p.upper + slack:
        low, high = p.lower / factor, p.upper / factor
        raise ConfigError(f".{p.name}: {given.value:g} {unit} is not plausible; valid: {low:g} to {high:g} {unit}")
    right, wrong = ("rel_sd", "sd") if p.log else ("sd", "rel_sd")
    if getattr(given, wrong) is not None:
        known = "in per cent" if p.log else f"in {unit}"
        raise ConfigError(f".{p.name}.{wrong}: its uncertainty is known {known}; use {right}")
    spread: float | None = getattr(given, right)
    if given.fixed == (spread is not None):
        raise ConfigError(f".{p.name}: needs either {right} (how well it is known) or fixed = true")
    if spread is not None and (spread := spread if p.log else spread * factor) > (most := _widest(p)):
        valid = f"{most:.3g}" if p.log else f"{most / factor:.3g} {unit}"
        raise ConfigError(f".{p.name}.{right}: far wider than {p.name} can be; valid: up to {valid}")
    return x, 0.0 if spread is None else spread


def _widest(p: "EffectParameter") -> float:
    """Greatest standard deviation that a number may have, as it is kept."""
    if p.log:
        return MOST_LOG_SPANS * max(math.log(p.upper / p.lower), p.sd)
    return MOST_SPANS * max(p.upper - p.lower, p.sd)


def _number_line(p: "EffectParameter", value: float, sd: float, start: float | None) -> str:
    units = effect_units(p.unit, p.to_si)
    begin = [] if start is None or sd == 0.0 else [start]
    text, unit = shown(np.array([value, *([] if p.log or sd == 0.0 else [sd]), *begin]), p.unit, units)
    known = "fixed = true" if sd == 0.0 else f"rel_sd = {float(sd)!r}" if p.log else f"sd = {text[1]}"
    known += f", start = {text[-1]}" if begin else ""
    return f'{p.name} = {{ value = {text[0]}, unit = "{unit}", {known} }}  # {p.description}'


def _names(names: Sequence[str]) -> str:
    return f"[{', '.join(_quoted(name) for name in names)}]"


def _quoted(name: str) -> str:
    return f'"{name}"'


def _toml_key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _quoted(key)
