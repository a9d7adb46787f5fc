"""Checks a current against voltage and SOC of a pack: whether it is the pack's current, and whether it has an offset.

The current of a pack changes its voltage at once, with the same resistance at each step: V = OCV − R·I. Its integral
changes the SOC. So four tests show a current that is not the pack's, or a current with an offset:

* **Steps.** The voltage steps, and the current does not explain these steps: they do not correlate with its own,
  neither at one second nor as means of two to ten, nor with a delay. Or the voltage often steps in the wrong direction,
  as it does if the signal is the magnitude of a current.
* **Level.** Under a current of one sign the voltage stays on one side of its level at rest. If the voltage is on both
  sides, the signal is a magnitude: it does not distinguish charge from discharge.
* **SOC.** The SOC changes, but not by the integral of the current. If the SOC follows the integral of the current minus
  a constant, this constant is the offset: the current at which the SOC is constant.
* **Alternation.** Large values alternate in sign from sample to sample: the current of a motor phase.

If the steps agree with the voltage, and the SOC does not follow the current, the SOC is taken to be wrong: the SOC that
a vehicle shows is often not that of the pack.
"""

from dataclasses import dataclass
from math import isnan, nan
from typing import Final

import numpy as np

from bms_gateway.frames.ammeter import MOVED, MOVED_STEPS, UNUSUAL
from bms_gateway.thermal import Floats

BLOCKS: Final = ((1, 5), (2, 2), (5, 1), (10, 0))
"""Numbers of intervals that are averaged, and the longest delay, in intervals: current and voltage may be filtered
differently."""
ON: Final = 0.3
"""Share of the greatest voltage, below which the contactors are open."""
LEAST_MOVES: Final = 20
"""Least number of steps of the voltage for a conclusion."""
EXPLAINED, CLEAR = 0.9, 0.95
"""Correlation of the steps above which the current is their cause; above the second number regardless of all other
evidence."""
WRONG_WAY: Final = 0.035
"""Share of the voltage's steps in the wrong direction, weighted by size, above which the current is not their cause."""
ONE_SIDED, REST, LOAD = 0.02, 0.05, 0.2
"""Shares of the greatest current: below the first it has no second sign, below the second it rests, above the third it
loads."""
NEAR_REST: Final = 60
"""Distance to a rest, in intervals, within which the level at rest is known."""
BOTH_SIDES: Final = 0.1
"""Share of the time under load with the voltage on the other side of its level, above which the current is a
magnitude."""
SWAPS: Final = 8
"""Least number of changes of the side: a drifting voltage changes it once."""
PARTLY: Final = 0.3
"""Correlation below which the current is not the cause of the steps. In between, current and voltage may be sampled at
different times."""
SWING: Final = 0.05
"""Least change of the SOC for a conclusion."""
FULL_SWING: Final = 0.1
"""Least change of the SOC for an estimate of the capacity."""
GAP_S, UNSEEN = 10.0, 0.02
"""Time for which a sample of the current is held, or five usual gaps if these are longer; and the greatest share of the
log without a valid current."""
FOLLOWS: Final = 0.1
"""Greatest rms error of the SOC by the current's integral, relative to the rms of the SOC, if the SOC follows."""
STRAYS: Final = 0.3
"""The same ratio, above which the SOC does not follow."""
BETTER: Final = 0.5
"""Ratio of the error of a fit to that of a simpler one, below which the simpler one is refuted."""
OFFSET: Final = 0.2
"""Least offset that is reported, relative to the rms of the current without it: greater than the effect of corrections
of an SOC."""
LEAST_A: Final = 2.0
"""Least offset, and least alternating current: smaller ones may be noise."""
TREND: Final = 9
"""Number of intervals whose median step is the trend, for example near the end of discharge."""
LARGE, FLIPS, MOST_APART_S = 0.2, 0.3, 1.5
"""Share of the greatest current from which on a value is large; share of neighbours with opposite signs, no more than
so many seconds apart, in a current that alternates."""
MAGNITUDE: Final = (
    "the pack's voltage goes above its level at rest and below it, and this current never changes its sign: it is a "
    "magnitude, and does not tell charge from discharge"
)
ALTERNATES: Final = "large values follow each other with opposite signs, as in a phase of a motor"


