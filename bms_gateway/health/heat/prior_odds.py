"""How probable each fault is before its evidence."""

import numpy as np

from bms_gateway.health.heat.course import FROZEN_S, SOUND_INLET, Course
from bms_gateway.health.heat.fault_evidence import Evidence, Kind
from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats

USUAL = {Kind.FLOW: 4.0, Kind.INLET: 0.0, Kind.LOAD: 2.0, Kind.STREAM: 4.0, Kind.SLOPE: -2.0, Kind.LAG: 3.0}
"""ln prior of a change in a sound pack, compared with that of a fault."""
DENIED_LN = 6.0  # more ln prior of missing heat where the voltage denies the current


def excluded(kinds: Ints, *, inlet: bool, proven: bool, cools: bool) -> Bools:
    """Return which faults (H,), by their kinds, are not possible now.

    Parameters
    ----------
    kinds : ndarray of int (H,)
    inlet : bool
        The inlet is read. Coolant that nobody reads explains what films do.
    proven : bool
        Heat of a cell is proven: what else all cells show is its work.
    cools : bool
        Few thermocouples are left, and all of them fall: they cannot show heat.
    """
    of_all = kinds >= Kind.FLOW if proven else np.isin(kinds, (Kind.FLOW, Kind.INLET, Kind.STREAM)) & (not inlet)
    return np.asarray(of_all | ((kinds == Kind.HEAT) & (cools and not proven)), dtype=np.bool_)


def ln_prior(e: Evidence, course: Course, s: int) -> Floats:
    """Return the ln prior of each fault (H,) of string `s`."""
    usual = np.array([USUAL.get(Kind(k), 0.0) for k in e.kinds])
    if not (course.frozen[s] * e.of.dt >= FROZEN_S or course.constant_inlet[s] or course.leapt[s] > 0):
        usual[e.kinds == Kind.INLET] = SOUND_INLET
    if course.denied[s]:
        usual[e.kinds == Kind.LOAD] += DENIED_LN
    return usual
