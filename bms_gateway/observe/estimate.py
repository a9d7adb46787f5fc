"""Estimates of strings at one instant: temperatures, their standard deviations, and the innovations.

The states of Lin et al., Eq 11 and 18, with bands that the paper does not give.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import Bools
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Errors:
    """Innovations of S strings with m sensors each.

    Attributes
    ----------
    value, sd : ndarray (S, m), K
        Reading minus prediction, NaN without a reading; its standard deviation, including that of the parameters.
    on_cells : callable
        Gives values (S, m) of the sensors to their cells (S, n); NaN for cells without one.
    """

    value: Floats
    sd: Floats
    on_cells: Callable[[Floats], Floats]

    def mean_square(self) -> Floats:
        """Mean (S,) of the squared innovations of each string over their variances; NaN without a reading."""
        z = self.value / self.sd
        there = z == z
        if there.all():
            return np.asarray(np.einsum("sm,sm->s", z, z) / z.shape[1], dtype=np.float64)
        z = np.where(there, z, 0.0)
        count = np.count_nonzero(there, axis=1)
        return np.asarray(np.einsum("sm,sm->s", z, z) / np.where(count, count, np.nan), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Estimate:
    """Temperatures of S strings of n cells at one instant.

    Attributes
    ----------
    core, surface : ndarray (S, n), °C
        NaN if nothing is known yet.
    core_sd, surface_sd : ndarray (S, n), K
        Standard deviations, including the parameters' part; infinite if nothing is known yet.
    centre, centre_sd : ndarray (S, n), °C, K
        Hottest point of each cell (`thermal.centre`), never below core or surface.
    errors : Errors
        Of the step's readings.
    available : ndarray of bool (S,)
    """

    core: Floats
    core_sd: Floats
    surface: Floats
    surface_sd: Floats
    centre: Floats
    centre_sd: Floats
    errors: Errors
    available: Bools

    @property
    def innovation(self) -> Floats:
        """Reading minus prediction (S, n), K; NaN for cells without a reading."""
        return self.errors.on_cells(self.errors.value)

    @property
    def innovation_sd(self) -> Floats:
        """Standard deviation of the innovation (S, n), K, including the parameters' part."""
        return self.errors.on_cells(self.errors.sd)
