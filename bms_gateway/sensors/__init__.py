"""Which surfaces to measure: what a set of sensors can tell of the cores."""

from bms_gateway.sensors.observability import Observability, exact_rank, observability, paper_rank, steady_core_sd

__all__ = ["Observability", "exact_rank", "observability", "paper_rank", "steady_core_sd"]
