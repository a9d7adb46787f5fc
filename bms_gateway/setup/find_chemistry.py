"""Tells iron phosphate from other lithium-ion cells, and counts the cells in series, by pack voltage and SOC.

The rest voltage of iron phosphate is nearly the same from a tenth to nine tenths of the charge; that of the others
rises by half a volt. The pack's voltage is fitted as N · rest voltage − R · current, with the current also
smoothed for the polarisation. The curve that fits better gives the chemistry, and N the number of cells.
"""

from dataclasses import dataclass
from typing import Final, get_args

import numpy as np

from bms_gateway.thermal import Floats
from bms_gateway.thermal.cells import Chemistry
from bms_gateway.thermal.cells.open_circuit import rest_voltage

FLAT: Final[Chemistry] = "LFP"
SLOW_S: Final = 60.0
"""Time of the polarisation that is fitted."""
LEAST_SWING: Final = 0.08
"""Least change of the SOC that shows the slope of the rest voltage."""
INSIDE: Final = (0.12, 0.92)
"""SOC between which the curves of all cells of one chemistry are alike."""
CLEARLY: Final = 0.6
"""Ratio of the errors of two curves below which the smaller one is believed."""
FEWEST: Final = 60
FLAT_V: Final = 3.3
"""Mean voltage of an iron phosphate cell over a drive."""
OTHERS_V: Final = 3.7
"""Mean voltage of the other lithium-ion cells."""


@dataclass(frozen=True, slots=True)
class Chemistries:
    """What pack voltage and SOC say of the cells.

    Attributes
    ----------
    flat : bool or None
        Whether they are iron phosphate; None if it is not told.
    cells_flat, cells_other : float
        Number of cells in series if they are iron phosphate, and if they are not.
    """

    flat: bool | None
    cells_flat: float
    cells_other: float


def chemistries(I: Floats, V: Floats, soc: Floats, step_s: float) -> Chemistries | None:  # noqa: E741
    """Compare the voltage of a pack with the rest voltages of the chemistries; None without values in the middle range.

    Parameters
    ----------
    I, V, soc : ndarray (n,)
        Means over intervals, A (either sign), V and 0…1; NaN where unknown.
    step_s : float
        Length of an interval.
    """
    known = np.isfinite(I) & np.isfinite(V) & np.isfinite(soc) & (soc > INSIDE[0]) & (soc < INSIDE[1])
    if known.sum() < FEWEST:
        return None
    flow = np.where(np.isfinite(I), I, 0.0)
    slow, last, keep = np.empty(len(flow)), 0.0, float(np.exp(-step_s / SLOW_S))
    for k, x in enumerate(flow.tolist()):
        slow[k] = last = keep * last + (1.0 - keep) * x
    found: dict[Chemistry, tuple[float, float]] = {}
    for kind in get_args(Chemistry):
        columns = np.stack([rest_voltage(kind, soc[known]), flow[known], slow[known]], axis=1)
        size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
        x = np.linalg.lstsq(columns / size, V[known], rcond=None)[0] / size
        found[kind] = float(np.std(V[known] - columns @ x)), float(x[0])
    error, cells = found.pop(FLAT)
    other, of_others = min(found.values())
    if not (cells > 0.0 and of_others > 0.0):
        return None
    swing = float(np.ptp(np.quantile(soc[known], (0.02, 0.98))))
    flat = None
    if swing >= LEAST_SWING and min(error, other) < CLEARLY * max(error, other):
        flat = error < other
    return Chemistries(flat, cells, of_others)


@dataclass(frozen=True, slots=True)
class Counted:
    """Voltage of one cell in series, and the reasons for it.

    Attributes
    ----------
    cell_V : float
    why : str
        What follows "of"; it names the other count where the chemistry is not told.
    told : bool
        Whether data or a person tell the chemistry.
    """

    cell_V: float
    why: str
    told: bool


def count_cells(pack_V: float, found: Chemistries | None, chemistry: Chemistry | None) -> Counted:
    """Decide the voltage of one cell, from which the number of cells in series follows.

    Parameters
    ----------
    pack_V : float
    found : Chemistries or None
        What the log shows.
    chemistry : Chemistry or None
        Of the cell that a person has named.
    """
    flat = chemistry == FLAT if chemistry is not None else None if found is None else found.flat
    by_charge = "by its voltage over the SOC" if found is not None else "by the usual voltage of such a cell"
    n_flat, n_other = (pack_V / FLAT_V, pack_V / OTHERS_V) if found is None else (found.cells_flat, found.cells_other)
    cell_V = pack_V / max(round(n_flat if flat else n_other), 1)
    if chemistry is not None:
        return Counted(cell_V, f"{chemistry}, as the cell is named, {by_charge}", told=True)
    if flat is not None:
        what = "hardly rises with the SOC: iron phosphate (LFP)" if flat else "rises with the SOC: not iron phosphate"
        return Counted(cell_V, f"a kind whose voltage {what}", told=True)
    other = max(round(n_flat), 1)
    return Counted(
        cell_V, f"NMC or the like, {by_charge}; of iron phosphate (LFP) {other}: --cell tells which", told=False
    )
