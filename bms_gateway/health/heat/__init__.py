"""Heat that no current makes: its size, its cell, and other causes that look like it."""

from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_watch import HeatWatch, Told

__all__ = ["Finding", "HeatWatch", "Told"]
