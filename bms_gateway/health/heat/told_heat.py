"""What the watch over heat tells of all strings."""

from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import Floats

DOUBTED = 0.5
"""Where lost cooling was accepted: share of the difference between the cores of the watch and of the observer that is
in the sd. An effect that the model lacks can look like lost cooling, and the watch's cores are then too cold."""


@dataclass(frozen=True, slots=True)
class Told:
    """Results on heat that no current makes, for S strings of n cells.

    Attributes
    ----------
    heat, heat_sd : ndarray (S, n), W
        NaN for cells that no sensor observes.
    core, core_sd : ndarray (S, n), °C, K
        Cores of cells with accepted heat, and their sd. Where another fault is accepted or suspected: NaN, and the
        change by this fault; elsewhere NaN.
    doubted : ndarray (S, 1)
        Share of a core's difference from the observer's that is in its sd as well.
    some : bool
        Whether any of them is a number.
    """

    heat: Floats
    heat_sd: Floats
    core: Floats
    core_sd: Floats
    doubted: Floats
    some: bool

    def cores(self, core: Floats, sd: Floats) -> tuple[Floats, Floats]:
        """Return `HeatWatch.cores` of the observer's cores (S, n), °C, and their sd, K."""
        if not self.some:
            return core, sd
        value = np.where(np.isfinite(self.core), self.core, core)
        apart = np.nan_to_num(value - core)  # of an observer that does not know a core, nothing
        own = np.hypot(self.core_sd, self.doubted * apart)
        return value, np.where(np.isfinite(self.core_sd), np.hypot(sd, own), sd)
