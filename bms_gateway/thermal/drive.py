"""What drives a string over a recorded stretch: the means of its inputs over the intervals of one uniform grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal.parameters import Floats

KNOWN_NAMES = frozenset({"flow", "soc", "voltage"})


@dataclass(frozen=True, slots=True)
class Drive:
    r"""Input means over N intervals of dt; N + 1 instants bound them.

    .. math:: \bar u_k = \frac{1}{\Delta t} \int_{k \Delta t}^{(k+1) \Delta t} u \, dt

    The mean square, the mean magnitude and the mean product with the voltage stand beside the mean current: heat
    follows them, and none of the three can be told from the mean once the current has moved within an interval.

    Parameters
    ----------
    dt : float
        Length of every interval, s.
    I, I2, I_abs : (N,)
        Current (discharge positive), A; its square, A²; its magnitude, A.
    T_in : (N,)
        Coolant inlet, °C.
    flow : (N,)
        Coolant flow as a ratio to the nominal one; 1 where it was not recorded.
    soc : (N,)
        State of charge, 0…1; from 0.5 on, where no one knows where it started.
    V, IV : (N,)
        Mean voltage of a cell, V, and the mean of current times that voltage, W; NaN where there is none.
    hours : (N,)
        The interval's middle, in hours since the record began.
    known : frozenset of "flow", "soc", "voltage"
        Which of these were recorded, or could be counted. The others hold their neutral value.

    Raises
    ------
    ValueError
        When an array has another length than the others, or `dt` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> one, none = np.ones(2), np.full(2, np.nan)
    >>> Drive(1.0, 10 * one, 100 * one, 10 * one, 20 * one, one, 0.5 * one, none, none, 0 * one, frozenset()).N
    2
    """

    dt: float
    I: Floats  # noqa: E741 - the paper's symbol
    I2: Floats
    I_abs: Floats
    T_in: Floats
    flow: Floats
    soc: Floats
    V: Floats
    IV: Floats
    hours: Floats
    known: frozenset[str]

    def __post_init__(self) -> None:
        shape = (np.size(self.I),)
        for name in ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours"):
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} of a drive has shape {np.shape(getattr(self, name))}, the current {shape}")
        if not self.dt > 0.0:
            raise ValueError(f"the intervals of a drive last {self.dt} s: must be above 0")
        if strange := sorted(self.known - KNOWN_NAMES):
            raise ValueError(f"a drive knows nothing called {strange[0]!r}: {', '.join(sorted(KNOWN_NAMES))}")

    @property
    def N(self) -> int:
        """How many intervals."""
        return int(self.I.size)
