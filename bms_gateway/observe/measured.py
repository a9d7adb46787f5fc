"""What the observer of a string with effects takes in: more of the current, and what only effects ask for.

The inputs and outputs of Lin et al., Eq 11-13.
"""

from dataclasses import dataclass
from math import nan

SOC_UNKNOWN = 0.5
"""Where counting of the charge starts when nobody knows: as offline."""


@dataclass(frozen=True, slots=True)
class Measured:
    """What is measured of one string over one step, beside its surfaces; NaN for what is not.

    Attributes
    ----------
    I, I2, I_abs : float
        Mean current [A, discharge positive], mean square [A²], mean magnitude [A].
    inlet : float, °C
        Coolant inlet at the end of the step.
    flow : float
        Coolant flow over nominal flow; the last one is kept where it is missing.
    soc : float
        State of charge, 0…1; counted where it is missing.
    V, IV : float
        Mean voltage of a cell [V], mean of its product with the current [W].
    """

    I: float = nan  # noqa: E741 - the field's symbol
    I2: float = nan
    I_abs: float = nan
    inlet: float = nan
    flow: float = nan
    soc: float = nan
    V: float = nan
    IV: float = nan
