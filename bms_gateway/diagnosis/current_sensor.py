"""What a record itself says of its current sensor: its reading where nothing flows, and the charge it counts.

An offset of the sensor is there at rest too. Where a tester rests and the record reads zero, there is none, whatever
would fit a temperature; and an offset that moves more charge than the cell holds was never there.
"""

import numpy as np

from bms_gateway.thermal.drive import Drive

REST_S, STRETCH_S = 30.0, 10.0
"""Rest in all, and in one stretch, that make a level: a drive that passes through zero does not stay there."""
ZERO = (0.003, 0.02)
"""Share of the peak, and A: a level below is zero."""
STEADY = 0.003
"""Share of the peak by which the current may move within an interval of rest."""
HOLDS = 1.15
"""Of the capacity: what may be moved in one direction, for capacities are stated with some reserve."""


def rests_at_zero(u: Drive) -> bool:
    """Whether the current reads zero where it rests: for half a minute in all, in stretches of ten seconds and more."""
    peak = float(np.sqrt(u.I2.max()))
    zero = np.abs(u.I) <= max(ZERO[0] * peak, ZERO[1])
    zero &= np.sqrt(np.maximum(u.I2 - u.I**2, 0.0)) <= STEADY * peak
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(np.int8), [0]])))
    stretches = (edges[1::2] - edges[::2]) * u.dt
    return bool(stretches[stretches >= STRETCH_S].sum() >= REST_S)


def charge_too_much(u: Drive, b: float, capacity_Ah: float | None) -> str:
    """Say so where an offset of b A would move more charge than a cell holds, and the current as recorded does not.

    Examples
    --------
    >>> import numpy as np
    >>> one = np.ones(7200)
    >>> u = Drive(1.0, 0 * one, 0 * one, 0 * one, one, one, one, one, one, one, frozenset())
    >>> charge_too_much(u, -0.2, 5.0), charge_too_much(u, -4.0, 5.0)
    ('', 'an offset of -4 A would move 8 Ah through a cell of 5 Ah')
    """
    if capacity_Ah is None:
        return ""
    read, true = (float(np.ptp(np.cumsum(x) * u.dt / 3600.0)) for x in (u.I, u.I - b))
    if true <= HOLDS * capacity_Ah or true <= read:
        return ""
    return f"an offset of {b:.2g} A would move {true:.2g} Ah through a cell of {capacity_Ah:.3g} Ah"
