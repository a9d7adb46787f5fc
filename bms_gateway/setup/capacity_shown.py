"""Capacity of a pack, from the charge that its current moves while its SOC falls or rises."""

from typing import Final

import numpy as np

from bms_gateway.records.current_witness import FULL_SWING, drawn_Ah
from bms_gateway.setup.proposal import Proposal

FOLLOWS: Final = 0.95
"""Least correlation of SOC and charge, by size."""


def capacity_shown(proposal: Proposal) -> float | None:
    """Estimate the capacity, Ah, from the proposed current and SOC of the first string.

    None if they do not determine it; a log with gaps in the current never does.
    """
    current, soc = next(proposal.of("current", 1), None), next(proposal.of("soc", 1), None)
    if current is None or soc is None or current.against:
        return None
    t, I = current.series.t, current.factor * current.series.x + current.shift  # noqa: E741 - the field's symbol
    drawn = drawn_Ah(t, I)
    if drawn is None:
        return None
    inside = (soc.series.t >= t[0]) & (soc.series.t <= t[-1])
    charge, share = np.interp(soc.series.t[inside], t, drawn), soc.factor * soc.series.x[inside] + soc.shift
    if len(share) < 2 or np.ptp(share) < FULL_SWING or np.ptp(charge) == 0.0:
        return None
    if float(np.corrcoef(share, charge)[0, 1]) > -FOLLOWS:
        return None
    return float(-np.polyfit(share, charge, 1)[0])
