"""Voltages of modules: groups of cells in series with one thermocouple, and with voltages of each cell or of the group.

A cell of the model stands for the cell that its thermocouple sits on, and for those like it. Its voltage is then the
mean of the module's cells. The config names one signal for it: the sum of the module over its cells, or that of the
cell whose voltage is the nearest to their mean all the time.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.setup.find_electrical import ADDS_UP, CELL_V, NOMINAL_V, extreme_cell_V, while_on
from bms_gateway.setup.groups import Member, alike
from bms_gateway.setup.proposal import Proposal, Proposed, fits
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import NOT_MEASURED, OTHER_THINGS, STATISTIC, VOLTAGE, has, named, unit_of

NOT_KNOWN: Final = "which thermocouple sits on which of these cells is not known: not written into the config"


@dataclass(frozen=True, slots=True)
class _Modules:
    """Voltages of whole modules.

    Attributes
    ----------
    voltages : list of Member
        One for each module.
    factor : float
        From the signal's unit to V.
    count : int
        Cells in series of each.
    cell_V : float
        Of one cell, as it usually is.
    """

    voltages: list[Member]
    factor: float
    count: int
    cell_V: float


def place_lumps(
    proposal: Proposal,
    thermocouples: list[Member],
    cells: list[Member],
    series: list[Series],
    edges: NDArray[np.float64],
) -> None:
    """Assign to each cell of the model the voltage of its module, if the names or the sums identify the module.

    Parameters
    ----------
    proposal : Proposal
        With thermocouples, the pack's voltage and the cells' voltages; where these belong to strings already, nothing
        changes.
    thermocouples, cells : list of Member
    series : list of Series
        All signals.
    edges : ndarray, s
    """
    by_path = {p.path: p for p in proposal.of("surface") if p.index is not None}
    mine = [m for m in thermocouples if m.series.path in by_path]
    volted = {p.path: p for p in proposal.of("cell_voltage")}
    if len(mine) < 2 or len(mine) != len(by_path) or any(p.string is not None for p in volted.values()):
        return
    modules = _by_module(mine, [m for m in cells if m.series.path in volted])
    for thermocouple, of_module in modules:
        place = by_path[thermocouple.series.path]
        typical = _nearest_to_mean([m.series for m in of_module], edges)
        for m in of_module:
            p = volted[m.series.path]
            p.why = [w for w in p.why if w != NOT_KNOWN]
            p.sure = False
            if m.series is not typical:
                p.why.append(f"of the module of {place.path}: {typical.path} stands for its {len(of_module)} cells")
                continue
            p.string, p.index = place.string, place.index
            p.why.append(
                f"by the names one of the {len(of_module)} cells of the module of {place.path}, and the nearest to "
                "their mean"
            )
    if modules:
        return
    whole = _whole_modules(proposal, len(mine), series)
    if whole is not None:
        _take(proposal, [by_path[m.series.path] for m in mine], whole)


def _by_module(thermocouples: list[Member], cells: list[Member]) -> list[tuple[Member, list[Member]]]:
    """Find the cells of each thermocouple by a number that both names contain; empty if the numbers do not fit."""
    for own in range(len(thermocouples[0].whole)):
        keys = [m.whole[own] for m in thermocouples]
        for column in range(len(cells[0].where) if cells else 0):
            found = [[c for c in cells if c.where[column] == key] for key in keys]
            sizes = {len(f) for f in found}
            if (
                len(set(keys)) == len(keys)
                and len(sizes) == 1
                and min(sizes) > 1
                and sum(map(len, found)) == len(cells)
            ):
                return list(zip(thermocouples, found, strict=True))
    return []


def _nearest_to_mean(of_module: list[Series], edges: NDArray[np.float64]) -> Series:
    rows = np.array([s.on_grid(edges) for s in of_module])
    rows = rows[:, np.isfinite(rows).all(axis=0)]
    if not rows.shape[1]:
        return of_module[0]
    # by medians, because the voltages are not read at one instant, and the current may step between the readings
    return of_module[int(np.median(np.abs(rows - rows.mean(axis=0)), axis=1).argmin())]


def _whole_modules(proposal: Proposal, thermocouples: int, series: list[Series]) -> _Modules | None:
    """Find the voltages of whole modules, as many as thermocouples, which add up to the pack's."""
    pack = next((p.factor * while_on(p.series) for p in proposal.of("voltage") if p.string is None), None)
    used = {p.path for p in proposal.signals}
    voltages = [s for s in series if s.path not in used and _may_be_voltage(s)]
    for group in alike(voltages) if pack is not None else []:
        middles = np.array([while_on(m.series) for m in group])
        unit = unit_of(group[0].series.info.unit)
        for factor in (unit.factor,) if unit is not None else (1.0, 0.1, 1e-2, 1e-3):
            if len(group) != thermocouples or abs(factor * middles.sum() / pack - 1) > ADDS_UP:
                continue
            each = factor * float(np.median(middles))
            count = round(each / (extreme_cell_V(series) or _of_one(pack, proposal)))
            if count < 2 or not CELL_V[0] < each / count < CELL_V[1]:
                continue
            return _Modules(group, factor, count, each / count)
    return None


def _of_one(pack_V: float | None, proposal: Proposal) -> float:
    """Voltage of one cell by the proposed number of cells in series."""
    return pack_V / proposal.series_cells if pack_V is not None and proposal.series_cells else NOMINAL_V


def _take(proposal: Proposal, places: list[Proposed], whole: _Modules) -> None:
    """Assign to the cell of each thermocouple its share of the module's voltage."""
    modules, count = len(whole.voltages), whole.count
    for place, m in zip(places, whole.voltages, strict=True):
        why = [
            f"one of {modules} voltages that add up to the pack's, as many as thermocouples: of {count} cells in "
            f"series each, by {whole.cell_V:.3g} V of a cell, so a {count}th of it is that of a cell",
        ]
        proposal.signals.append(
            Proposed("cell_voltage", m.series, whole.factor / count, 0.0, place.string, place.index, why=why)
        )
    cells = count * modules
    if proposal.series_cells != cells:
        proposal.remarks.append(f"the voltages of {modules} modules make {cells} cells in series likelier")
        proposal.series_cells = cells


def _may_be_voltage(s: Series) -> bool:
    unit, mine = unit_of(s.info.unit), named(s.info)
    if has(mine, NOT_MEASURED, OTHER_THINGS, tuple(STATISTIC)) or s.constant or not fits("cell_voltage", s.info):
        return False
    return has(mine, VOLTAGE) if unit is None else unit.family == "voltage"
