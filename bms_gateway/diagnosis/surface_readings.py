"""Temperatures at their own stamps, in the form for comparison with a model's trajectory between instants."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.diagnosis.grid import Grid
from bms_gateway.errors import counted
from bms_gateway.frames.vocabulary import INPUTS
from bms_gateway.identify.sensor_noise import resolution, white_noise
from bms_gateway.thermal import Floats

JUMP_K = 2.5
"""A reading that differs from its neighbours by this much is a disturbance of the sensor: no surface moves like
this."""
NEIGHBOURS = 2
CROWDED = 1.5
"""Readings per interval above which they are condensed: the time of a fit grows with the readings."""
FEWEST = 3
"""Least number of readings of a sensor: with fewer, not even its noise is known."""
NEAR = 2.5
"""Greatest distance of two readings, in usual spacings, for linear interpolation to an instant between them."""


@dataclass(frozen=True, slots=True)
class Readings:
    """M readings of some cells.

    Attributes
    ----------
    cells : tuple of int
        From 1.
    sensor : ndarray of intp (M,)
        Index into `cells`; sensor by sensor, each in order of time.
    left : ndarray of intp (M,)
        The last instant at or before the reading, but never the last of all.
    share : ndarray (M,)
        The model's value at the reading is (1 − share) · x[left] + share · x[left + 1].
    y : ndarray (M,)
        °C.
    """

    cells: tuple[int, ...]
    sensor: NDArray[np.intp]
    left: NDArray[np.intp]
    share: Floats
    y: Floats

    def at(self, instants: Floats) -> Floats:
        """Stamps of the readings, s (M,)."""
        return np.asarray(instants[self.left] + self.share * (instants[self.left + 1] - instants[self.left]))

    def on_grid(self, instants: Floats, dt: float) -> Floats:
        """Temperatures at the instants (N + 1, m); NaN if no reading is near."""
        t = self.at(instants)
        out = np.full((len(instants), len(self.cells)), np.nan)
        for j in range(len(self.cells)):
            mine = self.sensor == j
            known, y = t[mine], self.y[mine]
            after = np.clip(np.searchsorted(known, instants, "left"), 1, len(known) - 1)
            a, b = known[after - 1], known[after]
            close = (
                (b - a <= NEAR * max(dt, float(np.median(np.diff(known)))))
                & (a - instants <= 1e-6 * dt)
                & (instants - b <= 1e-6 * dt)
            )
            exact = np.minimum(np.abs(instants - a), np.abs(instants - b)) <= 1e-6 * dt
            out[:, j] = np.where(close | exact, np.interp(instants, known, y), np.nan)
        return out


def gather_readings(
    t: Floats,
    columns: Mapping[int, Floats],
    wanted: Sequence[int],
    grid: Grid,
    notes: list[str],
    *,
    what: str = "surface",
) -> Readings:
    """Take the readings of the wanted cells that lie on the grid.

    Parameters
    ----------
    t : ndarray (K,)
        Stamps of the rows, s.
    columns : mapping of cell to ndarray (K,)
        °C, NaN where missing.
    wanted : sequence of int
        Cells of interest; others are ignored.
    grid : Grid
    notes : list of str
        Notes are appended.
    what : str
        Name of the columns.
    """
    cells: list[int] = []
    parts = []
    for cell in wanted:
        none = np.full(len(t), np.nan)
        left, share, y = _of_one(t, columns.get(cell, none), grid, f"{what} of cell {cell}", notes)
        if len(y) < FEWEST:
            continue
        parts.append((np.full(len(y), len(cells), np.intp), left, share, y))
        cells.append(cell)
    if not parts:
        nowhere = np.empty(0, np.intp)
        return Readings((), nowhere, nowhere, np.empty(0), np.empty(0))
    sensor, left, share, y = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Readings(tuple(cells), sensor, left, share, y)


def _of_one(t: Floats, y: Floats, grid: Grid, name: str, notes: list[str]) -> tuple[NDArray[np.intp], Floats, Floats]:
    """Take the readings of one sensor: plausible ones, on the grid, not more than the grid can use."""
    low, high = INPUTS["surface"].plausible
    known = np.isfinite(y)
    wild = known & ~((y >= low) & (y <= high))
    t, y = t[known & ~wild], y[known & ~wild]
    step = resolution(y) if len(y) else 0.0
    alone = _stands_out(y, max(JUMP_K, JUMP_K * step))
    if count := int(wild.sum() + alone.sum()):
        notes.append(
            f"{counted(count, 'reading')} of the {name} left out: outside what cells have, or far from all around it."
        )
    t, y = t[~alone], y[~alone]
    x = grid.instants
    inside = (t >= x[0] - 1e-6 * grid.dt) & (t <= x[-1] + 1e-6 * grid.dt)
    t, y = t[inside], y[inside]
    left = np.clip(np.searchsorted(x, t + 1e-9 * grid.dt, "right") - 1, 0, len(x) - 2)
    used = ~np.isin(left, grid.gaps) | (np.abs(t - x[left]) <= 1e-6 * grid.dt)
    t, y, left = t[used], y[used], left[used]
    if len(y) > CROWDED * len(x):
        t, y, left = _condense(t, y, left, step)
    share = np.clip((t - x[left]) / (x[left + 1] - x[left]), 0.0, 1.0)
    return left.astype(np.intp), share, y


def _stands_out(y: Floats, limit: float) -> NDArray[np.bool_]:
    """Find single readings far from the median of those around them."""
    if len(y) < 2 * NEIGHBOURS + 1:
        return np.zeros(len(y), np.bool_)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(y, NEIGHBOURS, mode="edge"), 2 * NEIGHBOURS + 1)
    return np.asarray(np.abs(y - np.median(around, axis=1)) > limit)


def _condense(t: Floats, y: Floats, left: NDArray[np.intp], step: float) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Return one reading per interval: the mean of time and temperature, or one reading if the sensor is coarse.

    A mean of rounded readings is on no step, and rounding errors do not average out.
    """
    first = np.flatnonzero(np.diff(left, prepend=-1) > 0)
    count = np.diff(np.append(first, len(left)))
    if step > 0.0 and white_noise(t, y, step) < step:
        chosen = first + count // 2
        return t[chosen], y[chosen], left[chosen]
    return np.add.reduceat(t, first) / count, np.add.reduceat(y, first) / count, left[first]
