"""Which readings tell of charge that the training knows: a curve over the state of charge is not known beyond it."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.diagnosis.residuals import interval_of
from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats

LOADED = 0.1
"""Share of the greatest current from which an interval tells what heat is made at its charge."""
HOLE = 0.15
"""Of the capacity: training on both sides of a narrower hole knows what lies in it …"""
EDGE = 0.02
"""… and beyond its ends it reaches so far."""
MEMORY_S = 600.0
"""s for which a surface remembers heat: one slow time constant of a cell."""


def covered(records: Sequence[Measured]) -> np.ndarray:
    """Whether the heat behind each reading was made at a charge at which some record was trained under load.

    Parameters
    ----------
    records : sequence of Measured
        Of one cell type; what is `used` is what was trained.

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
