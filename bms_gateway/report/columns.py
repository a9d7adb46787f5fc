"""Quantity and unit of each column of a table: by its name, the unit in it or below it, and `--columns`."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from bms_gateway.errors import DataError, did_you_mean
from bms_gateway.frames.vocabulary import CELL, CELL_COLUMNS, INPUTS, WHOLE
from bms_gateway.report.dates import ASKED

__all__ = ["UNITS", "Column", "bare_unit", "find_columns", "quantity_of", "split_unit"]

_F: Final = (5 / 9, -160 / 9)
_TEMPERATURE: Final = {
    **dict.fromkeys(("°C", "C", "degC", "deg C", "℃", "ºC", "Celsius"), (1.0, 0.0)),
    **dict.fromkeys(("K", "Kelvin", "°K", "degK", "deg K"), (1.0, -273.15)),
    **dict.fromkeys(("°F", "F", "degF", "deg F", "ºF", "Fahrenheit"), _F),
    **dict.fromkeys(("m°C", "mdegC"), (1e-3, 0.0)),
    "mK": (1e-3, -273.15),
}
_VOLTAGE: Final = {"V": (1.0, 0.0), "mV": (1e-3, 0.0), "kV": (1e3, 0.0), "Volt": (1.0, 0.0)}
_CURRENT: Final = {"A": (1.0, 0.0), "mA": (1e-3, 0.0), "kA": (1e3, 0.0), "uA": (1e-6, 0.0), "µA": (1e-6, 0.0)}
_CURRENT["Ampere"] = _CURRENT["Amp"] = _CURRENT["Amps"] = (1.0, 0.0)
_TIME: Final = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "Sekunden", "sek"), (1.0, 0.0)),
    **dict.fromkeys(("ms", "msec", "milliseconds"), (1e-3, 0.0)),
    **dict.fromkeys(("us", "µs", "microseconds"), (1e-6, 0.0)),
    "ns": (1e-9, 0.0),
    **dict.fromkeys(("min", "minutes", "Minuten"), (60.0, 0.0)),
    **dict.fromkeys(("h", "hours", "hour", "Stunden"), (3600.0, 0.0)),
    **dict.fromkeys(("d", "days"), (86_400.0, 0.0)),
}
_SHARE: Final = {**dict.fromkeys(("%", "pct", "percent", "Prozent"), (1e-2, 0.0)), "-": (1.0, 0.0), "1": (1.0, 0.0)}
_FLOW: Final = {
    **dict.fromkeys(("m3/s", "m³/s", "m3_s"), (1.0, 0.0)),
    **dict.fromkeys(("m3/h", "m³/h", "m3_h"), (1 / 3600, 0.0)),
    **dict.fromkeys(("l/min", "lpm", "L/min", "l_min"), (1e-3 / 60, 0.0)),
    **dict.fromkeys(("l/s", "L/s", "l_s"), (1e-3, 0.0)),
    **dict.fromkeys(("l/h", "L/h", "l_h"), (1e-3 / 3600, 0.0)),
}
_WRITTEN: Final[Mapping[str, Mapping[str, tuple[float, float]]]] = {
    "time": _TIME,
    "current": _CURRENT,
    "voltage": _VOLTAGE,
    "temperature": _TEMPERATURE,
    "soc": _SHARE,
    "flow": _FLOW,
}
UNITS: Final[Mapping[str, Mapping[str, tuple[float, float]]]] = MappingProxyType(
    {**_WRITTEN} | {i.kind: {i.unit: (1.0, 0.0)} for i in INPUTS.values() if i.kind not in _WRITTEN}
)
"""Units of each quantity: unit → factor and shift to our own unit (s, A, V, °C, share, m³/s)."""
OWN: Final = {i.kind: i.unit for i in INPUTS.values()} | {"time": "s", "soc": "share", "flow": "m³/s"}
_ELSE: Final = re.compile(r"m?bar|psi|k?Pa|rpm|1/min|Nm|k?Wh?|m?Ah|km/h|km|m|k?g|Hz|m?Ohm")
"""Units of quantities that are not used here; a column with such a unit is ignored."""
_BASES: Final[dict[str, tuple[str, str]]] = {
    "time": ("time_s", "time"),
    **{q: (INPUTS[q].column, INPUTS[q].kind) for q in WHOLE},
}
_OURS: Final = {own.lower(): own for own, _ in _BASES.values()}
_CELL: Final = re.compile(rf"({'|'.join(CELL_COLUMNS)})_([1-9][0-9]{{0,5}})")
_CELL_KIND: Final[dict[str, str]] = {**{q: INPUTS[q].kind for q in CELL}, "core": "temperature"}
INLET: Final = INPUTS["coolant_inlet"].column
"""The only column that may be a constant: the temperature of a chamber is often set, and not recorded."""
_NUMBER: Final = re.compile(r"([-+\u2212]?\d{1,6}(?:[.,]\d{1,9})?)\s*\[?\s*([^\s\[\]\d][^\[\]]*?)?\s*\]?")
_NO_WORDS: Final = frozenset(
    {"degC", "degF", "degK", "deg C", "deg F", "deg K", "m°C", "mdegC", "mK", "Celsius", "Fahrenheit", "Kelvin"}
    | {"mA", "kA", "uA", "µA", "mV", "kV"}
)
"""Words that are always units at the end of a name; other units must follow a comma or be in brackets."""
LONGEST_UNIT: Final = 30
"""Most characters of a possible unit in brackets."""


_REFUSED: Final = re.compile(r"surface_([1-9][0-9]*)_C not used: (.+)")


def refused_name(cell: int, why: str) -> str:
    """Name the column of a cell whose readings are kept in a table and not used; the reason is in the name.

    Examples
    --------
    >>> refused_name(8, "it has come loose")
    'surface_8_C not used: it has come loose'
    """
    return f"surface_{cell}_C not used: {' '.join(why.split())}"


def refused_in(names: Iterable[str]) -> dict[int, str]:
    """Return the cells with such a column, and why they are not used."""
    return {int(m[1]): m[2] for m in map(_REFUSED.fullmatch, names) if m}


def is_refused(name: str) -> bool:
    """Whether a column is such a one."""
    return _REFUSED.fullmatch(name) is not None


@dataclass(frozen=True, slots=True)
class Column:
    """Source of one quantity of a table.

    Attributes
    ----------
    column : str
        Name in the file; a minus before it changes the sign.
    factor, shift : float
        Table's unit = factor · value + shift.
    unit : str or None
        As written; None if there is none.
    date : str or None
        Order of day and month, if the user states it.
    constant : float or None
        In our unit, if no column has the quantity; `column` is then the text given by the user.
    """

    column: str
    factor: float = 1.0
    shift: float = 0.0
    unit: str | None = None
    date: str | None = None
    constant: float | None = None

    @property
    def bare(self) -> str:
        """Name without the minus."""
        return self.column.removeprefix("-")


def quantity_of(name: str) -> str:
    """Return the quantity of a column with one of our names, as a key of `UNITS`."""
    if found := _CELL.match(name):
        return _CELL_KIND[found[1]]
    return next(quantity for ours, quantity in _BASES.values() if ours == name)


def bare_unit(text: str) -> str:
    """Remove blanks and brackets from a cell that may be a unit."""
    return text.strip().strip("[]()").strip()


def find_columns(
    path: object,
    names: Sequence[str],
    below: Sequence[str] | None,
    mapped: Mapping[str, str],
    known: Sequence[str],
) -> dict[str, Column]:
    """Find the columns of a file that are used.

    Parameters
    ----------
    path : object
        Name of the file in errors.
    names : sequence of str
        Its column names.
    below : sequence of str, optional
        Row of units below them.
    mapped : mapping
        From `--columns`: our name to the file's.
    known : sequence of str
        Those of `names` that are exactly our names.

    Returns
    -------
    dict of our name to Column

    Raises
    ------
    DataError
        A mapping to a missing column, or a unit that does not belong to its quantity.
    """
    units = dict(zip(names, map(bare_unit, below), strict=True)) if below is not None else {}
    found = {ours: _mapped(path, ours, column, names, units) for ours, column in mapped.items()}
    taken = {c.bare for c in found.values()} | {c.column for c in found.values()}
    for name in names:
        if name in taken or name in found:
            continue
        if name in known:
            found[name] = _known(path, name, units.get(name))
        elif (guess := _by_name(path, name, units.get(name))) is not None and guess[0] not in {*found, *names}:
            found[guess[0]] = guess[1]
    return found


def _known(path: object, name: str, below: str | None) -> Column:
    """Return a column with one of our names; a unit below it must not contradict the name."""
    if not below:
        return Column(name)
    quantity = quantity_of(name)
    unit = _unit(quantity, below)
    if unit is None and not _ELSE.fullmatch(below):
        return Column(name)  # a remark
    if unit is None or (unit != (1.0, 0.0) and name != "soc"):
        raise DataError(
            f"{path}: column {name!r} has the unit {below!r} below it, which contradicts its name; "
            f"say which is right: --columns '{name}={name} [{'UNIT' if unit is None else below}]'"
        )
    return Column(name, *unit, below)


def _by_name(path: object, name: str, below: str | None) -> tuple[str, Column] | None:
    """Return a column with one of our names but another unit: `current [mA]`, `Surface 1 (°F)`, `time_ms`."""
    base, unit = split_unit(name)
    key = re.sub(r"[\s-]+", "_", base.strip()).lower()
    ours = _OURS.get(key) or _BASES.get(key, (None, ""))[0]
    if ours is None and (cell := _CELL.fullmatch(re.sub(r"(?<=\d)_[cv]$", "", key))):
        ours = CELL_COLUMNS[cell[1]].format(cell[2])
    if ours is None:
        return _suffixed(name)
    stated = unit or below
    if not stated:
        return (ours, Column(name)) if ours == "soc" else None  # `time` alone may be anything
    quantity = quantity_of(ours)
    factors = _unit(quantity, stated)
    if factors is None:
        raise _no_unit(path, name, stated, quantity, ours)
    return ours, Column(name, *factors, stated)


def _suffixed(name: str) -> tuple[str, Column] | None:
    """Return `current_mA`, `coolant_inlet_K`, `surface_3_F`, `soc_pct`."""
    for base, (ours, quantity) in _BASES.items():
        if name.lower().startswith(base + "_") and (factors := _unit(quantity, name[len(base) + 1 :])):
            return ours, Column(name, *factors, name[len(base) + 1 :])
    cell = _CELL.match(name)
    if cell is None or name[cell.end() : cell.end() + 1] != "_":
        return None
    quantity = _CELL_KIND[cell[1]]
    unit = name[cell.end() + 1 :]
    factors = _unit(quantity, unit)
    if factors is None:
        return None
    return CELL_COLUMNS[cell[1]].format(cell[2]), Column(name, *factors, unit)


def _mapped(path: object, ours: str, column: str, names: Sequence[str], units: Mapping[str, str]) -> Column:
    """Return the column named in `--columns`; its unit follows it in brackets, or is below its name in the file."""
    quantity = quantity_of(ours)
    bare = column if column in names else column.removeprefix("-")
    if bare in names:
        unit = split_unit(bare)[1] or units.get(bare) or _tail(bare, quantity)
        factors = _unit(quantity, unit) if unit else None
        if unit and factors is None and _ELSE.fullmatch(unit):
            raise _no_unit(path, bare, unit, quantity, ours, column.removesuffix(bare))
        if not unit and quantity == "temperature" and re.fullmatch(r".*\s[FK]", bare):
            letter = bare[-1]
            raise DataError(
                f"{path}: column {bare!r} for {ours}: is {letter} its unit? say it: "
                f"--columns '{ours}={column} [{'degF' if letter == 'F' else letter}]', or [°C] if {letter} is a name"
            )
        return Column(column, *factors, unit) if factors else Column(column)
    base, unit = split_unit(bare)
    if unit is not None and base in names:  # the user has stated the unit
        sign = "-" if column.startswith("-") else ""
        if quantity == "time" and unit in ASKED:
            return Column(base, date=unit)
        factors = _unit(quantity, unit)
        if factors is None:
            raise _no_unit(path, base, unit, quantity, ours, sign)
        return Column(sign + base, *factors, unit)
    hint = ""
    if ours == INLET:
        if (constant := _constant(path, column)) is not None:
            return constant
        hint = f" (a constant inlet: --columns '{INLET}=22 °C')"
    raise DataError(f"{path}: no column {column!r} for {ours}{did_you_mean(column, names)}{hint}")


def _constant(path: object, text: str) -> Column | None:
    """Read a number with its unit (default °C) as the constant temperature of an inlet that was not recorded."""
    written = _NUMBER.fullmatch(text)
    factors = _unit("temperature", written[2] or "°C") if written else None
    if written is None or factors is None:
        return None
    value = factors[0] * float(written[1].replace(",", ".").replace("\u2212", "-")) + factors[1]
    low, high = INPUTS["coolant_inlet"].plausible
    if not low <= value <= high:
        raise DataError(f"{path}: {INLET} {text!r}: must be {low:g} to {high:g} °C; is it in another unit?")
    return Column(text, constant=value)


def _tail(name: str, quantity: str) -> str | None:
    """Return the unit at the end of a name if it is clear: `I_mA`, `SOC_pct`; in `T_F` the F may mean a fluid."""
    end = name.rpartition("_")[2]
    return end if len(end) > 1 and end in UNITS[quantity] else None


def split_unit(name: str) -> tuple[str, str | None]:
    """Split a name from the unit at its end: in brackets, after a comma, a slash or "in", or what can only be a unit.

    Examples
    --------
    >>> split_unit("Strom (mA)"), split_unit("Strom in mA"), split_unit("Temperatur Zelle °C")
    (('Strom', 'mA'), ('Strom', 'mA'), ('Temperatur Zelle', '°C'))
    >>> split_unit("TC1 degF"), split_unit("TC1, F"), split_unit("Volt, pack")
    (('TC1', 'degF'), ('TC1', 'F'), ('Volt, pack', None))
    >>> split_unit("T in C"), split_unit("Drehzahl 1/min")  # may be an inlet; is not a time
    (('T in C', None), ('Drehzahl 1/min', None))
    """
    if (found := _in_brackets(name)) is not None:
        return found
    at = max(name.rfind(","), name.rfind(";"))
    base, unit = name[: max(at, 0)].rstrip(), name[at + 1 :].strip()
    if base and any(unit in units for units in UNITS.values()):
        return base, unit
    if tail := next((u for u in _NO_WORDS if name.endswith(f" {u}")), None):
        base = name.removesuffix(tail).strip()
        return (base.removesuffix(" in") if len(base) > len("T in") else base), tail
    base, _, unit = name.rpartition(" ")
    if "/" in unit and any(unit in units for units in UNITS.values()):
        return base.strip(), unit
    told = base.endswith(" in") and len(base) > len("T in")
    if (told or unit == "%" or not unit.isascii()) and base and any(unit in units for units in UNITS.values()):
        return base.removesuffix(" in").strip(), unit
    base, slash, unit = name.rpartition("/")
    if slash and not base.endswith("1") and any(unit.strip() in units for units in UNITS.values()):
        return base.strip(), unit.strip()
    return name, None


def _in_brackets(name: str) -> tuple[str, str] | None:
    """Split a name that ends with a short text in brackets of either kind, without brackets within."""
    if not name.endswith(("]", ")")):
        return None
    at = max(map(name[:-1].rfind, "[]()"))
    inner = name[at + 1 : -1].strip()
    if at < 0 or name[at] not in "[(" or len(inner) > LONGEST_UNIT:
        return None
    if re.search(r"\w\w+ *[ +\u2212-]|[+\u2212-] *\w\w", inner) and not any(inner in units for units in UNITS.values()):
        return None  # words, such as those on a sign: "discharge +"
    while at and (name[at - 1] == "_" or name[at - 1].isspace()):
        at -= 1
    return name[:at], inner


def _unit(quantity: str, unit: str) -> tuple[float, float] | None:
    units = UNITS[quantity]
    if unit in units:
        return units[unit]
    plain = unit.strip().lower()
    near = {value for name, value in units.items() if name.lower() == plain}
    return near.pop() if len(near) == 1 else None


def _no_unit(path: object, column: str, unit: str, quantity: str, ours: str, sign: str = "") -> DataError:
    valid = list(UNITS[quantity])
    return DataError(
        f"{path}: column {column!r} for {ours}: {unit!r} is no unit of it{did_you_mean(unit, valid[:8])} "
        f"(say it: --columns '{ours}={sign}{column} [{OWN[quantity]}]')"
    )
