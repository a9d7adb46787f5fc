"""Measurements that drive the observer of a string with effects.

The inputs and outputs of Lin et al., Eq 11-13.
"""

from dataclasses import dataclass
from math import nan

SOC_UNKNOWN = 0.5
"""State of charge from which counting starts if it is not known; the same as in fits."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Measurements of one string over one step, without its surfaces; NaN if not measured.

    Attributes
    ----------
    I, I2, I_abs : float
        Mean current [A, discharge positive], mean square [A²], mean magnitude [A].
    inlet : float, °C
        Coolant inlet at the end of the step.
    flow : float
        Coolant flow over nominal flow; where missing, the last value is kept.
    soc : float
        State of charge, 0…1; where missing, it is counted.
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
