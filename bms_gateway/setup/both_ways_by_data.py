"""Finds the two directions of a current by the data alone, where the names do not tell them.

Both signals have one sign and never flow at once. The pack's voltage falls when one of them flows and rises when the
other flows, and both show the same resistance. The first is the discharge.
"""

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import Final

import numpy as np

from bms_gateway.setup.find_both_ways import SMALL, BothWays, joined, one_sign
from bms_gateway.setup.signal_series import Series
from bms_gateway.setup.signal_words import (
    CHARGING,
    CURRENT,
    NOT_MEASURED,
    OTHER_THINGS,
    PACK,
    STATISTIC,
    VOLTAGE,
    has,
    named,
    unit_of,
)
from bms_gateway.thermal import Floats

FEWEST: Final = 8
"""Least number of different values of each direction: it flows in this log."""
FLOWS: Final = 0.01
"""Least share of the samples in which each direction flows."""
ALIKE: Final = 1.7
"""Greatest ratio of the resistances that the two directions show."""
EXPLAINS: Final = 0.3
"""Least share of the variance of the voltage's steps that the two explain together."""
STEP_S: Final = 1.0


def apart(series: Iterable[Series], taken: set[str]) -> list[tuple[Series, Series]]:
    """List currents of one sign each that flow at different times; those in `taken` are left out."""
    found = [s for s in series if s.path not in taken and _may_be_half(s)]
    return [(a, b) for a, b in combinations(found, 2) if _in_turns(joined(a, b, (one_sign(a), one_sign(b))))]


def _in_turns(pair: BothWays | None) -> bool:
    """Whether both flow, and never at once: one that is small beside the other does not count as a direction."""
    if pair is None:
        return False
    x = pair.net.x
    least = SMALL * float(np.abs(x).max())
    return bool(min((x > least).mean(), (x < -least).mean()) > FLOWS)


def by_data(pairs: Iterable[tuple[Series, Series]], series: list[Series]) -> list[BothWays]:
    """Find the pairs that the voltage of the pack confirms.

    A signal that fits several others belongs to the one of its own message; if there is none, it is not paired.
    """
    voltages = [s for s in series if _is_voltage(s)]
    found = [pair for a, b in pairs if (pair := _confirmed(a, b, voltages)) is not None]
    return [
        p for p in found if not any(q is not p and set(q.paths) & set(p.paths) and not _nearer(p, q) for q in found)
    ]


def _nearer(p: BothWays, q: BothWays) -> bool:
    """Whether the signals of the first pair are of one message, and those of the second are not."""
    mine, other = (x.discharge.info.message == x.charge.info.message for x in (p, q))
    return mine and not other


def _may_be_half(s: Series) -> bool:
    unit, mine = unit_of(s.info.unit), tuple(w for w in named(s.info) if w not in CHARGING)
    if not (unit.family == "current" if unit is not None else has(mine, CURRENT)) or s.info.choices:
        return False
    if has(mine, NOT_MEASURED, tuple(STATISTIC), OTHER_THINGS):
        return False
    return s.distinct >= FEWEST and one_sign(s) != 0.0


def _is_voltage(s: Series) -> bool:
    unit = unit_of(s.info.unit)
    said = unit.family == "voltage" if unit is not None else has(named(s.info), VOLTAGE, PACK)
    return said and s.distinct >= FEWEST and not has(named(s.info), NOT_MEASURED, tuple(STATISTIC))


def _confirmed(a: Series, b: Series, voltages: list[Series]) -> BothWays | None:
    """Join two currents if one voltage falls with one of them and rises with the other, by the same resistance."""
    signs = one_sign(a), one_sign(b)
    for slopes in _slopes(a, b, signs, voltages):
        sizes = sorted(abs(r) for r in slopes)
        if slopes[0] * slopes[1] < 0.0 and sizes[1] < ALIKE * sizes[0]:
            out, into = (a, b) if slopes[0] < 0.0 else (b, a)
            pair = joined(out, into, (one_sign(out), one_sign(into)))
            if pair is not None:
                pair.confirmed = (abs(slopes[0]), abs(slopes[1])) if out is a else (abs(slopes[1]), abs(slopes[0]))
            return pair
    return None


def _slopes(a: Series, b: Series, signs: tuple[float, float], voltages: list[Series]) -> Iterator[tuple[float, float]]:
    """Yield the change of each voltage by one ampere of both flows, from their steps, where they explain it."""
    factors = [unit.factor if (unit := unit_of(s.info.unit)) is not None else 1.0 for s in (a, b)]
    for v in voltages:
        edges = np.arange(max(a.t[0], b.t[0], v.t[0]), min(a.t[-1], b.t[-1], v.t[-1]), STEP_S)
        if len(edges) < 2 * FEWEST:
            continue
        flows = [sign * f * s.on_grid(edges) for s, sign, f in zip((a, b), signs, factors, strict=True)]
        steps: Floats = np.diff(np.column_stack([*flows, v.on_grid(edges)]), axis=0)
        steps = steps[np.isfinite(steps).all(axis=1)]
        if len(steps) < FEWEST or not steps.std(axis=0).all():
            continue
        r = np.linalg.lstsq(steps[:, :2], steps[:, 2], rcond=None)[0]
        left = steps[:, 2] - steps[:, :2] @ r
        if left.var() < (1.0 - EXPLAINS) * steps[:, 2].var() and r.all():
            yield float(r[0]), float(r[1])
