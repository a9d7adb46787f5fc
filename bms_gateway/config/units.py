"""Units that people write, and their factors to SI."""

from collections.abc import Mapping
from types import MappingProxyType

from bms_gateway.errors import ConfigError, did_you_mean
from bms_gateway.frames.vocabulary import INPUTS, Quantity

# Written unit → factor to SI, by kind. Error lines propose the first one.
_RESISTANCE = {"mOhm": 1e-3, "Ohm": 1.0, "uOhm": 1e-6, "mohm": 1e-3, "ohm": 1.0, "uohm": 1e-6, "mΩ": 1e-3, "Ω": 1.0}
_THERMAL_RESISTANCE = {"K/W": 1.0, "mK/W": 1e-3}
_CAPACITY = {"J/K": 1.0, "kJ/K": 1e3}
_CONDUCTANCE = {"W/K": 1.0, "mW/K": 1e-3, "kW/K": 1e3}
FLOW: Mapping[str, float] = MappingProxyType(
    {"m3/s": 1.0, "m³/s": 1.0, "m3/h": 1 / 3600, "l/s": 1e-3, "l/min": 1e-3 / 60}
)

PARAMETER_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "C_c": _CAPACITY,
        "C_s": _CAPACITY,
        "R_e": _RESISTANCE,
        "R_c": _THERMAL_RESISTANCE,
        "R_u": _THERMAL_RESISTANCE,
        "R_cc": _THERMAL_RESISTANCE,
        "C_f": _CONDUCTANCE,
        "coolant_flow": FLOW,
    }
)

# Units of the catalogue's effects. The unit of an effect selects its row.
_EFFECT_UNITS: tuple[Mapping[str, float], ...] = (
    _RESISTANCE,
    _THERMAL_RESISTANCE,
    _CAPACITY,
    _CONDUCTANCE,
    {"1": 1.0, "%": 1e-2},
    {"K": 1.0},
    {"°C": 1.0, "degC": 1.0},
    {"W": 1.0, "mW": 1e-3, "kW": 1e3},
    {"J": 1.0, "kJ": 1e3},
    {"A": 1.0, "mA": 1e-3},
    {"V": 1.0, "mV": 1e-3},
    {"V/K": 1.0, "mV/K": 1e-3, "uV/K": 1e-6},
    {"Ah": 3600.0, "mAh": 3.6, "C": 1.0},
    {"s": 1.0, "min": 60.0, "h": 3600.0},
    {"1/h": 1 / 3600, "1/s": 1.0},
)

# Units that DBC files print, lower case, where they leave no doubt. °F is not linear through 0: (scale, offset).
_SIGNAL_UNITS: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "current": {"ma": (1e-3, 0.0), "ka": (1e3, 0.0)},
        "voltage": {"mv": (1e-3, 0.0), "kv": (1e3, 0.0)},
        "soc": {"%": (1e-2, 0.0), "percent": (1e-2, 0.0)},
        "flow": {
            "l/min": (1e-3 / 60, 0.0),
            "lpm": (1e-3 / 60, 0.0),
            "l/s": (1e-3, 0.0),
            "l/h": (1e-3 / 3600, 0.0),
            "m3/h": (1 / 3600, 0.0),
            "m^3/h": (1 / 3600, 0.0),
        },
        "temperature": {
            "k": (1.0, -273.15),
            "kelvin": (1.0, -273.15),
            "degf": (5 / 9, -160 / 9),
            "°f": (5 / 9, -160 / 9),
            "f": (5 / 9, -160 / 9),
            "deg f": (5 / 9, -160 / 9),
            "fahrenheit": (5 / 9, -160 / 9),
        },
    }
)
# Units in DBC files for each kind, lower case; `other` are units of no quantity here.
_KNOWN_UNITS: Mapping[str, frozenset[str]] = MappingProxyType(
    {
        "current": frozenset({"a", "ma", "ka", "amp", "amps", "ampere", "amperes"}),
        "voltage": frozenset({"v", "mv", "kv", "volt", "volts"}),
        "temperature": frozenset(
            {"c", "°c", "degc", "deg c", "celsius", "k", "kelvin", "f", "°f", "degf", "deg f", "fahrenheit"}
        ),
        "soc": frozenset({"%", "percent"}),
        "flow": frozenset({"m3/s", "m^3/s", "m³/s", "m³/h", "m3/h", "m^3/h", "l/s", "l/min", "l/h", "lpm", "kg/s"}),
        "other": frozenset(
            {"ohm", "mohm", "ω", "mω", "k/w", "w", "kw", "wh", "kwh", "ah", "mah", "s", "ms", "hz", "rpm", "1/min"}
            | {"m/s", "km/h", "kph", "mph", "nm", "bar", "mbar", "psi", "pa", "kpa", "g", "kg", "m", "mm", "km"}
        ),
    }
)
_CALLED = {"soc": "an SOC", "flow": "a coolant flow"}


def parameter_factor(symbol: str, unit: str) -> float:
    """Factor that brings a parameter's written unit to SI.

    Raises
    ------
    ConfigError
        The unit does not belong to the parameter.

    Examples
    --------
    >>> parameter_factor("R_e", "mOhm")
    0.001
    """
    units = PARAMETER_UNITS[symbol]
    if unit not in units:
        shown = [u for u in units if u not in ("mohm", "ohm", "uohm", "mΩ", "Ω", "m³/s")]
        raise ConfigError(f"unit {unit!r} does not fit {symbol}{did_you_mean(unit, shown)}")
    return units[unit]


def effect_units(unit: str, to_si: float) -> Mapping[str, float]:
    """Units in which a number of an effect may be written, with their factors to SI.

    Parameters
    ----------
    unit : str
        The one that the effect shows.
    to_si : float
        Its factor to SI. An effect of the user's own may have a unit that is unknown here; "SI" may then be written
        too.

    Examples
    --------
    >>> effect_units("mV", 1e-3)
    {'V': 1.0, 'mV': 0.001}
    >>> effect_units("furlong", 201.168)
    {'furlong': 201.168, 'SI': 1.0}
    """
    return next((units for units in _EFFECT_UNITS if units.get(unit) == to_si), {unit: to_si, "SI": 1.0})


def signal_conversion(quantity: Quantity, unit: str | None) -> tuple[float, float]:
    """Scale and offset from a DBC's unit to SI (°C for temperatures).

    A conversion is made only if the printed unit leaves no doubt. A value with any other unit passes unchanged; the
    user can correct it by `scale`.

    Parameters
    ----------
    quantity : Quantity
    unit : str or None
        As the DBC prints it; some write ``current:A``.

    Raises
    ------
    ConfigError
        The unit is that of another quantity: the wrong signal was named.

    Examples
    --------
    >>> signal_conversion("current", "mA")
    (0.001, 0.0)
    >>> signal_conversion("surface", "C")
    (1.0, 0.0)
    """
    kind = INPUTS[quantity].kind
    name = (unit or "").rpartition(":")[2].strip().lower()
    if any(name in units for other, units in _KNOWN_UNITS.items() if other != kind):
        called = _CALLED.get(kind, f"a {kind}")
        raise ConfigError(f"unit {unit!r} does not fit {called}; name another signal, or correct the unit in the DBC")
    return _SIGNAL_UNITS.get(kind, {}).get(name, (1.0, 0.0))
