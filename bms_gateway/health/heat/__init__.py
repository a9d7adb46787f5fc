"""Heat that no current makes: how much, in which cell, and what else could look like it."""

from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_watch import HeatWatch, Told

__all__ = ["Finding", "HeatWatch", "Told"]
