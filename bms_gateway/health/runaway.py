"""Thermal runaway, found in the raw readings: the guard refuses jumps that no healthy cell makes, a runaway among them.

By GB 38031-2025, C.5.3.7, a cell is in thermal runaway if its temperature rises by 1 °C/s for more than 3 s, and if it
is above its maximum working temperature or its voltage has dropped by more than a quarter. The reading of a failing
sensor can rise in the same way. The rule here therefore has two parts.

*The rise*: for `RISES_S`, each reading rises by `EACH_K_S` or more and the mean rate is 1 K/s or more, above `HOT_C`.

*Proof that the cell and not the sensor rises*, one of:

* The cell was hot and its readings were quiet before, and its rate grows: over five intervals of 4 s the rate
  increases, and the increase does not slow down. Self-heating grows with the temperature at least exponentially. A
  broken wire makes a kink within one interval; behind a filter, its rate falls; the rate of a drift grows ever less.
  Or the cell has risen by `SURE_K_S` or more, at `SURE_C` or more, for long: then the rise need not be smooth.
* Another thermocouple of the string follows: it rises by 1 K more than before; by clearly less than the cell itself (an
  equal rise shows a common fault); and later (an equal rise at the same time shows crosstalk).
* The cell's voltage has dropped by more than a quarter, and clearly more than the other voltages of its string: a load
  lowers all of them. The other cells must not rise as fast. Where there are no other cells, the current must not have
  increased.
* The cell rises at 1 K/s or more through temperatures above the limit of every usual converter.

`ANEW_S` after an impossible value the history of a sensor starts again: an invalid value, a fall of more than 3 K/s, or
a step of more than 20 K from below 100 °C. A runaway stays until a person acknowledges it.
"""

from collections.abc import Iterator, Sequence
from math import ceil
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.health.alerts import Condition, Severity
from bms_gateway.thermal import Floats

Bools = NDArray[np.bool_]

HOT_C: Final = 60.0  # the highest discharge temperature in most data sheets of lithium-ion cells
RISES_S: Final = 4.0  # GB 38031-2025, C.5.3.7: more than 3 s
EACH_K_S: Final = 0.5  # least rate in one second: 1 K/s less noise
MEAN_K_S: Final = 1.0  # GB 38031-2025, C.5.3.7
BEFORE_S: Final = (10.0, 24.0)  # ago: the time before the runaway
BEFORE_C: Final = 80.0  # self-heating begins: the SEI decomposes from 80 to 90 °C on
QUIET_K: Final = 0.6  # sd of the differences of readings: ten times the noise of a sound sensor
SLOWER: Final = 0.6  # largest ratio of the rate in the time before to the present rate
INTERVAL_S: Final = 4.0
INTERVALS: Final = 5
GROWS: Final = np.array([1.15, 1.1, 1.05, 0.9])  # least ratio of the rate to that of the interval before, newest first
FASTER: Final = 0.8  # least ratio of two such ratios in a row: 0.05 K of noise change them by a tenth
TURNS: Final = 0.5  # largest change of the rate between two readings, as a share of the present rate,
TURNS_K_S: Final = 0.2  # with so much added for noise
STEEPEST: Final = 0.2  # 1/K: no reaction of a cell doubles its heat within less than 3.5 K
STEEP_LN: Final = 0.3  # ln: added to this bound for the noise of a ratio of rates
LEAPS: Final = 4.0  # largest ratio of two rates in a row: an e-folding time of 3 s
LASTS: Final = 0.9  # least ratio of the second newest of `GROWS` to the oldest: a drift stays below
ALONE_C: Final = 100.0  # no cell heats itself by 1 K/s below this
SURE_S: Final = (12.0, 60.0)  # ago
SURE_K_S: Final = 0.4  # at 100 °C or more no cooling stops such a cell any more, whatever its sensor reads later
SURE_C: Final = 100.0
FOLLOWS_K: Final = 1.0  # within 10 s, beyond the rise in the 10 s before
FOLLOWS_S: Final = 10.0
FOLLOWS_MOST: Final = 0.7  # largest rise of a follower, as a share of the cell's own rise
ROUGH_K: Final = 1.0  # second difference of readings: far above noise, far below that of a loose contact
LATER: Final = 0.35  # largest share of its rise that a follower has reached when the cell itself has reached half
DROP: Final = 0.25  # GB 38031-2025, C.5.3.7
ALIVE_V: Final = 2.0  # an empty lithium-ion cell; a cell below this voltage cannot drop by a quarter any more
HINT_K_S: Final = 0.5  # the onset of a runaway is sought above this rate,
HINT_S: Final = 15.0  # and is remembered for so long
HEARD_S: Final = 2.5  # a sensor without a reading for longer is not heard;
HEARD_SPACINGS: Final = 1.5  # the same in periods of a sensor with a longer period
MORE_DROP: Final = 0.15  # beyond the median of the others: voltages of sound cells under one load differ by far less
MORE_LOAD: Final = 1.5  # ratio to the current before, and
MORE_LOAD_A: Final = 5.0  # difference to it, above which the voltage of a sound cell sags too
STEADY_S: Final = 30.0
STEADY_C: Final = 185.0  # limits of converters, and the ends of the ramps that faults make, are below
ANEW_S: Final = 8.0
FALL_K_S: Final = 3.0
LEAP_K: Final = 20.0
LEAP_BELOW_C: Final = 100.0
ROWS: Final = 72  # ticks that are remembered


