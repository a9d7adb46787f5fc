"""Finds the voltages of the cells, the pack's voltage and its current, by name, by unit, and by Ohm's law.

The voltages of the cells add up to the pack's voltage. The pack's voltage falls when a current discharges it: this
selects one of several currents, and shows its sign.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from bms_gateway.records.current_witness import ALTERNATES, alternates
from bms_gateway.setup.both_ways_by_data import apart, by_data
from bms_gateway.setup.find_both_ways import BothWays, both_ways
from bms_gateway.setup.groups import Member, alike
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import (
    CELL,
    CHARGING,
    CURRENT,
    NOT_MEASURED,
    OTHER_THINGS,
    PACK,
    STATISTIC,
    VOLTAGE,
    Unit,
    around,
    has,
    named,
    statistic,
    unit_of,
)  # fmt: skip
from bms_gateway.thermal import Floats

CELL_V: Final = (1.2, 4.6)
"""Range of cell voltages: from an empty titanate cell to a full cell with a high-voltage cathode."""
NOMINAL_V: Final = 3.7
UNLIKE_V: Final = 0.5
"""Greatest spread of the voltages of most cells of one pack."""
ADDS_UP: Final = 0.04
FALLS: Final = 0.25
"""Correlation of the steps of voltage and current above which the current is taken as their cause."""
CELL_OHM: Final = (2e-5, 0.4)
"""Range for one cell or cells in parallel: from a cell of 500 Ah to a cold cell of 1 Ah."""
FINE_STEPS: Final = 8
FEW: Final = 6
BOTH_SIGNS: Final = 0.02
"""Least ratio of the two extremes of a current that has both signs."""
ALTERNATING: Final = 4.0
"""Score taken from a current that alternates from sample to sample."""
SAME: Final = 0.95
"""Correlation above which a signal and the two directions of a current are the same current."""
SAME_MESSAGE: Final = 2.0
"""Score added to a current and a voltage of one message: its sender measures both at one place."""


@dataclass(slots=True)
class Scored:
    """A candidate: a series with SI = factor · x + shift, its score and the reasons for it.

    `both_ways` are the two signals of a current that has one for each direction. `maybe_other` is a signal that may be
    the other direction of this one: they never flow at once, and nothing confirms it.
    """

    series: Series
    factor: float
    shift: float
    score: float
    why: list[str]
    unit: Unit | None = None
    both_ways: BothWays | None = None
    maybe_other: str | None = None

    @property
    def values(self) -> Floats:
        """SI."""
        return self.factor * self.series.x + self.shift

    @property
    def middle(self) -> float:
        """Median of the values that are not near 0, SI: a pack's voltage is 0 while its contactors are open."""
        return self.factor * while_on(self.series) + self.shift


def while_on(s: Series) -> float:
    """Median of the values that are not near 0, in the DBC's unit."""
    on = s.x[s.x > 0.3 * s.high] if s.high > 0 else s.x
    return float(np.median(on)) if len(on) > 0.1 * len(s.x) else s.middle


def cell_voltages(series: list[Series]) -> tuple[list[Member], float]:
    """Find the largest group of cell voltages, and the factor to volts."""
    best: list[Member] = []
    found = (0.0, 1.0)
    voltages = [s for s in series if _may_be_voltage(s)]
    totals = [f * while_on(s) for s in series if has(named(s.info), VOLTAGE) for f in (1.0, 0.1, 1e-2, 1e-3)]
    for group in alike(voltages):
        if any(has(named(m.series.info), NOT_MEASURED, tuple(STATISTIC)) for m in group):
            continue
        middles = np.array([m.series.middle for m in group])
        unit = unit_of(group[0].series.info.unit)
        factors = (unit.factor,) if unit is not None and unit.family == "voltage" else (1.0, 1e-3, 1e-4)
        for factor in factors:
            v = middles * factor
            inside = (v > CELL_V[0]) & (v < CELL_V[1])
            said = has(named(group[0].series.info), CELL) or has(around(group[0].series.info), CELL)
            if (
                inside.mean() < 0.6
                or np.ptp(np.quantile(v[inside], (0.2, 0.8))) > UNLIKE_V
                or not (said or len(group) >= 4 or unit)
            ):
                continue
            if len(group) == 1 and not said:
                continue
            adds = any(abs(t / float(np.sum(v)) - 1) < ADDS_UP for t in totals)
            if not (said or unit or (adds and len(group) >= 4)):
                continue  # if the names do not say voltage, the sum must be the pack's voltage
            score = float(len(group) + 20 * said + 10 * (unit is not None) + 2 * inside.mean())
            if score > found[0]:
                best, found = group, (score, factor)
            break
    return best, found[1]


