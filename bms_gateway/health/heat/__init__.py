"""Heat that no current makes: how much, in which cell, and what else could look like it."""

from bms_gateway.health.heat.verdict import Finding
from bms_gateway.health.heat.watch import HeatWatch, Told

__all__ = ["Finding", "HeatWatch", "Told"]
