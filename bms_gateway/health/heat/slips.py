"""Thermocouples that leave a cell while it heats: their readings do not tell that its heat has ended."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.finding import Finding
from bms_gateway.health.heat.heat_end import LEAST_RATE, heat_there
from bms_gateway.health.heat.layout import Bools

COLDER_SD, COLDER_SHARE, COLDER_S = 3.0, 0.25, 40.0
"""No cell cools by itself. A thermocouple has left its cell if it shows less heat than none by so many sd, and by this
share of the heat that was found, for the time of the third number, s."""
BURNT_C = 100.0
"""Surface temperature that cells in a fire reach. Afterwards they cool faster than their model, which knows neither
radiation nor fumes: then nothing is concluded from it."""
UNKNOWN_SHARE = 0.5
"""Sd of the temperatures of a cell whose thermocouple has left it, as a share of what its heat makes of them; and of
its heat, as a share of what was found."""


def heats_at(findings: Sequence[Finding], cell: int) -> bool:
    """Return whether heat has been found in a 0-based cell or beside it."""
    return any(g.code == "unexplained_heat" and abs((g.cell or 0) - 1 - cell) <= 1 for g in findings)


def failed_since(findings: Sequence[Finding], heat: Finding, m: int) -> Bools:
    """Return which thermocouples (m,) were found to be wrong after a heat began."""
    after = [g.place for g in findings if g.code == "thermocouple" and g.since_ns >= heat.since_ns]
    return np.isin(np.arange(m), after)


def left_by(f: HeatFilter, s: int, g: Finding, used: Bools) -> int | None:
    """Find the thermocouple that has left the cell of heat `g` in string `s`, or None.

    Parameters
    ----------
    f : HeatFilter
    s : int
        String.
    g : Finding
        Heat that was found; the greatest temperature of its surface is kept in it.
    used : ndarray of bool (m,)
        Thermocouples whose readings are used.
    """
    at = f.at
    g.hottest = max(g.hottest, float(f.z[s, 2 * at.told[s, g.place] + 1]))
    apart = at.apart(s, g.place, used)
    if apart.min() > 1:
        return None
    now, sd = heat_there(f, s, g.place, g.places)
    least = max(COLDER_SHARE * g.size, LEAST_RATE * float(f.usual.C[s, g.place]))
    return int(apart.argmin()) if now + COLDER_SD * sd < -least else None


def as_found(f: HeatFilter, s: int, g: Finding) -> None:
    """Let the cell of heat `g` heat as it did when the heat was found; its temperatures are hardly known."""
    here = int(f.at.told[s, g.place])
    p, k = f.parameters(s), 2 * here
    rise = UNKNOWN_SHARE * g.size * float(p.R_c[here] + p.R_u[here])
    heats = {f.at.heat.start + j: g.size if j == g.place else 0.0 for j in g.places}
    for i, sd in (*((h, UNKNOWN_SHARE * g.size) for h in heats), (k, rise), (k + 1, rise)):
        f.part(s, i, sd**2)
    for h, watts in heats.items():
        f.z[s, h] = watts
