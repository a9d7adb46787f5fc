"""Finds currents that two signals carry, one for each direction, and joins their series.

The names of the two differ by the words for charge and discharge only, and the data agree: each has one sign, and the
two never flow at the same time. Limits for charge and discharge have such names too, but both are above zero at once.
Pairs without such names are found in `both_ways_by_data`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from bms_gateway.setup.signal_series import Series, described
from bms_gateway.setup.signal_words import (
    CHARGING,
    CURRENT,
    DISCHARGE,
    NOT_MEASURED,
    STATISTIC,
    around,
    has,
    named,
    unit_of,
)
from bms_gateway.thermal import Floats

SMALL: Final = 0.02
"""Share of the greatest value of both signals below which a value counts as none."""
AT_ONCE: Final = 0.05
"""Greatest share of the samples with a current in which both signals have one: while they change over, or by noise."""
ONE_SIGN: Final = (0.01, 0.99)
"""Quantiles of a signal that must have one sign."""

Words = tuple[str, ...]


@dataclass(slots=True)
class BothWays:
    """A current of two signals.

    Attributes
    ----------
    discharge, charge : Series
        By their names.
    net : Series
        Discharge minus charge, in the unit of `discharge`; its `info` is that of `discharge`.
    out, into : float
        Net = out · discharge + into · charge, in the units of the DBC.
    confirmed : (float, float) or None
        Of a pair that the data alone show: the resistance by which the voltage falls with the discharge, and that by
        which it rises with the charge. None for a pair by its names.
    """

    discharge: Series
    charge: Series
    net: Series
    out: float
    into: float
    confirmed: tuple[float, float] | None = None

    @property
    def paths(self) -> tuple[str, str]:
        """Names of both signals."""
        return self.discharge.path, self.charge.path


def both_ways(series: Iterable[Series]) -> tuple[list[BothWays], set[str]]:
    """Find pairs of signals that are the two directions of one current.

    Returns
    -------
    list of BothWays
    set of str
        Paths of pairs that are called so and are no current, because both have a value at once: limits.
    """
    pairs, limits = [], set()
    for out, into in _called_so(series):
        if 0.0 in (signs := (one_sign(out), one_sign(into))):
            continue
        if (pair := joined(out, into, signs)) is not None:
            pairs.append(pair)
        else:
            limits |= {out.path, into.path}
    return pairs, limits


def _called_so(series: Iterable[Series]) -> Iterator[tuple[Series, Series]]:
    """Pair the currents whose names differ by the words of the direction only; the messages decide among several."""
    called: dict[Words, dict[str, list[tuple[Series, Words]]]] = {}
    for s in series:
        unit, mine, its = unit_of(s.info.unit), named(s.info), around(s.info)
        if not (unit.family == "current" if unit is not None else has(mine, CURRENT)) or s.info.choices:
            continue
        if has(mine, NOT_MEASURED, tuple(STATISTIC)):
            continue
        way = _way(mine) or _way(its)
        if way is not None:
            mine, its = (tuple(w for w in x if w not in DISCHARGE and w not in CHARGING) for x in (mine, its))
            called.setdefault(mine, {}).setdefault(way, []).append((s, its))
    for group in called.values():
        out, into = group.get("discharge", []), group.get("charge", [])
        if len(out) == len(into) == 1:
            yield out[0][0], into[0][0]
            continue
        for s, its in out:
            others = [x for x, message in into if message == its]
            if len(others) == 1 and sum(message == its for _, message in out) == 1:
                yield s, others[0]


def _way(given: Words) -> str | None:
    out, into = has(given, DISCHARGE), has(given, CHARGING)
    return None if out == into else "discharge" if out else "charge"


def joined(discharge: Series, charge: Series, signs: tuple[float, float]) -> BothWays | None:
    """Join two series if they never flow at once; None otherwise."""
    factors = [unit.factor if (unit := unit_of(s.info.unit)) is not None else 1.0 for s in (discharge, charge)]
    t = np.union1d(discharge.t, charge.t)
    t = t[t >= max(discharge.t[0], charge.t[0])]
    out, into = signs[0], -signs[1] * factors[1] / factors[0]
    flow_out, flow_in = out * _held(discharge, t), -into * _held(charge, t)
    most = max(float(flow_out.max(initial=0.0)), float(flow_in.max(initial=0.0)))
    least = max(SMALL * most, 2.0 * abs(discharge.info.scale), 2.0 * abs(into * charge.info.scale))
    flows = (flow_out > least) | (flow_in > least)
    if ((flow_out > least) & (flow_in > least)).sum() > AT_ONCE * flows.sum():
        return None
    net = described(Series(discharge.info, t, flow_out - flow_in, max(discharge.seen, charge.seen)))
    net.step = discharge.step if charge.constant else max(discharge.step, abs(into) * charge.step)
    return BothWays(discharge, charge, net, out, into)


def one_sign(s: Series) -> float:
    """Return the sign of a series; 0 if it has both."""
    low, high = (float(x) for x in np.quantile(s.x, ONE_SIGN))
    small = SMALL * max(-low, high) + 2.0 * abs(s.info.scale)
    return 1.0 if low >= -small else -1.0 if high <= small else 0.0


def _held(s: Series, t: Floats) -> Floats:
    """Return the newest value at each time; each time is at or after the first sample."""
    return np.asarray(s.x[np.searchsorted(s.t, t, side="right") - 1])
