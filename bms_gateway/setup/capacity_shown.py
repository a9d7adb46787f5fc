"""Capacity of a pack, by the charge that its current moves while its SOC falls or rises."""

from typing import Final

import numpy as np

from bms_gateway.setup.proposal import Proposal

SWING: Final = 0.1
"""Least change of the SOC that tells a capacity."""
GAP_S, UNSEEN = 10.0, 0.02
"""Time for which a sample of the current holds, or five usual gaps if these are longer; and the share of the log that
may lie beyond: nobody knows what flowed there."""
FOLLOWS: Final = 0.95
"""Least correlation of SOC and charge, by size."""
UNLIKE: Final = 1.5
"""Factor between this capacity and that of the cell from which they contradict each other: an SOC may count the usable
part of the charge only, and a cell ages."""


def capacity_shown(proposal: Proposal) -> float | None:
    """Give the capacity, Ah, that the proposed current and SOC of the first string show; None where they show none.

    Samples of the current are held until the next one. A log with gaps in the current shows none.
    """
    current, soc = next(proposal.of("current", 1), None), next(proposal.of("soc", 1), None)
    if current is None or soc is None or len(current.series.t) < 2:
        return None
    t, I = current.series.t, current.factor * current.series.x + current.shift  # noqa: E741 - the field's symbol
    gaps = np.diff(t)
    held = max(GAP_S, 5.0 * float(np.median(gaps)))
    if float(np.maximum(gaps - held, 0.0).sum()) > UNSEEN * float(t[-1] - t[0]):
        return None
    drawn = np.concatenate([[0.0], np.cumsum(I[:-1] * gaps)]) / 3600.0
    inside = (soc.series.t >= t[0]) & (soc.series.t <= t[-1])
    charge, share = np.interp(soc.series.t[inside], t, drawn), soc.factor * soc.series.x[inside] + soc.shift
    if len(share) < 2 or np.ptp(share) < SWING or np.ptp(charge) == 0.0:
        return None
    if float(np.corrcoef(share, charge)[0, 1]) > -FOLLOWS:
        return None
    return float(-np.polyfit(share, charge, 1)[0])
