"""Heat that no current makes: its size, its cell, and other causes that look like it."""

from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_watch import HeatWatch
from bms_gateway.health.heat.told_heat import Told

__all__ = ["Finding", "HeatWatch", "Told"]
