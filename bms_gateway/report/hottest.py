"""The hottest core of a tick or of a log, without uncertain guesses."""

from dataclasses import dataclass

from bms_gateway.engine.events import Cells
from bms_gateway.thermal import Floats
from bms_gateway.thermal.centre import SURE_K, compared, hottest_of


@dataclass(frozen=True, slots=True)
class Hottest:
    """The hottest core, with the string, the cell (from 1) and the time.

    Attributes
    ----------
    rank : float, °C
        The temperature for comparison with others.
    """

    string: str
    cell: int
    core_C: float
    core_sd_K: float
    centre_C: float
    centre_sd_K: float
    time_ns: int
    rank: float


def hottest_core(cells: Cells, points: Floats) -> Hottest | None:
    """Find the hottest cell of a string at one tick; None if no core is known.

    Parameters
    ----------
    cells : Cells
    points : ndarray (n,)
        Compared temperatures, °C: the cores, or the hottest points of the cells.
    """
    k = hottest_of(points, cells.core_sd)
    if k is None:
        return None
    core, sd, centre, centre_sd = (float(x[k]) for x in (cells.core, cells.core_sd, cells.centre, cells.centre_sd))
    return Hottest(
        cells.string, k + 1, core, sd, centre, centre_sd, cells.time_ns, float(compared(points, cells.core_sd)[k])
    )


def hotter(one: Hottest | None, other: Hottest | None) -> Hottest | None:
    """Return the hotter of two, the first one if they are equal."""
    if one is None or (other is not None and other.rank > one.rank):
        return other
    return one


def hottest_sentence(h: Hottest, start_ns: int, channel: str | None = None) -> str:
    """Say in a sentence which core was the hottest, when, and whether it is certain.

    Parameters
    ----------
    h : Hottest
    start_ns : int
    channel : str, optional
        Signal of the cell's thermocouple.
    """
    named = f" ({channel})" if channel else ""
    after = (h.time_ns - start_ns) * 1e-9
    said = (
        f"hottest core: {h.core_C:.1f} ± {h.core_sd_K:.1f} °C (1 sd), cell {h.cell} of {h.string}{named}, "
        f"{after:.0f} s after the start"
    )
    return said if h.core_sd_K <= SURE_K else f"{said} (its core is not known to {SURE_K:g} K)"
