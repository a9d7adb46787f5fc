"""Which surfaces to measure: how well a set of sensors determines the cores."""

from bms_gateway.sensors.exact import exact_rank, exact_ranks
from bms_gateway.sensors.observability import Observability, determined_states, observability
from bms_gateway.sensors.paper import (
    Counts,
    Needed,
    SetRank,
    paper_counts,
    paper_rank,
    paper_ranks,
    paper_string,
    set_ranks,
    table_2,
)
from bms_gateway.sensors.pbh import hidden_states
from bms_gateway.sensors.placement import (
    Placement,
    PlacementProblem,
    Placements,
    even_sets,
    observable_sets,
)
from bms_gateway.sensors.steady import Steady, steady_core_sd

__all__ = [
    "Counts",
    "Needed",
    "Observability",
    "Placement",
    "PlacementProblem",
    "Placements",
    "SetRank",
    "Steady",
    "determined_states",
    "even_sets",
    "exact_rank",
    "exact_ranks",
    "hidden_states",
    "observability",
    "observable_sets",
    "paper_counts",
    "paper_rank",
    "paper_ranks",
    "paper_string",
    "set_ranks",
    "steady_core_sd",
    "table_2",
]