@dataclass(frozen=True, slots=True)
class Witness:
    """Result of the checks of a current.

    Attributes
    ----------
    against : tuple of str
        Sentences that begin with the contradiction; empty if there is none.
    compared, supported : bool
        Whether the voltage changes enough for a conclusion; whether its steps are those of this current.
    zero : bool
        Whether the SOC follows its integral, which shows that it has no offset.
    offset_A : float or None
        Offset to subtract from the current, if the SOC shows it.
    capacity_Ah : float or None
        Integral of the current divided by the change of the SOC, if they agree over a change of a tenth or more; for
        either sign of the current.
    """

    against: tuple[str, ...] = ()
    compared: bool = False
    supported: bool = False
    zero: bool = False
    offset_A: float | None = None
    capacity_Ah: float | None = None


def witness(I: Floats, V: Floats, soc: Floats, step_s: float = 1.0, resolution_V: float = 0.0) -> Witness:  # noqa: E741
    """Check a current against voltage and SOC of the same pack.

    Parameters
    ----------
    I, V, soc : ndarray (n,)
        Means over intervals of equal length, A, V, 0…1; NaN where unknown. The current may have either sign.
    step_s : float
        Length of an interval.
    resolution_V : float
        Smallest step of the voltage.
    """
    by_steps = _steps(I, V, resolution_V)
    supported = by_steps is not None and by_steps.explain
    offset, follows, strays = _charge(I, soc, step_s)
    against = []
    if not supported and alternates(np.arange(len(I), dtype=np.float64) * step_s, I):
        against.append(ALTERNATES)
    if by_steps is not None and by_steps.refute:
        against.append(by_steps.told())
    elif by_steps is not None and not supported and _is_magnitude(I, V, resolution_V):
        against.append(MAGNITUDE)
    if offset is not None:
        against.append(
            f"the SOC is constant at {offset:.4g} A of this current: the current has this offset; add {-offset:.4g} "
            "to the offset of its entry"
        )
    elif strays and not supported:
        against.append("the SOC moves, and does not follow its integral")
    return Witness(
        tuple(against), by_steps is not None, supported, follows, offset, _capacity(I, soc, step_s) if follows else None
    )


@dataclass(frozen=True, slots=True)
class _Steps:
    """Best agreement of the steps: correlation, share of the wrong direction (by size), number of steps."""

    correlation: float
    wrong: float
    moves: int

    @property
    def explain(self) -> bool:
        return self.correlation > CLEAR or (self.correlation > EXPLAINED and self.wrong < WRONG_WAY)

    @property
    def refute(self) -> bool:
        return self.correlation < PARTLY or (self.correlation < CLEAR and self.wrong >= WRONG_WAY)

    def told(self) -> str:
        if self.correlation < PARTLY:
            return (
                f"the pack's voltage changes without it: {self.moves} steps of the voltage, correlation with its steps "
                f"{self.correlation:.2f}"
            )
        return (
            f"the steps of the pack's voltage fit one resistance only in part: correlation with its steps "
            f"{self.correlation:.2f}, {100 * self.wrong:.0f} % of the steps have the wrong direction"
        )


def _steps(I: Floats, V: Floats, resolution: float) -> _Steps | None:  # noqa: E741
    """Compare the steps of current and voltage; None if the voltage does not change enough."""
    usual = usual_voltage(V)
    if isnan(usual):
        return None
    V = np.where(np.abs(V / usual - 1.0) < UNUSUAL, V, np.nan)
    best = None
    for block, delay in BLOCKS:
        Ib, Vb = _means(I, block), _means(V, block)
        for lag in range(-delay, delay + 1):
            found = _compared(_moved(Ib, lag), Vb, max(MOVED * usual, MOVED_STEPS * resolution))
            if found is not None and (best is None or found.correlation - found.wrong > best.correlation - best.wrong):
                best = found
    return best


