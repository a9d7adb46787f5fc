"""Meaning of the estimates: growth of resistance, other causes that look like it, and model mismatch."""

from bms_gateway.health.ageing import Ageing, History
from bms_gateway.health.cell_growth import CellGrowth
from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.health.mismatch import Mismatch, Mismatches
from bms_gateway.health.string_health import Change, HealthJob, HealthResult, StringHealth

__all__ = [
    "Ageing",
    "CellGrowth",
    "Change",
    "Flag",
    "HealthJob",
    "HealthResult",
    "History",
    "Mismatch",
    "Mismatches",
    "StringHealth",
    "Thresholds",
]