def extreme_cell_V(series: list[Series]) -> float | None:
    """Mean of the greatest and the least cell voltage if the bus sends both; None otherwise."""
    middles: dict[str, list[float]] = {}
    for s in series:
        kind, unit, mine = statistic(s.info), unit_of(s.info.unit), named(s.info)
        rest = tuple(w for w in mine if w not in STATISTIC)
        if kind is None or not has(mine, CELL) or has(rest, NOT_MEASURED, OTHER_THINGS):
            continue
        if unit is not None and unit.family == "voltage" and not s.constant:
            middles.setdefault(kind, []).append(unit.factor * while_on(s))
    found = [float(np.median(v)) for v in middles.values()]
    inside = [v for v in found if CELL_V[0] < v < CELL_V[1]]
    return float(np.mean(inside)) if inside else None


def _may_be_voltage(s: Series) -> bool:
    unit = unit_of(s.info.unit)
    if unit is not None:
        return unit.family == "voltage"
    if has(named(s.info), VOLTAGE, CELL) or has(around(s.info), CELL):
        return True
    return s.info.place.size >= 10 and any(CELL_V[0] < f * s.middle < CELL_V[1] for f in (1.0, 1e-3, 1e-4))


def pack_voltages(series: list[Series], cells: list[Member], factor: float) -> list[Scored]:
    """Rank the signals that may be the pack's voltage; the one that equals the sum of the cell voltages comes first."""
    own = {m.series.path for m in cells}
    total = factor * float(np.sum([m.series.middle for m in cells])) if len(cells) > 1 else np.nan
    found = []
    for s in series:
        unit, mine, its = unit_of(s.info.unit), named(s.info), around(s.info)
        said = has(mine, VOLTAGE)
        if s.path in own or s.info.choices or not (unit.family == "voltage" if unit else said) or s.distinct < 2:
            continue
        score = 2.0 * (unit is not None) + 1.5 * said + 1.5 * has(mine, PACK) + 0.5 * has(its, PACK)
        why = [f"unit {s.info.unit}" if unit else "named as a voltage"]
        score -= 3.0 * has(mine, NOT_MEASURED, tuple(STATISTIC)) + 2.0 * has(mine, CELL)
        score -= 4.0 * has(mine, OTHER_THINGS) + 1.0 * has(its, OTHER_THINGS)
        for f in (unit.factor,) if unit else (1.0, 0.1, 1e-2, 1e-3):
            middle, candidate = f * while_on(s), score
            if not 1.5 <= middle <= 1500:
                continue
            reasons = list(why)
            if np.isfinite(total) and abs(middle / total - 1) < ADDS_UP:
                candidate += 3.0
                reasons.append(f"the {len(cells)} cell voltages add up to it ({total:.4g} V against {middle:.4g} V)")
            elif not np.isfinite(total):
                candidate += 0.5 * np.log10(middle)
            if not unit and f != 1.0:
                candidate -= 0.5
            found.append(Scored(s, f, 0.0, float(candidate), reasons, unit))
    return sorted(found, key=lambda c: -c.score)


