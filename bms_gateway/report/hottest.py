"""The hottest core of a tick or of a log: the greatest of those that are known, not the greatest guess."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bms_gateway.engine.events import Cells
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import hottest_of

SURE_K: Final = 3.0
"""Largest sd of a core that is compared by its value. One that is known less well may be the greatest by its error."""


@dataclass(frozen=True, slots=True)
class Hottest:
    """The hottest core, with the string, the cell (from 1) and the time.

    Attributes
    ----------
    rank : (bool, float)
        Whether the core is known to `SURE_K`, and the temperature by which it is compared: its value if it is, else
        its value less its sd. The greatest rank is the hottest core.
    """

    string: str
    cell: int
    core_C: float
    core_sd_K: float
    centre_C: float
    time_ns: int
    rank: tuple[bool, float]


def hottest_core(cells: Cells, points: Floats) -> Hottest | None:
    """Find the hottest cell of a string at one tick; None where no core is known.

    Parameters
    ----------
    cells : Cells
    points : ndarray (n,)
        What is compared, °C: the cores, or the hottest points of the cells.
    """
    sure = cells.core_sd <= SURE_K  # NaN is not
    least = np.where(sure, points, points - cells.core_sd)
    k = hottest_of(np.where(sure, least, np.nan))
    known = k is not None
    if k is None and (k := hottest_of(least)) is None:
        return None
    core, sd, centre = (float(x[k]) for x in (cells.core, cells.core_sd, cells.centre))
    return Hottest(cells.string, k + 1, core, sd, centre, cells.time_ns, (known, float(least[k])))


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
    if h.rank[0]:
        return said
    return f"{said} (no core is known to {SURE_K:g} K: this is the one with the greatest value less its sd)"
