"""What an estimate means: resistance growth, model mismatch."""

from bms_gateway.health.ageing import Ageing
from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.health.mismatch import Mismatch

__all__ = ["Ageing", "Flag", "Mismatch", "Thresholds"]
