"""Which heat no error of a thermocouple explains, which may be one, and whether a thermocouple still tells of heat."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.health.heat.fault_evidence import Evidence, Kind, Weighed
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.layout import Bools

PROVEN_K = 4.0
"""A cell with heat whose surface is so far above the median of its string's surfaces heats, whatever sensors do."""


def proven(f: HeatFilter, s: int, heats: Sequence[Finding]) -> bool:
    """Tell whether heat that was found in string `s` is proven by a surface far above the others."""
    at, T_s = f.at, f.z[s, 1 : f.at.nodes : 2]
    sensed = at.sensors[s, at.fitted[s]]
    hot = np.intersect1d([at.told[s, j] for g in heats for j in g.places], sensed)
    return bool((T_s[hot] > np.median(T_s[sensed]) + PROVEN_K).any())


def watched(f: HeatFilter, s: int, place: int, used: Bools) -> bool:
    """Tell whether one of the thermocouples (m,) that are used tells of cell number `place` of those told of."""
    at = f.at
    near = np.abs(at.sensors[s] - at.told[s, place]) <= 1
    return bool((near & at.fitted[s] & used).any())


def known(e: Evidence, s: int, w: Weighed, place: int, told: Sequence[Finding]) -> int | None:
    """Give the fault (of H) of a thermocouple that is wrong for all one knows and tells of heat in cell number `place`.

    Parameters
    ----------
    e : Evidence
    s : int
        String.
    w : Weighed
    place : int
        Of the cells that thermocouples tell of.
    told : sequence of Finding
        Thermocouples that were told to be wrong and are still used.
    """
    ln = w.ln[s].max(axis=0)
    for g in told:
        if abs(int(e.at.sensors[s, g.place]) - int(e.at.told[s, place])) <= 1:
            same = np.isin(e.kinds, (Kind.LOOSE, Kind.LAG)) & (e.place == g.place) & np.isfinite(ln)
            if same.any():
                return int(np.where(same, ln, -np.inf).argmax())
    return None
