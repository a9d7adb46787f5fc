"""Thermocouples that stand unusually still while others move, as frozen ones do: not used, and soon reported."""

import numpy as np

from bms_gateway.health.heat.fault_evidence import Kind
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats

FROZEN_S, FROZEN_STEPS, FROZEN_SD = 120.0, 2.5, 4.0
"""A thermocouple is frozen if it stands unusually still for so long, and its prediction has moved away from it by so
many steps of its resolution and by so many sd."""
THAWED_S, THAWED_SD = 60.0, 3.0
"""A frozen thermocouple is used again if it moves and is within so many sd of its prediction for so long."""


def alone(still: Floats, used: Bools) -> Bools:
    """Find thermocouples (S, m) that stand unusually still while half of the others in use move."""
    stands = (still > 0.0) & used
    others = used.sum(axis=1, keepdims=True) - used
    also = stands.sum(axis=1, keepdims=True) - stands
    return np.asarray(stands & (others > 0) & (2 * also <= others), dtype=np.bool_)


def shown_by(f: HeatFilter, s: int, fault: tuple[Kind, int], still: Floats) -> bool:
    """Return whether a thermocouple that stands unusually still, (m,) s, shows a fault, in its cell or beside it.

    A frozen thermocouple shows heat where its cell cools, and a sound one moves soon.
    """
    (kind, place), at = fault, f.at
    cell, reach = (int(at.told[s, place]), 1) if kind is Kind.HEAT else (int(at.sensors[s, place]), 0)
    return bool(((still > 0.0) & (np.abs(at.sensors[s] - cell) <= reach)).any())


def frozen(fine: Floats, still: Floats, residual: Floats, sd: Floats) -> Ints:
    """Find thermocouples that are frozen, all (m,).

    Parameters
    ----------
    fine : ndarray, K
        Resolution of their readings.
    still : ndarray, s
        How long they have stood unusually still.
    residual, sd : ndarray, K
        How far they are from their predictions, and its sd; empty where none is known.
    """
    if not len(residual):
        return np.zeros(0, np.int64)
    far = np.abs(residual) > np.maximum(FROZEN_STEPS * fine, FROZEN_SD * sd)
    return np.flatnonzero(far & (still >= FROZEN_S))


def note_still(f: HeatFilter, s: int, g: Finding, still: Floats) -> None:
    """Note how long the thermocouple of a finding has stood unusually still; of one set aside, the longest time."""
    if g.kind is Kind.HEAT:
        here = f.at.sensors[s] == (g.cell or 0) - 1
        g.still_s = float(still[here].max(initial=0.0))
    else:
        g.still_s = max(g.still_s, float(still[g.place]))


def thawed(still_s: float, off: float, sd: float) -> bool:
    """Return whether a frozen thermocouple moves again and is near its prediction: `off` by so much, K, with its sd."""
    return abs(off) < THAWED_SD * sd and still_s == 0.0