def usual_voltage(V: Floats) -> float:
    """Median of the voltages (n,) with closed contactors, V; NaN if there are none."""
    known = V[np.isfinite(V)]
    on = known[known > ON * known.max()] if len(known) and known.max() > 0 else known
    return float(np.median(on)) if len(on) else nan


def _is_magnitude(I: Floats, V: Floats, resolution: float) -> bool:  # noqa: E741
    """Whether the voltage is on both sides of its level at rest under a current of one sign."""
    known = np.isfinite(I) & np.isfinite(V)
    if not known.any():
        return False
    greatest = float(np.quantile(np.abs(I[known]), 0.98))
    low, high = np.quantile(I[known], (0.02, 0.98))
    rests = np.flatnonzero(known & (np.abs(I) < REST * greatest))
    if min(-low, high) > ONE_SIDED * greatest or len(rests) < LEAST_MOVES:
        return False
    k = np.arange(len(I))
    at = np.searchsorted(rests, k)
    near = np.minimum(np.abs(k - rests[np.minimum(at, len(rests) - 1)]), np.abs(k - rests[np.maximum(at - 1, 0)]))
    above = V - np.interp(k, rests, V[rests])
    least_V = max(MOVED * float(np.median(V[known])), MOVED_STEPS * resolution)
    loads = known & (np.abs(I) > LOAD * greatest) & (near <= NEAR_REST) & (np.abs(above) > least_V)
    up = above[loads] > 0
    if len(up) < LEAST_MOVES or np.count_nonzero(np.diff(up)) < SWAPS:
        return False
    return min(float(up.mean()), 1.0 - float(up.mean())) > BOTH_SIDES


def _compared(I: Floats, V: Floats, least_V: float) -> _Steps | None:  # noqa: E741
    dI, dV = np.diff(I), np.diff(V)
    both = np.isfinite(dI) & np.isfinite(dV)
    dI, dV = _less_trend(dI[both]), _less_trend(dV[both])
    moves = np.abs(dV) > least_V
    if moves.sum() < LEAST_MOVES:
        return None
    at = moves | (np.abs(dI) >= max(float(np.median(np.abs(dI[moves]))), 1e-9))
    product = dI[at] * dV[at]
    both_move = float(np.abs(product).sum())
    if both_move == 0.0:
        return _Steps(0.0, 0.5, int(moves.sum()))
    r = float(product.sum()) / float(np.sqrt((dI[at] ** 2).sum() * (dV[at] ** 2).sum()))
    wrong = float(np.abs(product[product * r < 0]).sum()) / both_move
    return _Steps(abs(r), wrong, int(moves.sum()))


