"""Offset of the current sensor by the record itself: its reading at rest, and the charge that it counts.

An offset is present at rest too. If the record reads zero while the tester rests, there is no offset, even if an offset
would fit the temperatures. An offset that would move more charge than the cell holds is impossible.
"""

import numpy as np

from bms_gateway.thermal.drive import Drive

REST_S, STRETCH_S = 30.0, 10.0
"""Least rest in all, and in one stretch, that shows the reading at rest: a drive passes through zero only briefly."""
ZERO = (0.003, 0.02)
"""Share of the peak, and A, below which the reading at rest is zero."""
STEADY = 0.003
"""Greatest change of the current within an interval of rest, as a share of the peak."""
HOLDS = 1.15
"""Greatest charge in one direction over the capacity, because stated capacities have some reserve."""


def rests_at_zero(u: Drive) -> bool:
    """Whether the current reads zero at rest: for half a minute in all, in stretches of ten seconds and more."""
    peak = float(np.sqrt(u.I2.max()))
    zero = np.abs(u.I) <= max(ZERO[0] * peak, ZERO[1])
    zero &= np.sqrt(np.maximum(u.I2 - u.I**2, 0.0)) <= STEADY * peak
    edges = np.flatnonzero(np.diff(np.concatenate([[0], zero.astype(np.int8), [0]])))
    stretches = (edges[1::2] - edges[::2]) * u.dt
    return bool(stretches[stretches >= STRETCH_S].sum() >= REST_S)


def charge_too_much(u: Drive, b: float, capacity_Ah: float | None) -> str:
    """Say if an offset of b A, but not the recorded current, would move more charge than a cell holds; else empty.

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