class Runaway:
    """Thermal runaway of N cells with or without thermocouples.

    Parameters
    ----------
    names : sequence of str
        Strings.
    parts : sequence of slice
        The cells of each string among the N cells.

    Attributes
    ----------
    latched : ndarray of bool (N,)
        Runaways that no person has acknowledged.
    """

    def __init__(self, names: Sequence[str], parts: Sequence[slice]) -> None:
        self._names, self._parts = tuple(names), tuple(parts)
        n = parts[-1].stop if parts else 0
        self.latched = np.zeros(n, np.bool_)
        self._x, self._t, self._v, self._i = np.full((4, ROWS, n), np.nan)
        self._row = 0
        self._last, self._last_s = np.full(n, np.nan), np.full(n, -np.inf)
        self._anew_s = np.full(n, -np.inf)
        self._why: dict[int, str] = {}
        self._new: set[tuple[str | None, int | None]] = set()
        self._hint: dict[int, tuple[float, str]] = {}

    def step(
        self, value: Floats, time_s: Floats, invalid: Bools, volt: Floats, current: Floats | None = None
    ) -> list[int]:
        """Take the newest reading of each thermocouple in a tick.

        Parameters
        ----------
        value, time_s : ndarray (N,)
            °C as decoded, and bus time, s; NaN where there is no reading.
        invalid : ndarray of bool (N,)
            The sender or the DBC marks the value as invalid.
        volt : ndarray (N,)
            Of each cell, V; NaN where there is none.
        current : ndarray (N,), optional
            Magnitude of the current through each cell, A; NaN or None where unknown.

        Returns
        -------
        list of int
            Cells, from 0, whose runaway has just become certain.
        """
        self._row = (self._row + 1) % ROWS
        self._x[self._row], self._t[self._row], self._v[self._row] = value, time_s, volt
        self._i[self._row] = np.nan if current is None else current
        new = np.isfinite(value)
        step, since = value - self._last, np.maximum(time_s - self._last_s, 1e-3)
        odd = invalid | (step < -FALL_K_S * np.maximum(since, 1.0))
        odd |= (step > LEAP_K * np.maximum(since, 1.0)) & (self._last < LEAP_BELOW_C)
        if odd.any():
            now = float(np.nanmax(time_s)) if new.any() else float(self._last_s.max())
            self._anew_s[odd] = now + ANEW_S
        candidates = new & (value >= HOT_C) & (step > 0.0) & (time_s >= self._anew_s) & ~self.latched
        if candidates.any():
            candidates &= ~(value - self._x[self._row - round(RISES_S)] < HINT_K_S * RISES_S)
        self._last, self._last_s = np.where(new, value, self._last), np.where(new, time_s, self._last_s)
        found = [k for k in candidates.nonzero()[0].tolist() if self._certain(k)] if candidates.any() else []
        self.latched[found] = True
        owners = [next(i for i, p in enumerate(self._parts) if p.start <= k < p.stop) for k in found]
        self._new = {(self._names[i], k - self._parts[i].start + 1) for i, k in zip(owners, found, strict=True)}
        return found

    def _certain(self, k: int) -> bool:
        """Judge a cell whose newest reading is hot and rises."""
        t, x = self._history(k)
        n = _rises(t)
        if n >= len(t):
            return False
        rates = np.diff(x[-1 - n :]) / np.diff(t[-1 - n :])
        rate = (x[-1] - x[-1 - n]) / (t[-1] - t[-1 - n])
        if rate >= HINT_K_S and (why := self._grown(k, t, x, rate)):
            self._hint[k] = float(t[-1]), why
        if not (rates.min() >= EACH_K_S and rate >= MEAN_K_S and x[-n] >= HOT_C):
            return False
        since, hint = self._hint.get(k, (-np.inf, ""))
        why = self._dropped(k, t[-1]) or self._followed(k, t, x) or (hint if t[-1] - since <= HINT_S else "")
        if why:
            self._why[k] = f"{x[-1]:.0f} °C, rising {rate:.1f} K/s: {why}"
        return bool(why)

    def _grown(self, k: int, t: Floats, x: Floats, rate: float) -> str:
        """Say whether the rate of a cell that was hot and quiet before has grown as self-heating makes it grow."""
        ago = t[-1] - t
        before = (ago >= BEFORE_S[0] - 0.5) & (ago <= BEFORE_S[1] + 0.5)
        if before.sum() < 3 or np.median(x[before]) < BEFORE_C or np.diff(x[before]).std() > QUIET_K:
            return ""
        if self._steady(k, t, x):
            return "it rises on and on"
        earlier = (x[before][-1] - x[before][0]) / (t[before][-1] - t[before][0])
        if earlier > SLOWER * rate:
            return ""
        if self._sure(t, x):
            return "it was in self-heating before"
        length = max(INTERVAL_S, float(np.diff(t).max()))
        if x[-1] < ALONE_C or t[-1] - t[0] < INTERVALS * length - 0.5:
            return ""
        mean = -np.diff(np.interp(t[-1] - length * np.arange(INTERVALS + 1), t, x)) / length
        if mean.min() <= 0.0:
            return ""
        grows = mean[:-1] / mean[1:]
        faster = (
            (grows[:-1] >= FASTER * grows[1:]).all() and (grows[0] >= grows[2:]).all() and grows[1] >= LASTS * grows[3]
        )
        if (np.log(grows) > STEEPEST * length * (mean[:-1] + mean[1:]) / 2.0 + STEEP_LN).any():
            return ""
        late = t >= t[-1] - 3 * INTERVAL_S - 0.5
        turn = np.diff(np.diff(x[late]) / np.diff(t[late])).max()
        fine = np.abs(np.diff(x))
        if turn > TURNS * rate + TURNS_K_S + float(fine[fine > 0].min(initial=np.inf)) or self._common(k, t, x):
            return ""
        if not (faster and (grows >= GROWS).all() and grows.max() <= LEAPS):
            return ""
        return "it was hot before, and heats ever faster"

    def _sure(self, t: Floats, x: Floats) -> bool:
        """Tell whether the cell has heated for long at a rate that only self-heating has."""
        at = np.interp(t[-1] - np.arange(SURE_S[0], SURE_S[1] + 1.0, INTERVAL_S), t, x)
        rates = -np.diff(at) / INTERVAL_S
        return bool(t[-1] - t[0] >= SURE_S[1] and rates.min() >= SURE_K_S and at[-1] >= SURE_C)

    def _steady(self, k: int, t: Floats, x: Floats) -> bool:
        """Tell whether the cell alone has risen smoothly to a temperature that no failing sensor reads."""
        late = t >= t[-1] - STEADY_S - 0.5
        if x[-1] < STEADY_C or t[late][-1] - t[late][0] < STEADY_S - 0.5 or x[late][0] < SURE_C:
            return False
        rates = np.diff(x[late]) / np.diff(t[late])
        if rates.min() < EACH_K_S or rates.mean() < MEAN_K_S or rates.std() > QUIET_K:
            return False
        mates = [self._rate(j) for j in self._mates(k, t[-1])]
        return not mates or max(mates) < FOLLOWS_MOST * float(rates.mean())

    def _rate(self, k: int) -> float:
        """Mean rate of a cell over the newest `RISES_S`, K/s; 0 where there are too few readings."""
        t, x = self._history(k)
        n = _rises(t)
        return float((x[-1] - x[-1 - n]) / (t[-1] - t[-1 - n])) if n < len(t) else 0.0

    def _common(self, k: int, t: Floats, x: Floats) -> bool:
        """Tell whether another thermocouple of the string rises alike: this shows a common fault."""
        own = _excess(t, x)
        if own is None:
            return False
        rises = [theirs[-1] for j in self._mates(k, t[-1]) if (theirs := _excess(*self._history(j))) is not None]
        return any(FOLLOWS_MOST * own[-1] < rise < own[-1] / FOLLOWS_MOST for rise in rises)

    def _mates(self, k: int, now: float) -> list[int]:
        """List the other thermocouples of the string that are heard and whose history has not just started again."""
        part = next(p for p in self._parts if p.start <= k < p.stop)
        ready = np.flatnonzero(now >= self._anew_s[part]) + part.start
        return [j for j in ready.tolist() if j != k and now - self._last_s[j] <= _heard_s(self._history(j)[0])]

    def _followed(self, k: int, t: Floats, x: Floats) -> str:
        """Say whether another thermocouple of the string follows."""
        own = _excess(t, x)
        if own is None:
            return ""
        part = next(p for p in self._parts if p.start <= k < p.stop)
        for j in self._mates(k, t[-1]):
            tj, xj = self._history(j)
            theirs = _excess(tj, xj)
            if theirs is None or _rough(tj, xj) or not FOLLOWS_K <= theirs[-1] <= FOLLOWS_MOST * own[-1]:
                continue
            half = int(np.argmax(own >= 0.5 * own[-1]))
            if theirs[half] <= LATER * theirs[-1]:
                return f"cell {j - part.start + 1} follows"
        return ""

    def _dropped(self, k: int, now: float) -> str:
        """Say whether the cell's voltage has dropped by clearly more than those of its string."""
        if (own := self._drop(k, now)) is None or own[0] - own[1] <= DROP * own[0]:
            return ""
        part = next(p for p in self._parts if p.start <= k < p.stop)
        found = (self._drop(j, now) for j in range(part.start, part.stop) if j != k)
        others = [1.0 - after / before for before, after in (x for x in found if x is not None)]
        if others:
            if 1.0 - own[1] / own[0] - float(np.median(others)) < MORE_DROP:
                return ""
        elif self._loaded(k, now):
            return ""
        rates = [self._rate(j) for j in self._mates(k, now)]
        if rates and float(np.median(rates)) > FOLLOWS_MOST * self._rate(k):
            return ""
        return f"its voltage has dropped from {own[0]:.2f} to {own[1]:.2f} V"

    def _drop(self, k: int, now: float) -> tuple[float, float] | None:
        """Give the former voltage of a cell, and the greater of its two newest ones, V; None where unknown."""
        order = self._order()
        t, v = self._times(k)[order], self._v[order, k]
        known = np.isfinite(v) & np.isfinite(t)
        t, v = t[known], v[known]
        before = v[(now - t >= BEFORE_S[0]) & (now - t <= BEFORE_S[1])]
        if len(before) < 3 or np.median(before) < ALIVE_V or now - t[-1] > _heard_s(t):
            return None
        return float(np.median(before)), float(max(v[-1], v[-2]))

    def _times(self, k: int) -> Floats:
        """Give the stamps of the ticks, s: those of the cell, or of its string if the cell has no reading."""
        part = next(p for p in self._parts if p.start <= k < p.stop)
        rows = self._t[:, part]
        stamps: Floats = np.where(np.isfinite(rows), rows, -np.inf).max(axis=1)
        own = self._t[:, k]
        return np.where(np.isfinite(own), own, np.where(np.isfinite(stamps), stamps, np.nan))

    def _loaded(self, k: int, now: float) -> bool:
        """Tell whether the current has increased, which lowers the voltage of a sound cell too."""
        order = self._order()
        t, i = self._times(k)[order], self._i[order, k]
        known = np.isfinite(t) & np.isfinite(i)
        t, i = t[known], i[known]
        before = i[(now - t >= BEFORE_S[0]) & (now - t <= BEFORE_S[1])]
        return bool(len(before) and i[-1] > MORE_LOAD * np.median(before) + MORE_LOAD_A)

    def _order(self) -> NDArray[np.intp]:
        """Give the stored rows, oldest first."""
        return np.concatenate([np.arange(self._row + 1, ROWS), np.arange(self._row + 1)])

    def _history(self, k: int) -> tuple[Floats, Floats]:
        """Give the readings of a cell, oldest first."""
        order = self._order()
        x, t = self._x[order, k], self._t[order, k]
        known = np.isfinite(x)
        return t[known], x[known]

    def acknowledge(self, part: slice) -> bool:
        """End the runaways of some cells; return whether there was any."""
        was = bool(self.latched[part].any())
        self.latched[part] = False
        return was

    def snapshot(self, part: slice) -> list[bool]:
        """Runaways of some cells, as JSON-able values."""
        return [bool(x) for x in self.latched[part].tolist()]

    def restore(self, part: slice, state: Sequence[bool]) -> None:
        """Take up stored runaways of as many cells."""
        self.latched[part] = list(state)

    @property
    def told(self) -> list[Condition]:
        """Runaways that the newest tick has made certain."""
        return [c for c in self.conditions() if (c.string, c.cell) in self._new]

    def conditions(self) -> Iterator[Condition]:
        """List the runaways."""
        if not self.latched.any():
            return
        for name, part in zip(self._names, self._parts, strict=True):
            for k in np.flatnonzero(self.latched[part]).tolist():
                why = self._why.get(part.start + k, "told before a restart")
                text = f"thermal runaway of cell {k + 1} ({why}): leave the vehicle, call the fire brigade"
                yield Condition("runaway", Severity.ALARM, text, name, k + 1, settled=True, urgent=True)


