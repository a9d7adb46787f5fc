"""What observers say of strings at one instant: temperatures, how far off they may be, and what surprised them.

The states of Lin et al., Eq 11 and 18, with bands that the paper does not give.
"""

from dataclasses import dataclass

from bms_gateway.observe.model import Bools
from bms_gateway.thermal import Floats


@dataclass(frozen=True, slots=True)
class Estimate:
    """Temperatures of S strings of n cells at one instant.

    Attributes
    ----------
    core, surface : ndarray (S, n), °C
        NaN where nothing is known yet.
    core_sd, surface_sd : ndarray (S, n), K
        Standard deviations, parameters included; infinite where nothing is known yet.
    innovation, innovation_sd : ndarray (S, n), K
        Reading less prediction and what it should be, parameters included; NaN for cells without a reading.
    available : ndarray of bool (S,)
    """

    core: Floats
    core_sd: Floats
    surface: Floats
    surface_sd: Floats
    innovation: Floats
    innovation_sd: Floats
    available: Bools
