"""Finds the temperatures of cells, coolant and surroundings: slow, plausible signals with such a name."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from bms_gateway.frames.signal_info import SignalInfo
from bms_gateway.setup.find_electrical import Scored
from bms_gateway.setup.groups import Member, alike
from bms_gateway.setup.signal_series import PARKED, Series
from bms_gateway.setup.signal_words import (
    AMBIENT,
    COOLANT,
    FLOW,
    INWARD,
    NOT_MEASURED,
    OTHER_THINGS,
    OUTWARD,
    PACK,
    SENSED,
    STATISTIC,
    TEMPERATURE,
    Unit,
    around,
    has,
    named,
    statistic,
    unit_of,
)  # fmt: skip

SURROUNDINGS: Final = "the temperature of the surroundings"
LIVES_C: Final = (-40.0, 95.0)
USUAL_C: Final = (-30.0, 70.0)
FINE_K: Final = 0.1
"""K: a channel with this resolution or a finer one that is constant while its neighbours change has no sensor."""
JUMPS_K: Final = 2.5
READINGS: Final = (
    (1.0, 0.0, "°C"),
    (1.0, -273.15, "K"),
    (0.1, 0.0, "0.1 °C"),
    (0.1, -273.15, "0.1 K"),
    (0.01, 0.0, "0.01 °C"),
    (1.0, -40.0, "°C + 40"),
    (5 / 9, -160 / 9, "°F"),
)
"""Usual factors and offsets of temperatures, the likeliest first."""
PLAIN: Final = ((1.0, 0.0), (1.0, -273.15), (5 / 9, -160 / 9))
HOT_C: Final = 75.0
"""Greatest median temperature of a cell in a log, °C."""
SURE_C: Final = 60.0
FEW_OUT_OF_ORDER: Final = 0.05
FAR_APART_K: Final = 12.0
"""Greatest change of the difference between two cells of a pack, if the difference returns to its usual value."""
AGREES_K: Final = 15.0
"""Greatest difference of two temperatures of one vehicle at the beginning of a log."""
ALONE: Final = tuple(w for w in SENSED if w != "tc")
"""Words that mean cells only in a numbered group: TC1 … TC8 are thermocouples, a single TC may be that of a board."""


@dataclass(slots=True)
class Surfaces:
    """A group of thermocouples.

    Attributes
    ----------
    members : list of Member
        The thermocouples that are used.
    refused : list of (Series, why)
    factor, shift : float
        °C = factor · x + shift.
    said : bool
        Whether names or units say that they are temperatures of cells.
    why : list of str
    statistic : str or None
    passed : list of (Series, why)
        Other groups that might be thermocouples.
    beside : dict of str to Series
        If a statistic of all cells is used: the other statistics of the same cells, by `max`, `min` or `mean`.
    """

    members: list[Member]
    refused: list[tuple[Series, str]]
    factor: float
    shift: float
    said: bool
    why: list[str]
    statistic: str | None = None
    passed: list[tuple[Series, str]] = field(default_factory=list)
    beside: dict[str, Series] = field(default_factory=dict)


def is_temperature(s: Series) -> bool:
    """Whether the unit or the name says that the signal is a temperature."""
    unit = unit_of(s.info.unit)
    if unit is not None:
        return unit.family == "temperature"
    return has(named(s.info), TEMPERATURE) or (has(around(s.info), TEMPERATURE) and has(named(s.info), SENSED))


def reading(s: Series, unit: Unit | None) -> tuple[float, float, str | None]:
    """Factor and shift to °C: by the unit if this gives plausible temperatures of cells, otherwise by the values.

    Returns
    -------
    factor, shift, sentence
        The sentence says that the DBC's scale contradicts the data; None if it does not.
    """
    stated = (unit.factor, unit.offset) if unit is not None else (1.0, 0.0)
    if USUAL_C[0] <= stated[0] * s.middle + stated[1] <= USUAL_C[1] + 25:
        return *stated, None
    for factor, shift, name in READINGS:
        if -10.0 <= factor * s.middle + shift <= 60.0:
            return (
                factor,
                shift,
                f"the DBC's scale contradicts the data: {f'{s.middle:g} {s.info.unit}'.strip()} is read as {name}",
            )
    return *stated, None


def readings_without_unit(s: Series, known_C: float | None) -> tuple[float, float, str | None, bool]:
    """Factor and shift to °C of values without a unit: °C, K or °F, by comparison with other temperatures of the log.

    Parameters
    ----------
    s : Series
    known_C : float or None, °C
        Another temperature with a stated unit, at the beginning of the log.

    Returns
    -------
    factor, shift, sentence, sure
        If two units are possible, the sentence names both.
    """
    whole = s.info.scale == 1.0  # the scale of the DBC has already placed the decimal point
    possible = []
    for factor, shift, name in READINGS:
        if (factor not in (1.0, 5 / 9) and not whole) or (shift == -40.0 and s.info.offset != 0.0):
            continue
        first, high = factor * float(s.x[0]) + shift, factor * s.high + shift
        if -10.0 <= factor * s.middle + shift <= HOT_C and first >= -25.0 and high <= LIVES_C[1]:
            possible.append((factor, shift, name, first))
    if not possible:
        return *reading(s, None), False
    if known_C is not None:
        possible.sort(key=lambda r: abs(r[3] - known_C))
    else:
        possible.sort(key=lambda r: (r[0], r[1]) not in PLAIN)
    factor, shift, name, first = possible[0]
    near = known_C is not None and abs(first - known_C) <= AGREES_K and first < SURE_C
    rivals = [r for r in possible[1:] if (r[0], r[1]) in PLAIN]
    if not near and rivals:
        other = rivals[0]
        text = f"no unit: begins at {first:.4g} °C if it is {name}, at {other[3]:.4g} °C if it is {other[2]}"
        return factor, shift, text, False
    if name != "°C":
        beside = f", beside {known_C:.4g} °C of another temperature" if known_C is not None else ""
        return factor, shift, f"no unit: read as {name}, so that it begins at {first:.4g} °C{beside}", near
    return factor, shift, None, near


def stated_begin(series: list[Series], but: set[str]) -> float | None:
    """Median of the first values, °C, of coolant, surroundings and other temperatures with a unit; None without any."""
    begins: list[float] = []
    others: list[float] = []
    for s in series:
        unit = unit_of(s.info.unit)
        if s.path in but or unit is None or unit.family != "temperature" or not len(s.x) or s.counts or s.x[0] == 0:
            continue
        if has(named(s.info), NOT_MEASURED):
            continue
        first = unit.factor * float(s.x[0]) + unit.offset
        if LIVES_C[0] < first < USUAL_C[1]:
            (begins if has(named(s.info), COOLANT, AMBIENT, SENSED) else others).append(first)
    chosen = begins or others
    return float(np.median(chosen)) if chosen else None


def surfaces(series: list[Series]) -> Surfaces | None:
    """Find the thermocouples of the cells: the best group, and the channels of it that have a sensor."""
    temperatures = [s for s in series if is_temperature(s) and not elsewhere(s)]
    best: tuple[float, list[Member]] | None = None
    groups: list[list[Member]] = []
    for group in alike(temperatures):
        # "…Max", "…Min" and "…Avg" are no cells; a group of them has no numbers in common
        plain = [m for m in group if statistic(m.series.info) is None]
        if not plain or (len(plain) == 1 and not has(named(plain[0].series.info), SENSED)):
            continue
        s = plain[0].series
        said = has(named(s.info), SENSED) or has(around(s.info), SENSED)
        living = np.mean([lives(m.series) for m in plain])
        score = 3.0 * said + 2.0 * np.log2(1 + len(plain)) + 3.0 * living + 1.0 * (unit_of(s.info.unit) is not None)
        score -= 2.0 * has(around(s.info), OTHER_THINGS)
        if living > 0.3 and len(plain) > 1 and said:
            groups.append(plain)
        if living > 0.3 and (best is None or score > best[0]):
            best = float(score), plain
    if best is None:
        return _one_for_all(temperatures, series)
    if len(best[1]) == 1 and _says_more(temperatures, best[1][0].series):
        several = _one_for_all(temperatures, series)
        if several is not None:
            return several
    found = _sound(best[1], series)
    for group in (g for g in groups if g is not best[1]):
        what = f"one of {len(group)} temperatures called alike; the {len(best[1])} of {best[1][0].series.path} and on "
        found.passed += [(m.series, f"{what}are likelier to be the cells'") for m in group]
    return found


def _says_more(temperatures: list[Series], single: Series) -> bool:
    """Whether the bus has, besides a single temperature of the battery, the greatest or the mean of the cells."""
    abbreviated = not has(named(single.info), PACK, ALONE)
    for s in temperatures:
        if statistic(s.info) not in ("max", "mean") or not lives(s) or s.constant:
            continue
        if abbreviated or (  # neither a limit nor the temperature of another component
            has(named(s.info), PACK, SENSED) and abs(_usual_C(s) - _usual_C(single)) < FAR_APART_K
        ):
            return True
    return False


def _usual_C(s: Series) -> float:
    factor, shift, _ = reading(s, unit_of(s.info.unit))
    return factor * s.middle + shift


def elsewhere(s: Series) -> bool:
    """Whether the name says that the temperature is not that of a cell."""
    mine = named(s.info)
    other = tuple(w for w in NOT_MEASURED if w not in STATISTIC)
    return has(mine, OTHER_THINGS, AMBIENT, other, OUTWARD) or has(mine, tuple(w for w in COOLANT if w != "in"))


def lives(s: Series) -> bool:
    """Whether the median is plausible for a cell."""
    factor, shift, _ = reading(s, unit_of(s.info.unit))
    return bool(LIVES_C[0] < factor * s.middle + shift < LIVES_C[1])


def _unit_by_data(group: list[Series], typical: Series, series: list[Series]) -> tuple[float, float, str | None, bool]:
    """Factor and shift to °C of a group, the reasons, and whether the unit is certain."""
    unit = unit_of(typical.info.unit)
    if unit is None:
        return readings_without_unit(typical, stated_begin(series, {s.path for s in group}))
    factor, shift, told = reading(typical, unit)
    return factor, shift, told, told is None


def _sound(group: list[Member], series: list[Series]) -> Surfaces:
    s = max(group, key=lambda m: m.series.distinct).series
    unit = unit_of(s.info.unit)
    middles = [m.series for m in group if lives(m.series)]
    if unit is not None:  # a channel without a sensor is no evidence for a scale
        middles = [x for x in middles if reading(x, unit)[2] is None] or middles
    typical = sorted(middles, key=lambda x: x.middle)[len(middles) // 2]
    factor, shift, told, clear = _unit_by_data([m.series for m in group], typical, series)
    why = [f"unit {s.info.unit}" if unit else "named as a temperature"]
    if told:
        why.append(told)
    moving = np.median([m.series.distinct for m in group])
    step = float(np.median([abs(factor) * m.series.step for m in group]))
    fine = 0.0 < step <= FINE_K and moving > 6
    kept, refused = [], []
    for m in group:
        reason = _no_sensor(m.series, factor, shift, fine)
        if reason is None:
            kept.append(m)
        else:
            refused.append((m.series, reason))
    said = has(named(s.info), SENSED) or has(around(s.info), SENSED)
    if len(group) > 1:
        why.append(f"one of {len(group)} called alike")
    if not kept:  # if all channels are odd, the log is the cause, and none of them is refused
        kept, refused = group, []
    called = unit is not None or any(len(w) > 2 for w in named(s.info) if w in TEMPERATURE)
    if len(group) == 1:
        why.append(
            "the only temperature of the battery: where its sensor sits is not known, and other cells may be hotter"
        )
    return Surfaces(kept, refused, factor, shift, said and called and clear, why)


def _no_sensor(s: Series, factor: float, shift: float, fine: bool) -> str | None:
    T = factor * s.x + shift
    if 2 * len(T) < s.seen:
        return f"mostly no measurement: {', '.join(f'{n} of {s.seen} {why}' for why, n in s.dropped.items())}"
    inside = (LIVES_C[0] < T) & (T < 150.0)
    if len(T) == 0 or inside.mean() < 0.5:
        shown = f"{T.min():.4g} to {T.max():.4g} °C" if len(T) else "nothing but sentinels"
        return f"no temperature of a cell: {shown}"
    if fine and s.mode_share > PARKED and len(T) > 20:
        return f"parked at {factor * s.x[0] + shift:.4g} °C while the others move"
    jumps = np.abs(np.diff(T[inside]))
    if len(jumps) > 10 and (jumps > JUMPS_K).mean() > 0.25:
        return f"jumps by over {JUMPS_K:g} K from sample to sample"
    return None


def _one_for_all(temperatures: list[Series], series: list[Series]) -> Surfaces | None:
    """Take a mean, greatest or least reading if the bus has no readings of single cells."""
    ranked: list[tuple[float, Series]] = []
    pool = temperatures or [
        s for s in series if is_temperature(s) and (statistic(s.info) or has(named(s.info), SENSED))
    ]
    for s in pool:
        kind = statistic(s.info)
        mine, its = named(s.info), around(s.info)
        if not lives(s) or has(mine, AMBIENT) or not (kind or has(mine, PACK, SENSED)):
            continue
        score = {"max": 3.0, "mean": 2.5, "min": 1.0, None: 2.0}[kind] + 2.0 * has(mine, PACK, ALONE)
        score += has(its, PACK, ALONE) - 3.0 * has(mine, OTHER_THINGS) + 1.0 * (s.info.mux == ())
        ranked.append((float(score), s))
    if not ranked:
        return None
    s = max(ranked, key=lambda r: r[0])[1]
    members = next(g for g in alike([r[1] for r in ranked]) if s.path in {m.series.path for m in g})
    members = [Member(m.series, 0, k, m.where, m.whole) for k, m in enumerate(members, 1)]
    unit = unit_of(s.info.unit)
    factor, shift, told, _ = _unit_by_data([m.series for m in members], s, series)
    kind = statistic(s.info)
    why = [f"unit {s.info.unit}" if unit else "named as a temperature"] + ([told] if told else [])
    what = {"max": "greatest", "min": "least", "mean": "mean", None: "only"}[kind]
    if len(members) > 1:
        why.append(
            f"the bus has no thermocouples of single cells; this is the {what} reading of one of {len(members)} "
            "modules: one cell of the model for each module"
        )
    else:
        why.append(f"the bus has no thermocouples of single cells; this is the {kind or 'one reading'} of the battery")
    found = Surfaces(members, [], factor, shift, False, why, kind)
    if kind is not None and len(members) == 1:
        beside = _beside(s, kind, [r[1] for r in ranked])
        wrong = _out_of_order({kind: s, **beside})
        if wrong is None:
            odd = {k: _never_of_cells(s, b, factor) for k, b in beside.items()}
            found.beside = {k: b for k, b in beside.items() if odd[k] is None}
            found.passed = [(b, text) for k, b in beside.items() if (text := odd[k]) is not None]
            found.said = len(found.beside) > 0 and unit is not None and told is None
        else:
            why.append(wrong)
    return found


def _beside(s: Series, kind: str, others: list[Series]) -> dict[str, Series]:
    """Find the other statistics of the same cells: their names differ only in the word for the statistic."""

    def rest(info: SignalInfo) -> tuple[str, ...]:
        return tuple(w for w in named(info) if w not in STATISTIC)

    found: dict[str, Series] = {}
    for other in sorted(others, key=lambda o: o.info.message != s.info.message):
        its = statistic(other.info)
        if its is not None and its != kind and rest(other.info) == rest(s.info) and other.info.unit == s.info.unit:
            found.setdefault(its, other)
    return found


def _never_of_cells(s: Series, beside: Series, factor: float) -> str | None:
    """Report samples at which two statistics differ by more than cells can; None if there are no such samples."""
    apart = np.abs(factor * (np.interp(beside.t, s.t, s.x) - beside.x))
    usual = float(np.median(apart))
    far = int((apart > usual + FAR_APART_K).sum())
    if not far:
        return None
    return f"{far} of {len(apart)} samples are over {usual + FAR_APART_K:.0f} K from {s.path}, the others {usual:.2g} K"


def _out_of_order(by_kind: dict[str, Series]) -> str | None:
    """Name the readings that contradict max >= mean >= min in more than a few samples; None if none do."""
    order = [k for k in ("max", "mean", "min") if k in by_kind]
    for upper, lower in pairwise(order):
        a, b = by_kind[upper], by_kind[lower]
        above = np.interp(b.t, a.t, a.x)
        if (above < b.x - a.step - b.step).mean() > FEW_OUT_OF_ORDER:
            return f"{b.path} is called the {lower} and is above {a.path}, called the {upper}: only {a.path} is used"
    return None


def inlets(series: list[Series], taken: set[str]) -> list[Scored]:
    """Rank the signals that may be the coolant inlet, or the air around the cells."""
    found = []
    for s in series:
        mine, its = named(s.info), around(s.info)
        if s.path in taken or not is_temperature(s):
            continue
        unit = unit_of(s.info.unit)
        factor, shift, told = reading(s, unit)
        coolant, ambient = has(mine, COOLANT), has(mine, AMBIENT)
        lives = -38.0 < factor * s.middle + shift < 75.0
        elsewhere = has(mine, tuple(w for w in OTHER_THINGS if w not in COOLANT)) or has(mine, OUTWARD)
        if not (coolant or ambient) or not lives or elsewhere:
            continue
        of_pack = has((*mine, *its), tuple(w for w in PACK if w != "dc"))
        liquid = has((*mine, *its), tuple(w for w in COOLANT if w not in INWARD))
        if coolant and not (liquid or ambient or of_pack) and has(its, OTHER_THINGS):
            continue  # the inlet of a charging plug, of an engine
        score = (3.0 if liquid or of_pack else 1.5) * coolant + 1.0 * ambient + 1.5 * has(mine, INWARD)
        score += 1.0 * of_pack - (2.0 if coolant else 0.5) * has(its, OTHER_THINGS) + 1.0 * (unit is not None)
        score -= 3.0 * has(mine, tuple(w for w in NOT_MEASURED if w not in STATISTIC))
        what = "named as the coolant" if coolant else SURROUNDINGS
        why = [f"unit {s.info.unit}" if unit else "no unit", what, *([told] if told else [])]
        found.append(Scored(s, factor, shift, float(score), why, unit))
    return sorted(found, key=lambda c: -c.score)


def inlet_of_each(ranked: list[Scored], members: list[Member]) -> dict[int, Scored]:
    """Find the inlet of each part of the thermocouples, if the likeliest inlets have the numbers of the parts."""
    parts = {m.where: m.part for m in members}
    by_path = {c.series.path: c for c in ranked}
    for group in alike([c.series for c in ranked]) if len(parts) > 1 else []:
        likeliest = ranked[0].series.path in {m.series.path for m in group}
        if likeliest and sorted(m.whole for m in group) == sorted(parts):
            return {parts[m.whole]: by_path[m.series.path] for m in group}
    return {}


def flows(series: list[Series]) -> list[Scored]:
    """Rank the signals that may be the coolant flow."""
    found = []
    for s in series:
        unit, mine = unit_of(s.info.unit), named(s.info)
        if unit is None or unit.family != "flow" or not s.x.size or s.high <= 0:
            continue
        score = 2.0 + 1.0 * has(mine, FLOW, COOLANT) - 3.0 * has(mine, NOT_MEASURED)
        found.append(Scored(s, unit.factor, 0.0, float(score), [f"unit {s.info.unit}"], unit))
    return sorted(found, key=lambda c: -c.score)