def _heard_s(t: Floats) -> float:
    """Time after its newest reading for which a sensor with these stamps counts as heard, s."""
    return HEARD_S if len(t) < 3 else max(HEARD_S, HEARD_SPACINGS * float(np.median(np.diff(t[-6:]))))


def _rises(t: Floats) -> int:
    """Tell how many intervals the rise has: those of `RISES_S`, at least two."""
    if len(t) < 3:
        return len(t)
    return max(2, ceil(RISES_S / float(np.median(np.diff(t[-6:]))) - 0.1))


def _excess(t: Floats, x: Floats) -> Floats | None:
    """Rise over the last 10 s at 21 instants, K, less the rise at the rate of the 10 s before."""
    if len(t) < 4 or t[-1] - t[0] < 2 * FOLLOWS_S - 0.5:
        return None
    at = t[-1] - FOLLOWS_S * np.linspace(1.0, 0.0, 21)
    start, earlier = np.interp([t[-1] - FOLLOWS_S, t[-1] - 2 * FOLLOWS_S], t, x)
    excess: Floats = np.interp(at, t, x) - start - (start - earlier) * np.linspace(0.0, 1.0, 21)
    return excess


def _rough(t: Floats, x: Floats) -> bool:
    """Tell whether the last 20 s have a jump or a kink, which a body that its neighbours heat does not have."""
    late = t >= t[-1] - 2 * FOLLOWS_S - 0.5
    return bool(np.abs(np.diff(x[late], 2)).max(initial=0.0) > ROUGH_K)
