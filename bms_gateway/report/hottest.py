"""The hottest core of a tick or of a log: not the greatest guess."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bms_gateway.engine.events import Cells
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import hottest_of

SURE_K: Final = 3.0
"""Largest sd of a core that is compared by its value; a core known less well is compared by its value less its sd. No
vague guess is the hottest core then, but a cell that burns is, however vague its core."""


@dataclass(frozen=True, slots=True)
class Hottest:
    """The hottest core, with the string, the cell (from 1) and the time.

    Attributes
    ----------
    rank : float, °C
        The temperature by which it is compared with others.
    """

    string: str
    cell: int
    core_C: float
    core_sd_K: float
    centre_C: float
    time_ns: int
    rank: float


def hottest_core(cells: Cells, points: Floats) -> Hottest | None:
    """Find the hottest cell of a string at one tick; None where no core is known.

    Parameters
    ----------
    cells : Cells
    points : ndarray (n,)
        What is compared, °C: the cores, or the hottest points of the cells.
    """
    rank = np.where(cells.core_sd <= SURE_K, points, points - cells.core_sd)
    k = hottest_of(rank)
    if k is None:
        return None
    core, sd, centre = (float(x[k]) for x in (cells.core, cells.core_sd, cells.centre))
    return Hottest(cells.string, k + 1, core, sd, centre, cells.time_ns, float(rank[k]))


def hotter(one: Hottest | None, other: Hottest | None) -> Hottest | None:
    """Give the hotter of two, the first one if they are equal."""
    if one is None or (other is not None and other.rank > one.rank):
        return other
    return one


def hottest_sentence(h: Hottest, start_ns: int) -> str:
    """Say in a sentence which core was the hottest, when, and whether it is sure."""
    after = (h.time_ns - start_ns) * 1e-9
    said = (
        f"hottest core: {h.core_C:.1f} ± {h.core_sd_K:.1f} °C, cell {h.cell} of {h.string}, "
        f"{after:.0f} s after the start"
    )
    return said if h.core_sd_K <= SURE_K else f"{said} (its core is not known to {SURE_K:g} K)"
