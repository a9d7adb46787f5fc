"""State of charge over a record: recorded, or counted from a level that the voltage or the capacity gives."""

from itertools import pairwise

import numpy as np

from bms_gateway.diagnosis.charge_level import Level, Terminal, by_voltage, within_capacity
from bms_gateway.diagnosis.grid import Grid
from bms_gateway.identify.sensor_noise import resolution
from bms_gateway.thermal import Floats

APART = 0.05
"""Share of the capacity by which counted and recorded charge may differ; a greater difference is reported."""
COUNTED, COUNTED_FROM_NOTHING = "counted, its start by the voltage", "counted from an assumed start"
"""Sources of a charge that nobody measured."""
EXPLAINED = 0.8
"""Least share of the drift that a cause must explain to be named."""


def state_of_charge(
    recorded: Floats | None,
    current: Floats,
    grid: Grid,
    capacity_Ah: float | None,
    notes: list[str],
    terminal: Terminal | None = None,
) -> tuple[Floats | None, float, str]:
    """Return the state of charge at the middle of each interval, the sd of its level, and where it comes from.

    Parameters
    ----------
    recorded : ndarray (N,) or None
        0…1.
    current : ndarray (N,)
        Mean, discharge positive, A.
    grid : Grid
    capacity_Ah : float or None
        Of the model file.
    notes : list of str
        Notes are appended.
    terminal : Terminal, optional
        Voltages that determine the level of a counted charge.

    Returns
    -------
    ndarray (N,) or None
        0…1; None without a recorded charge and without a capacity.
    sd : float
        sd of the level of a counted charge; 0 for a recorded one.
    assumed : str
        Where a counted charge comes from, in a few words; empty for a recorded one.
    """
    if capacity_Ah is None:
        if recorded is None:
            notes.append("SOC: not recorded, nor countable without cell.capacity_Ah in the model file.")
        return recorded, 0.0, ""
    counted = _counted(current, grid, capacity_Ah)
    parts = [slice(a, b) for a, b in pairwise([0, *grid.gaps, len(current)])]
    if recorded is None:
        return _at_a_level(counted, parts, current, grid, terminal, notes)
    out = counted.copy()
    for p in parts:
        apart = recorded[p] - counted[p]
        out[p] += float(np.median(apart))
        drift = float(np.percentile(apart, 95) - np.percentile(apart, 5))
        if drift > APART + resolution(recorded[p]):
            hours: Floats = grid.dt / 3600.0 * np.arange(len(apart), dtype=np.float64)
            notes.append(
                f"SOC: the recorded one and the counted one drift apart by {100.0 * drift:.0f} %"
                f"{_cause(apart, hours, counted[p], capacity_Ah)}; the recorded one is used."
            )
            return recorded, 0.0, ""
    return np.clip(out, 0.0, 1.0), 0.0, ""


def _counted(current: Floats, grid: Grid, capacity_Ah: float) -> Floats:
    """Charge at the middle of each interval, counted from the record's start; none flows in gaps."""
    moved = -current * grid.dt / 3600.0 / capacity_Ah
    moved[grid.gaps] = 0.0
    return np.asarray(np.cumsum(moved) - 0.5 * moved)


def _at_a_level(
    counted: Floats, parts: list[slice], current: Floats, grid: Grid, terminal: Terminal | None, notes: list[str]
) -> tuple[Floats | None, float, str]:
    """Set the level of each part by the voltage, otherwise by the capacity."""
    if (span := max(float(np.ptp(counted[p])) for p in parts)) > 1.0 + APART:
        notes.append(
            f"SOC: counting gives a change of {100.0 * span:.0f} %, more than the cell holds by "
            "cell.capacity_Ah: not used."
        )
        return None, 0.0, ""
    out, levels = counted.copy(), []
    for p in parts:
        level = None if terminal is None else by_voltage(counted, p, current, grid, terminal)
        levels.append(level or within_capacity(counted[p] - counted[p][0]))
        out[p] += levels[-1].soc - counted[p][0]
    notes.append(f"SOC: counted from the current; {_told(levels)}.")
    weight = np.array([p.stop - p.start for p in parts], dtype=np.float64)
    sd = float(np.sqrt(np.average([x.sd**2 for x in levels], weights=weight)))
    by_voltage_alone = all(x.told_by != "capacity" for x in levels)
    return np.clip(out, 0.0, 1.0), sd, COUNTED if by_voltage_alone else COUNTED_FROM_NOTHING


def _told(levels: list[Level]) -> str:
    """Say where the level of a counted charge comes from."""
    first, worst = levels[0], max(levels, key=lambda x: x.sd)
    if first.told_by == "capacity":
        return (
            f"its level, {100.0 * first.soc:.0f} ± {100.0 * first.sd:.0f} % (1 sd) at the start, is an assumption: the "
            "middle of what keeps the cell between empty and full"
        )
    what = "at rest" if first.told_by == "rest" else "under load"
    text = f"{100.0 * first.soc:.0f} ± {100.0 * first.sd:.0f} % (1 sd) at the start, by the voltage {what}"
    if len(levels) > 1:
        text += f"; each of {len(levels)} parts has its own level, ± {100.0 * worst.sd:.0f} % at worst"
    return text


def _cause(apart: Floats, hours: Floats, counted: Floats, capacity_Ah: float) -> str:
    """Name a cause of the drift: an offset of the current makes it grow with time, a wrong capacity with the charge."""
    offset, by_time = _line(hours, apart)
    share, by_charge = _line(counted, apart)
    if by_time >= max(by_charge, EXPLAINED):
        return f", as if the current read {offset * capacity_Ah:+.2g} A too much"
    if by_charge >= EXPLAINED and share > -1.0:
        return f", as if the capacity were {capacity_Ah / (1.0 + share):.3g} Ah"
    return ""


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope of a straight line, and the share of the variance that it explains."""
    x, y = x - x.mean(), y - y.mean()
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    return (xy / xx, xy**2 / (xx * yy)) if xx > 0.0 and yy > 0.0 else (0.0, 0.0)
