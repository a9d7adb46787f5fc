"""Warmth of the cores in a window, by which their R_e changes (`thermal.warmth`).

For Lin et al., Eq 1, whose R_e is constant; not in the paper.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.identify.carried import Course
from bms_gateway.identify.response import Warmth
from bms_gateway.identify.window_means import Means
from bms_gateway.thermal import Floats, StringParameters
from bms_gateway.thermal.warmth import warmth

MOST_RATIO = 3.0
"""Limit of the ratio of two roots' swings, which says nothing where cores hardly move."""


def at_readings_of(means: Means, simulated: Floats, core: Floats, p: StringParameters, step_s: float) -> Floats:
    """Move simulated cores to where the thermocouples say that they are.

    A core lies above the coolant by (R_c + R_u)/R_u times as much as its surface. Without this, a simulation with
    another R_e would have other cores, and B and R_e would approach each other in many small steps.

    Parameters
    ----------
    means : Means
        Readings of m thermocouples.
    simulated : ndarray (G, m), °C
        Surfaces of the simulation at the times of the readings.
    core : ndarray (C, n), °C
        Its cores in the middle of C steps of `step_s` seconds.
    p : StringParameters
        Of n cells.
    step_s : float, s

    Returns
    -------
    ndarray (C, n), °C
    """
    counted = means.valid.sum(axis=1)
    read = np.flatnonzero(counted)
    if not len(read):
        return core
    off = np.where(means.valid, means.y - simulated, 0.0)[read].sum(axis=1) / counted[read]
    moved = np.interp((np.arange(len(core)) + 0.5) * step_s, (read + 0.5) * means.dt, off)
    return np.asarray(core + np.outer(moved, 1.0 + p.R_c / p.R_u), dtype=np.float64)


def warmth_of(core: Floats, course: Course) -> tuple[Warmth, float, float]:
    """Find the warmth of cores at `core` (C, n), °C, in the coarse steps of a window.

    Returns
    -------
    Warmth
        At the ticks, with the pattern that leaves least of the cells' differences, weighted by the squared current.
    float, float
        Mean of the warmth over the squared current, at which R_e is stated, and its sd; 0 without a current.
    """
    u = warmth(core)
    mean = u.mean(axis=1)
    own, square = u - mean[:, None], np.maximum(course.square, 0.0)  # effects of a model may cool, as with I² < 0
    weighted = own * np.sqrt(square)[:, None]
    profile = np.linalg.svd(weighted, full_matrices=False)[2][0] if weighted.any() else np.zeros(u.shape[1])
    mine, apart = (np.repeat(x, course.per)[: course.ticks] for x in (mean, own @ profile))
    whole = float(square.sum())
    if not whole > 0.0:
        return Warmth(mine, apart, profile), 0.0, 0.0
    at = float(square @ mean) / whole
    return Warmth(mine, apart, profile), at, float(np.sqrt(square @ (mean - at) ** 2 / whole))


@dataclass(slots=True)
class CoresOfRoots:
    """Warmth of the present cores of a window, and what earlier evidence means for the cells of each root of Eq 9.

    What was learnt of R_e and B belongs to the cores of the better root. The same surfaces of the other root come from
    cores of another mean and another swing: its R_e at their warmth, and its B times the ratio of the swings, are what
    the evidence knows.

    Attributes
    ----------
    mean, swing : float
        As of `warmth_of`.
    better : (float, float) or None
        These two of the better root while the other is sought.
    more, of_B : float
        Of the better root: its warmth beside that of the evidence, and the factor on its B.
    """

    mean: float = 0.0
    swing: float = 0.0
    better: tuple[float, float] | None = None
    more: float = 0.0
    of_B: float = 1.0

    def seek_other(self) -> None:
        """From now on, cells of the other root are meant."""
        self.better = self.mean, self.swing

    def keep(self, other: bool) -> None:
        """From now on, the better root is meant again, or the `other`, which is better then."""
        if other:
            self.more, self.of_B = self.known()
        self.better = None

    def known(self) -> tuple[float, float]:
        """Return the warmth, beside that of the evidence, at which R_e of these cells is known, and the factor on B."""
        if self.better is None or not self.better[1] > 0.0:
            return self.more, self.of_B
        mean, swing = self.better
        of_B = min(max(self.of_B * self.swing / swing, 1.0 / MOST_RATIO), MOST_RATIO)
        return self.more + self.mean - mean, of_B
