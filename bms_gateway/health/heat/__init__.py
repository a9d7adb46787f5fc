"""Heat that no current makes: how much, in which cell, and what else could look like it."""

from bms_gateway.health.heat.heat_watch import HeatWatch, Told
from bms_gateway.health.heat.verdict import Finding

__all__ = ["Finding", "HeatWatch", "Told"]