def _less_trend(x: Floats) -> Floats:
    if len(x) < TREND:
        return x
    rows = np.lib.stride_tricks.sliding_window_view(np.pad(x, TREND // 2, mode="edge"), TREND)
    return np.asarray(x - np.median(rows, axis=1))


def _means(x: Floats, block: int) -> Floats:
    """Means over groups of neighbours; NaN if less than half of a group is known."""
    if block == 1:
        return x
    rows = x[: len(x) // block * block].reshape(-1, block)
    known = np.isfinite(rows)
    n = known.sum(axis=1)
    total = np.where(known, rows, 0.0).sum(axis=1)
    return np.where(2 * n >= block, total / np.maximum(n, 1), np.nan)


def _moved(x: Floats, by: int) -> Floats:
    if by == 0:
        return x
    y = np.full(len(x), np.nan)
    if by > 0:
        y[by:] = x[:-by]
    else:
        y[:by] = x[-by:]
    return y


def _charge(I: Floats, soc: Floats, step_s: float) -> tuple[float | None, bool, bool]:  # noqa: E741
    """Find the offset of the current, whether the SOC follows without one, and whether it follows in no way."""
    both = np.isfinite(soc) & np.isfinite(I)
    if both.sum() < 30 or np.ptp(soc[both]) < SWING:
        return None, False, False
    t = np.arange(len(I), dtype=np.float64) * step_s
    drawn = _drawn_at(t, I)
    if drawn is None:
        return None, False, False
    S = soc[both]
    spread = float(S.std())
    one = np.ones(len(S))
    _, own = _fitted(np.stack([one, drawn[both]], 1), S)
    more, shifted = _fitted(np.stack([one, drawn[both], t[both]], 1), S)
    _, timed = _fitted(np.stack([one, t[both]], 1), S)
    follows, strays = own <= FOLLOWS * spread and own < BETTER * timed, own > STRAYS * spread
    if shifted > FOLLOWS * spread or shifted > BETTER * timed or more[1] == 0.0:
        return None, follows, strays
    offset = float(-3600.0 * more[2] / more[1])
    size = float(np.sqrt(np.mean((I[both] - offset) ** 2)))
    if abs(offset) > max(OFFSET * size, LEAST_A) and shifted < BETTER * own:
        return offset, False, False
    return None, follows, strays


def _capacity(I: Floats, soc: Floats, step_s: float) -> float | None:  # noqa: E741
    both = np.isfinite(soc) & np.isfinite(I)
    drawn = _drawn_at(np.arange(len(I), dtype=np.float64) * step_s, I)
    if drawn is None or np.ptp(soc[both]) < FULL_SWING:
        return None
    return abs(float(1.0 / np.polyfit(drawn[both], soc[both], 1)[0]))


def _drawn_at(t: Floats, I: Floats) -> Floats | None:  # noqa: E741
    """Charge (n,), Ah, at the beginning t (n,), s, of each interval; the mean I (n,) is NaN without samples."""
    known = np.isfinite(I)
    drawn = drawn_Ah(t[known], I[known])
    return None if drawn is None else np.interp(t, t[known], drawn)


def drawn_Ah(t: Floats, I: Floats) -> Floats | None:  # noqa: E741
    """Integral of a current, Ah (n,); None if the current is missing for a part of the time.

    Each sample is held until the next one.

    Parameters
    ----------
    t, I : ndarray (n,), s, A
    """
    if len(t) < 2:
        return None
    gaps = np.diff(t)
    held = max(GAP_S, 5.0 * float(np.median(gaps)))
    if float(np.maximum(gaps - held, 0.0).sum()) > UNSEEN * float(t[-1] - t[0]):
        return None
    return np.concatenate([[0.0], np.cumsum(I[:-1] * gaps)]) / 3600.0


def _fitted(A: Floats, y: Floats) -> tuple[Floats, float]:
    scale = np.maximum(np.abs(A).max(axis=0), 1e-300)
    b = np.linalg.lstsq(A / scale, y, rcond=None)[0] / scale
    return b, float((y - A @ b).std())


def alternates(t: Floats, I: Floats) -> bool:  # noqa: E741
    """Whether a current alternates in sign from sample to sample, as that of a motor phase.

    Parameters
    ----------
    t, I : ndarray (n,), s, A
    """
    known = np.isfinite(I)
    t, I = t[known], I[known]  # noqa: E741
    if len(I) < LEAST_MOVES:
        return False
    greatest = float(np.quantile(np.abs(I), 0.98))
    if greatest < LEAST_A:
        return False
    large = np.abs(I) > LARGE * greatest
    pairs = large[1:] & large[:-1] & (np.diff(t) < MOST_APART_S)
    flips = pairs & (I[1:] * I[:-1] < 0)
    return bool(pairs.sum() >= LEAST_MOVES and flips.sum() > FLIPS * pairs.sum())