def currents(series: list[Series]) -> list[Scored]:
    """Rank the signals that may be the pack's current by name, unit and movement; Ohm's law is applied later.

    Two signals for the two directions of one current are one candidate, unless a single signal carries this current.
    """
    single = _currents(series, {})
    found, limits = both_ways(series)
    for c in single:
        if c.series.path in limits:
            c.score -= 4.0
            c.why.append("charge and discharge have a value at once: limits")
    never_at_once = apart(series, limits.union(*(pair.paths for pair in found)))
    found += by_data(never_at_once, series)
    for c in single:
        others = [b.path if a is c.series else a.path for a, b in never_at_once if a is c.series or b is c.series]
        c.maybe_other = others[0] if others else None
    pairs = [pair for pair in found if not any(_same(pair.net, c) for c in single if c.score > 0.0)]
    halves = {path for pair in found for path in pair.paths}
    joined = _currents([pair.net for pair in pairs], {pair.net.path: pair for pair in pairs})
    return sorted([*joined, *(c for c in single if c.series.path not in halves)], key=lambda c: -c.score)


def _same(net: Series, c: Scored) -> bool:
    """Whether a signal carries the current of both directions."""
    if c.series.path == net.path or not (c.series.low < 0.0 < c.series.high):
        return False
    x = np.interp(net.t, c.series.t, c.series.x)
    return bool(net.x.std() and x.std() and abs(np.corrcoef(net.x, x)[0, 1]) > SAME)


def _currents(series: list[Series], pairs: Mapping[str, BothWays]) -> list[Scored]:
    """Score signals as currents of the pack; `pairs` are those of two signals, by the path of the joined one."""
    found = []
    for s in series:
        unit, mine, its = unit_of(s.info.unit), named(s.info), around(s.info)
        said, pair = has(mine, CURRENT), pairs.get(s.path)
        if (s.info.choices and len(s.info.choices) > 3) or not (unit.family == "current" if unit else said):
            continue
        factor = unit.factor if unit else 1.0
        score = 2.5 * (unit is not None) + 2.0 * said + 1.5 * has(mine, PACK) + 0.75 * has(its, PACK)
        why = [f"unit {s.info.unit}" if unit else "no unit", "named as a current" if said else "not named as one"]
        told = mine if pair is None else tuple(w for w in mine if w not in CHARGING)
        if has(told, NOT_MEASURED, OTHER_THINGS, tuple(STATISTIC)):
            score -= 4.0
            why.append("its name says something else too")
        if has(its, OTHER_THINGS):
            score -= 1.5
        values = factor * s.x
        if alternates(s.t, values):
            score -= ALTERNATING
            why.append(ALTERNATES)
        if s.constant:
            score -= 3.0
            why.append(f"stands at {values[0]:g} A in this log")
        elif s.mode_share > 0.98:
            score -= 1.0
        low, high = s.low * factor, s.high * factor
        both = low < -0.2 and high > 0.2 and min(-low, high) > BOTH_SIGNS * max(-low, high)  # not the noise of rests
        score += 1.0 * both + 0.5 * (s.distinct >= 20)
        if both:
            why.append("has both signs")
        if pair is not None:
            why += _of_two(pair)
        found.append(Scored(s, factor, 0.0, float(score), why, unit, pair))
    return found


def _of_two(pair: BothWays) -> list[str]:
    """Say why two signals are the directions of one current."""
    why = [f"{pair.paths[0]} and {pair.paths[1]} are its two directions: they never flow at once"]
    if pair.confirmed is not None:
        falls, rises = (1e3 * r for r in pair.confirmed)
        why.append(
            f"their names do not say so, but the voltage falls with the first by {falls:.3g} mV/A and rises with the "
            f"second by {rises:.3g} mV/A"
        )
    return why


