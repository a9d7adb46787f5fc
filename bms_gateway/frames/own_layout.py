"""Layout of signals in the project's own DBC: little-endian, eight bytes, in J1939's ranges.

Raw values from 0xFE in the top byte on (0xE for four bits) are J1939's "error" and "not available".
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from bms_gateway.frames.own_dbc import MAX_CELLS

__all__ = ["VALUE_TABLES", "SignalLayout", "band", "cell", "celsius", "count", "enumeration", "percent", "percent_sd"]

KELVIN = -273.15
_SPECIAL = {14: "error", 15: "not available"}

VALUE_TABLES: Final[Mapping[str, Mapping[int, str]]] = MappingProxyType(
    {
        "Quality": {
            0: "good",
            1: "stale",
            2: "out of range",
            3: "not sent",
            4: "sensor failed",
            5: "stuck",
            6: "open",
            7: "short",
            8: "jumpy",
            9: "counter",
            10: "crc",
            11: "estimated",
            12: "doubtful",
            13: "reserved 13",
            **_SPECIAL,
        },
        "ParameterStatus": {0: "learning", 1: "identified", 2: "not identifiable", 3: "fixed", **_SPECIAL},
        "Degradation": {0: "none", 1: "watch", 2: "warning", 3: "alarm", **_SPECIAL},
        "Fault": {0: "none", 1: "warning", 2: "alarm", **_SPECIAL},
        "Mismatch": {0: "none", 1: "suspected", 2: "confirmed", **_SPECIAL},
        "GatewayState": {0: "starting", 1: "running", 2: "degraded", 3: "bus silent", 4: "stopping", **_SPECIAL},
    }
)
"""Words for the raw values of signals with four bits."""


class SignalLayout(NamedTuple):
    """One signal: physical = raw · scale + offset, valid from `low` to `high`.

    Attributes
    ----------
    name, comment : str
        With `{c}` for the number of the cell if each cell has the signal.
    start, size : int
        Lowest bit and number of bits.
    table : str or None
        Key of `VALUE_TABLES`.
    """

    name: str
    start: int
    size: int
    scale: float
    offset: float
    low: float
    high: float
    unit: str
    comment: str
    table: str | None = None


def celsius(name: str, start: int, comment: str) -> SignalLayout:
    """Lay out a temperature, 0.01 K from absolute zero on.

    Above 300 °C no cell exists any more.
    """
    return SignalLayout(name, start, 16, 0.01, KELVIN, KELVIN, 300, "degC", comment)


def band(name: str, start: int, comment: str) -> SignalLayout:
    """Lay out the standard deviation of a temperature."""
    return SignalLayout(name, start, 8, 0.05, 0, 0, 12.5, "K", comment)


def percent(name: str, start: int, comment: str) -> SignalLayout:
    """Lay out a growth."""
    return SignalLayout(name, start, 16, 0.01, -100, -100, 500, "%", comment)


def percent_sd(name: str, start: int, comment: str) -> SignalLayout:
    """Lay out the standard deviation of a growth."""
    return SignalLayout(name, start, 16, 0.01, 0, 0, 600, "%", comment)


def cell(name: str, start: int, comment: str) -> SignalLayout:
    """Lay out the number of a cell, from 1."""
    return SignalLayout(name, start, 8, 1, 0, 1, MAX_CELLS, "1", comment)


def count(name: str, start: int, unit: str, comment: str) -> SignalLayout:
    """Lay out a number of frames or samples."""
    return SignalLayout(name, start, 16, 1, 0, 0, 64000, unit, comment)


def enumeration(name: str, start: int, table: str, comment: str) -> SignalLayout:
    """Lay out four bits with a value table."""
    last = max(raw for raw in VALUE_TABLES[table] if raw not in _SPECIAL)
    return SignalLayout(name, start, 4, 1, 0, 0, last, "1", comment, table)
