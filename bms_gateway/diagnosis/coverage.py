"""Which readings belong to a state of charge that was trained: a curve over the charge is unknown elsewhere."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.diagnosis.residuals import interval_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats

LOADED = 0.1
"""Least share of the greatest current with which an interval shows the heat at its charge."""
HOLE = 0.15
"""Share of the capacity: a narrower hole counts as trained if both its sides are …"""
EDGE = 0.02
"""… and so does a range of this width beyond the ends."""
MEMORY_S = 600.0
"""Time, s, over which heat affects a surface: one slow time constant of a cell."""


def covered(records: Sequence[Measured]) -> np.ndarray:
    """Whether the heat behind each reading was made at a charge at which some record was trained under load.

    Parameters
    ----------
    records : sequence of Measured
        Records of one cell type; their `used` readings are the trained ones.

    Returns
    -------
    ndarray of bool
        Of all readings, stacked.
    """
    known = np.sort(np.concatenate([m.drive.soc[_trained(m) & _loaded(m)] for m in records]))
    found = []
    for m in records:
        foreign = _loaded(m) & ~_between(m.drive.soc, known)
        memory = max(round(MEMORY_S / m.drive.dt), 1)
        count = np.concatenate([[0], np.cumsum(foreign)])
        at = interval_of(m) + 1
        found.append(count[at] == count[np.maximum(at - memory, 0)])
    return np.concatenate(found)


def _loaded(m: Measured) -> np.ndarray:
    return np.asarray(np.sqrt(m.drive.I2) > LOADED * np.sqrt(m.drive.I2.max()))


def _trained(m: Measured) -> np.ndarray:
    """Whether the next reading after each interval (N,) was trained."""
    interval = interval_of(m)
    order = np.argsort(interval, kind="stable")
    after = np.minimum(np.searchsorted(interval[order], np.arange(m.drive.N)), len(order) - 1)
    return np.asarray(m.used[order][after])


def _between(soc: Floats, known: Floats) -> np.ndarray:
    """Whether charges lie at, or in a narrow hole between, known ones (sorted)."""
    if not len(known):
        return np.zeros(len(soc), np.bool_)
    place = np.searchsorted(known, soc)
    left, right = known[np.maximum(place - 1, 0)], known[np.minimum(place, len(known) - 1)]
    inside = (place > 0) & (place < len(known))
    near = np.minimum(np.abs(soc - left), np.abs(right - soc)) <= EDGE
    return np.asarray(near | (inside & (right - left <= HOLE)))