@dataclass(frozen=True, slots=True)
class Ohm:
    """Relation between the steps of a voltage and those of a current.

    Attributes
    ----------
    correlation : float
        Of the steps; negative if the voltage falls as the current rises.
    resistance : float
        −dV/dI, Ω.
    fine : bool
        The voltage changes by many steps of its resolution, so that the resistance is meaningful.
    """

    correlation: float
    resistance: float
    fine: bool = True


def ohm(current: Scored, voltage: Scored, edges: Floats) -> Ohm | None:
    """Regress the steps of the voltage on those of the current; None if the changes are too small."""
    I, V = (c.factor * c.series.on_grid(edges) + c.shift for c in (current, voltage))  # noqa: E741 — the field's
    dI, dV = np.diff(I), np.diff(V)
    both = np.isfinite(dI) & np.isfinite(dV)
    dI, dV = dI[both], dV[both]
    if len(dI) < 10:
        return None
    for d in (dI, dV):  # caused by flipped bits
        low, high = np.quantile(d, (0.01, 0.99))
        np.clip(d, 3 * min(low, 0), 3 * max(high, 0), out=d)
    if not dI.std() or not dV.std():
        return None
    r = float(np.corrcoef(dI, dV)[0, 1])
    fine = bool(np.nanmax(V) - np.nanmin(V) > FINE_STEPS * abs(voltage.factor) * voltage.series.step)
    return Ohm(r, float(-(dI @ dV) / (dI @ dI)), fine)


@dataclass(slots=True)
class Electrical:
    """Current and voltage of the pack together.

    Attributes
    ----------
    current, voltage : Scored or None
    sign : float
        +1 or −1, to make discharge positive.
    told : bool
        Whether the voltage determined the sign.
    lead : float
        By how much the score exceeds that of the best pair with any other current.
    ohm : Ohm or None
    score : float
        Of both signals, their relation included.
    cell_V : float
        Voltage of one cell, if the bus has no voltages of single cells.
    cells_of : str
        Which cells these are and why; empty if the bus sends the greatest or least cell voltage.
    chemistry_told : bool
    """

    current: Scored | None
    voltage: Scored | None
    sign: float = 1.0
    told: bool = False
    lead: float = 9.0
    ohm: Ohm | None = None
    score: float = 0.0
    cell_V: float = NOMINAL_V
    cells_of: str = ""
    chemistry_told: bool = False


def together(candidates: list[Scored], voltages: list[Scored], edges: Floats) -> Electrical:
    """Choose current and voltage by the score of each and by their relation."""
    if not candidates:
        return Electrical(None, voltages[0] if voltages else None)
    ranked: list[tuple[float, Scored, Scored | None, Ohm | None]] = []
    for c in candidates[:FEW]:
        ranked.append((c.score, c, None, None))
        for v in voltages[:FEW]:
            law = ohm(c, v, edges)
            gain = 0.0 if law is None else 4.0 * max(abs(law.correlation) - 0.15, 0.0)
            beside = SAME_MESSAGE * (c.series.info.message == v.series.info.message)
            ranked.append((c.score + v.score + gain + beside, c, v, law))
    with_voltage = [r for r in ranked if r[2] is not None] or ranked
    best = max(with_voltage, key=lambda r: r[0])
    others = [r[0] for r in with_voltage if r[1] is not best[1]]
    law = best[3]
    if law is None or abs(law.correlation) <= FALLS:  # another voltage of the pack may determine the sign better
        laws = [r[3] for r in with_voltage if r[1] is best[1] and r[3] is not None and _alike(r[2], best[2])]
        law = max(laws, key=lambda o: abs(o.correlation), default=None)
    told = law is not None and abs(law.correlation) > FALLS
    sign = -1.0 if told and law is not None and law.resistance < 0 else 1.0
    return Electrical(best[1], best[2], sign, told, best[0] - max(others, default=best[0] - 9.0), law, best[0])


def _alike(a: Scored | None, b: Scored | None) -> bool:
    """Whether two voltages may belong to one pack."""
    return a is not None and b is not None and 0.8 < a.middle / b.middle < 1.25
