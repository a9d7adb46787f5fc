"""Finds the SOC: a ratio that changes slowly and falls while the cells discharge."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.setup.find_electrical import Electrical, Scored
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import (
    CELL,
    CHARGE,
    LEVEL,
    NOT_MEASURED,
    OTHER_THINGS,
    PACK,
    STATISTIC,
    Unit,
    around,
    has,
    named,
    unit_of,
)

SCALES: Final = ((1.05, 1.0, "shares of 1"), (105.0, 1e-2, "%"), (1050.0, 1e-3, "0.1 %"), (10_500.0, 1e-4, "0.01 %"))
"""Greatest value, factor to a ratio (0…1), and the name of the unit."""
FAST: Final = 0.02
"""Greatest rate of an SOC, 1/s."""
SWING: Final = 0.01
"""Change of the SOC that tells the sign of a current."""
FOLLOWS: Final = 0.9
"""Correlation with the charge drawn."""
SAID: Final = 3.0
"""Least score of an SOC that may decide the sign of a current."""
UNSURE: Final = 2.9
"""Greatest score of a level that only its fall shows to be the SOC: it is proposed, and decides nothing."""
_STATE: Final = ("state", "level", "zustand", "stand", "etat", "estado", "stato")
_CHARGE: Final = ("charge", "carga", "carica", "lade")


def charges(series: list[Series], electrical: Electrical, edges: NDArray[np.float64]) -> list[Scored]:
    """Rank the signals that may be the SOC.

    Parameters
    ----------
    series : list of Series
    electrical : Electrical
        Contains the current with which the SOC must fall.
    edges : ndarray, s
    """
    found = []
    for s in series:
        mine = named(s.info)
        said = has(mine, CHARGE) or (has(mine, _CHARGE) and has(mine, _STATE) and "target" not in mine)
        unit = unit_of(s.info.unit)
        share = unit is not None and unit.family == "share"
        its = around(s.info)
        level = not said and share and has(mine, LEVEL) and has((*mine, *its), PACK) and not has(mine, OTHER_THINGS)
        if not (said or level) or (unit is not None and not share) or s.info.place.size < 6:
            continue
        factor, told = _scale(s, unit)
        if factor is None:
            continue
        score = 3.0 + 1.5 * share + 0.5 * has((*mine, *its), PACK) - 1.0 * has(mine, CELL)
        barred = tuple(w for w in NOT_MEASURED if w not in ("state", "sp"))
        score -= 3.0 * has(
            mine,
            barred,
            tuple(w for w in STATISTIC if STATISTIC[w] != "mean"),
            ("target", "keep", "related", "correction", "user", "display"),
        )
        why = ["named as the SOC" if said else "a level of the battery", *([told] if told else [])]
        values = factor * s.x
        steps = np.abs(np.diff(values)) / np.maximum(np.diff(s.t), 1.0)
        if len(steps) and np.quantile(steps, 0.98) > FAST:
            score -= 2.0
            why.append("it moves faster than a charge does")
        if values.max() == values.min() and values[0] in (0.0, 1.0):
            score -= 2.5
        if (agrees := _falls(s, factor, electrical, edges)) is not None:
            score += 1.0 if agrees else -1.0
            why.append("falls as current is drawn" if agrees else "does not follow the current drawn")
        if level:
            if not agrees:
                continue
            score = min(score, UNSURE)
        found.append(Scored(s, factor, 0.0, float(score), why, unit))
    return sorted(found, key=lambda c: -c.score)


def sign_by_charge(charge: list[Scored], current: Scored, edges: NDArray[np.float64]) -> float | None:
    """Find the sign that makes discharge positive: the SOC falls on discharge.

    Returns
    -------
    float or None
        +1 or −1; None if the SOC changes by less than 1 %, or does not follow the current.
    """
    sure = [c for c in charge if c.score >= SAID]
    if not sure:
        return None
    I = current.factor * current.series.on_grid(edges)  # noqa: E741 — the field's
    drawn, soc = np.nancumsum(I), sure[0].factor * sure[0].series.on_grid(edges)
    both = np.isfinite(soc)
    if both.sum() < 30 or np.ptp(soc[both]) < SWING or np.ptp(drawn[both]) == 0.0:
        return None
    t = edges[:-1][both]
    r = [float(np.corrcoef(a, b)[0, 1]) for a, b in ((soc[both], drawn[both]), (soc[both], t), (drawn[both], t))]
    if abs(r[0]) > FOLLOWS and not abs(r[2]) > FOLLOWS:
        return -float(np.sign(r[0]))
    # an offset of the current adds a charge proportional to time; so the part proportional to time is removed from both
    rest, beside = (x - np.polyval(np.polyfit(t, x, 1), t) for x in (soc[both], drawn[both]))
    if not rest.std() or not beside.std():
        return None
    partial = float(np.corrcoef(rest, beside)[0, 1])
    return -float(np.sign(partial)) if abs(partial) > FOLLOWS else None


def _scale(s: Series, unit: Unit | None) -> tuple[float | None, str | None]:
    if unit is not None and s.high <= 110.0 and s.high > 1.5:
        return unit.factor, None
    for most, factor, name in SCALES:
        if s.high <= most:
            if unit is not None and factor != unit.factor and s.high > 1.5:
                return factor, f"the DBC's scale contradicts the data: up to {s.high:g} is read as {name}"
            return (unit.factor if unit is not None and s.high <= 1.5 else factor), None
    return None, None


def _falls(s: Series, factor: float, e: Electrical, edges: NDArray[np.float64]) -> bool | None:
    """Whether the SOC changes in the direction of the current; None if their changes are too small to tell."""
    if e.current is None or not e.told:
        return None
    current = e.sign * e.current.factor * e.current.series.on_grid(edges)
    drawn = np.nancumsum(current)
    soc = factor * s.on_grid(edges)
    both = np.isfinite(soc)
    if both.sum() < 30 or np.ptp(soc[both]) < 0.01 or np.ptp(drawn[both]) == 0.0:
        return None
    return bool(np.corrcoef(soc[both], drawn[both])[0, 1] < -0.3)
