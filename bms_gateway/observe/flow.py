"""Flow of the coolant in steps: matrices are made anew when the flow has moved enough to matter.

C_f is proportional to the flow (`thermal.StringParameters.with_flow_ratio`); beyond Lin et al., whose flow is constant.
"""

import numpy as np

from bms_gateway.observe.model import Bools, Ints, usable
from bms_gateway.thermal import Floats, StringParameters

FLOW_GRID = 0.03
"""Step of ln(flow ratio) between discretisations: C_f is then off by 2 % at most, less than its uncertainty."""
FLOW_LIMITS = (0.02, 50.0)
"""Flow ratios are limited to this range: some air still moves when the fan has stopped."""


def flow_levels(ratio: Floats, level: Ints) -> tuple[Ints, Bools]:
    """Levels (S,) of strings whose flow over nominal is `ratio` (NaN: the last one), and which levels have moved."""
    fine = np.where(np.isfinite(ratio), np.clip(ratio, *FLOW_LIMITS), 1.0)
    grid = np.log(fine) / FLOW_GRID
    moved = np.isfinite(ratio) & (np.abs(grid - level) > 0.75)
    return np.where(moved, np.rint(grid).astype(np.int64), level), moved


def at_level(p: StringParameters, level: int) -> StringParameters:
    """Return the numbers of a string at a level of its flow."""
    return usable(p.with_flow_ratio(float(np.exp(FLOW_GRID * level)))) if level else p
