r"""Level of a counted state of charge: from the voltage if there is one, otherwise from the capacity.

Counting gives changes of the charge, not its start. The voltage of a rested cell gives the start. Its accuracy depends
on how well the chemistry is known and how steep its curve is: a few per cent for a full NMC cell, next to nothing for a
half full LFP cell. The voltage of a loaded cell is corrected by R_e, half of it at once and half of it slow; this
correction may be wrong by its own size. The charge of a record must not fall below empty or rise above full; this
determines the level if most of the capacity is used.

All voltages of a part count as one reading, because a curve that is wrong by 40 mV is wrong in all of them.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bms_gateway.diagnosis.grid import Grid
from bms_gateway.thermal import Floats
from bms_gateway.thermal.cells.facts import Chemistry
from bms_gateway.thermal.cells.open_circuit import REST_SD_V, REST_V, rest_voltage

LEVELS = np.linspace(0.0, 1.0, 201)
"""Grid of levels, of the capacity."""
BEYOND = 0.02
"""Share of the capacity: sd of the limits at empty and full, because stated capacities are rounded."""
CAPACITY_SD = 0.05
"""Relative sd of a data sheet's capacity: new cells hold a few per cent more, aged cells less."""
SLOW_S = 300.0
"""s in which the slow half of an overpotential (diffusion) builds up and fades."""
LEAST_DOUBT = 0.6
"""Least relative sd of R_e, which is two to three times as high in the cold as at 25 °C."""
BIN = 0.02
"""Share of the capacity: of voltages nearer to each other in charge, only the one with the least load is used."""
AS_GOOD = 1.5
"""Voltages with at most this multiple of the best voltage's sd are used."""
LEAST_SD = 0.01
AT_REST = 0.01
"""Overpotential, V, below which the text calls a cell rested."""


@dataclass(frozen=True, slots=True)
class Terminal:
    """K recorded voltages of a cell, with the current at their rows.

    Attributes
    ----------
    time_s, voltage_V, current_A : ndarray (K,)
    resistance : float
        R_e before any data, Ω.
    resistance_sd : float
        sd of the logarithm of R_e.
    chemistry : Chemistry or None
    """

    time_s: Floats
    voltage_V: Floats
    current_A: Floats
    resistance: float
    resistance_sd: float
    chemistry: Chemistry | None = None


@dataclass(frozen=True, slots=True)
class Level:
    """State of charge at the start of a part.

    Attributes
    ----------
    soc, sd : float
        0…1.
    told_by : {"rest", "load", "capacity"}
        Source of the level: the voltage of a rested cell, that of a loaded one, or only the capacity.
    """

    soc: float
    sd: float
    told_by: Literal["rest", "load", "capacity"]


def within_capacity(counted: Floats) -> Level:
    """Find the level (0…1) from the capacity alone, with its sd.

    All levels at which the part stays between empty and full are equally likely; the limits are as uncertain as the
    capacity.

    Parameters
    ----------
    counted : ndarray (K,)
        Charge of one part since its start, of the capacity.
    """
    down, up = max(-float(counted.min()), 0.0), max(float(counted.max()), 0.0)
    low, high = down, 1.0 - up
    edge = CAPACITY_SD * max(down, up)
    return Level((low + high) / 2.0, float(np.hypot(max(high - low, 0.0) / np.sqrt(12.0), edge)), "capacity")


def by_voltage(counted: Floats, part: slice, current: Floats, grid: Grid, u: Terminal) -> Level | None:
    """Find the level of one part from its voltages; None without a voltage.

    Parameters
    ----------
    counted : ndarray (N,)
        Charge at the middle of each interval since the start of the record, of the capacity.
    part : slice
        Intervals.
    current : ndarray (N,)
        Mean over each interval, discharge positive, A.
    grid : Grid
    u : Terminal
    """
    middle = (grid.instants[part.start + 1 : part.stop + 1] + grid.instants[part.start : part.stop]) / 2.0
    first, last = grid.instants[part.start], grid.instants[part.stop]
    rows = np.flatnonzero((u.time_s >= first) & (u.time_s <= last) & np.isfinite(u.current_A))
    if not len(rows):
        return None
    moved = counted[part] - counted[part.start]
    Q = np.interp(u.time_s[rows], middle, moved)
    fast = u.current_A[rows]
    slow = np.interp(u.time_s[rows], middle, _faded(current[part], grid.dt))
    drop = u.resistance * (0.5 * fast + 0.5 * slow)
    doubt = max(LEAST_DOUBT, u.resistance_sd) * u.resistance * (0.5 * np.abs(fast) + 0.5 * np.abs(slow))
    told = _told(Q, doubt)
    Q, U, doubt = Q[told], (u.voltage_V[rows] + drop)[told], doubt[told]
    soc = LEVELS[:, None] + Q
    outside = np.maximum(np.max(moved) + LEVELS - 1.0, 0.0), np.maximum(-np.min(moved) - LEVELS, 0.0)
    held = -0.5 * (outside[0] ** 2 + outside[1] ** 2) / BEYOND**2
    log_p = []
    for chemistry in REST_V if u.chemistry is None else (u.chemistry,):
        sd = np.hypot(REST_SD_V[chemistry], doubt)
        z = (U - rest_voltage(chemistry, soc)) / sd
        log_p.append(held - 0.5 * np.mean(z**2, axis=1) - np.mean(np.log(sd)))
    p = np.exp(np.array(log_p) - np.max(log_p)).sum(axis=0)
    p /= p.sum()
    mean = float(p @ LEVELS)
    sd = float(np.sqrt(p @ (LEVELS - mean) ** 2))
    return Level(mean, max(sd, LEAST_SD), "rest" if doubt.min() < AT_REST else "load")


def _faded(current: Floats, dt: float) -> Floats:
    """Filter the current with the time constant of the slow overpotential."""
    from scipy.signal import lfilter  # loading this module takes long, so it is done only if there is a voltage

    a = float(np.exp(-dt / SLOW_S))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], current))


def _told(Q: Floats, doubt: Floats) -> np.ndarray:
    """Choose the rows that are used: in each small step of the charge the one with the least load, if it is good."""
    floor = float(min(REST_SD_V.values()))
    order = np.lexsort((doubt, np.round(Q / BIN)))
    first = order[np.diff(np.round(Q[order] / BIN), prepend=np.nan) != 0.0]
    sd = np.hypot(floor, doubt[first])
    return np.asarray(first[sd <= AS_GOOD * sd.min()])
