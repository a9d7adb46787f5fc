"""Units that people write, and their factors to SI."""

from collections.abc import Mapping
from types import MappingProxyType

from bms_gateway.errors import ConfigError, did_you_mean

# Written unit → factor to SI, by what is measured. The first of each is what error lines propose.
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

# Units that DBC files print, lower case, where they leave no doubt. °F is not linear through 0: (scale, offset).
_SIGNAL_UNITS: Mapping[str, Mapping[str, tuple[float, float]]] = MappingProxyType(
    {
        "current": {"ma": (1e-3, 0.0), "ka": (1e3, 0.0)},
        "voltage": {"mv": (1e-3, 0.0), "kv": (1e3, 0.0)},
        "soc": {"%": (1e-2, 0.0), "percent": (1e-2, 0.0)},
        "coolant_flow": {
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
        },
    }
)
_FAMILY = {"cell_voltage": "voltage", "surface": "temperature", "coolant_inlet": "temperature"}


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


def signal_conversion(quantity: str, unit: str | None) -> tuple[float, float]:
    """Scale and offset from a DBC's unit to SI (°C for temperatures).

    Only where the printed unit leaves no doubt; anything else passes as it is, and the user's own scale mends it.

    Parameters
    ----------
    quantity : str
        As in `engine.plan.Quantity`.
    unit : str or None
        As the DBC prints it.

    Examples
    --------
    >>> signal_conversion("current", "mA")
    (0.001, 0.0)
    >>> signal_conversion("surface", "C")
    (1.0, 0.0)
    """
    family = _SIGNAL_UNITS.get(_FAMILY.get(quantity, quantity), {})
    return family.get((unit or "").strip().lower(), (1.0, 0.0))
