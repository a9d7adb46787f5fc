"""Whether a channel that has jumped reads again what it read beside its neighbours.

The guard believes a channel some calm samples after a jump, wherever it then stands. A thermocouple that has come off
reads its surroundings calmly, and one that has failed reads anything: no number of calm samples shows that its cell has
cooled within a second. So a channel that jumped, and since then reads less beside its neighbours than before, is
*held*. It is used again

* when it has been back at its old distance from the median of its neighbours for `BACK_NS`, as after cold water on the
  sensor, or after a contact that came off and is fastened;
* or when it has not jumped for `HOLD_NS`,

in both cases only if it has moved since: one that stands at the value of its jump has frozen. Where all neighbours
step, the distance stays as it was, and nothing is held.

A channel that reads more is not held: a hot cell must be seen, even where that may be wrong.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.neighbours import FEWEST_ALIKE

__all__ = ["HOLD_NS", "Seen", "Stepped"]

Index = NDArray[np.intp]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

HOLD_NS = 900_000_000_000
"""Time since its last jump after which a channel that reads less is used again. The watch over heat waits for as long
before it uses a thermocouple again that it has set aside."""

BACK_NS = 60_000_000_000
"""Time for which it must be back: a frozen reading, past which its neighbours cool, stays near theirs for less."""
NEAR, STEPS = 0.5, 3.0
"""It is back within this share of a jump, or within this many usual steps of its own before it jumped: a usual step is
1.1 standard deviations of the noise, and one noisy reading is compared with another."""


class Seen(NamedTuple):
    """One sample of each of several channels, each (k,).

    Attributes
    ----------
    value, time_ns, usable : ndarray
    jumped : ndarray of bool
    before : ndarray
        Last usable value before it; NaN for none.
    believed : ndarray of bool
        The channel was believed until now.
    step : ndarray
        Usual step from sample to sample before it.
    """

    value: Floats
    time_ns: NDArray[np.int64]
    usable: Bools
    jumped: Bools
    before: Floats
    believed: Bools
    step: Floats


class Stepped:
    """Channels that have jumped, and their distances from their neighbours before.

    Parameters
    ----------
    group : ndarray of intp (m,)
        Number of each channel's group.
    jump : ndarray (m,)
        Greatest step of each channel that is no jump.

    Attributes
    ----------
    some : bool
        Whether any channel has jumped and is not back yet.
    held : ndarray of bool (m,)
        Whether the last sample of each channel was held.
    """

    def __init__(self, group: Index, jump: Floats) -> None:
        m = len(group)
        self._group, self._jump, self._number = group, jump, np.arange(m)
        self._was, self._near = np.full((2, m), np.nan)
        self._until_ns, self._back_ns = np.zeros((2, m), np.int64)
        self._low, self._moved, self._first = np.zeros(m, np.bool_), np.zeros(m, np.bool_), np.full(m, np.nan)
        self._level, self._counts = np.full(m, np.nan), np.zeros(m, np.bool_)
        self.some, self.held = False, np.zeros(m, np.bool_)

    def begin(self, level: Floats, believed: Bools) -> None:
        """Begin an interval with the last usable values (m,), NaN for none, and which channels (m,) are believed.

        The others are compared with these, so that the order of the samples of an interval does not matter.
        """
        self._level, self._counts = level.copy(), believed | ~np.isnan(self._was)

    def judge(self, c: Index | slice, seen: Seen) -> Bools:
        """Judge one sample of each of several channels; return which of them are held."""
        held = np.zeros(len(seen.value), np.bool_)
        for i, k in enumerate(self._number[c].tolist()):
            jumped = bool(seen.jumped[i])
            if not seen.usable[i]:
                continue
            self.held[k] = False
            if not jumped and np.isnan(self._was[k]):
                continue
            now, middle = int(seen.time_ns[i]), self._middle(k)
            if jumped:
                if np.isnan(self._was[k]) and seen.believed[i]:
                    self._was[k], self._low[k] = seen.before[i] - middle, False
                    self._near[k] = max(NEAR * self._jump[k], STEPS * seen.step[i])
                self._until_ns[k], self._back_ns[k] = now + HOLD_NS, now + HOLD_NS
                self._first[k], self._moved[k] = seen.value[i], False
            else:
                self._moved[k] |= seen.value[i] != self._first[k]
                self.held[k] = held[i] = self._reads_less(k, now, seen.value[i] - middle - self._was[k])
        self.some = not bool(np.isnan(self._was).all())
        return held

    def _reads_less(self, k: int, now_ns: int, off: float) -> bool:
        """Whether channel `k` is held, which is `off` its old distance (NaN: no neighbours); free one that is back."""
        less = not off >= -self._near[k]
        self._low[k] |= less
        if less:
            self._back_ns[k] = self._until_ns[k]
        elif self._low[k]:
            self._back_ns[k] = min(self._back_ns[k], now_ns + BACK_NS)
        over = now_ns >= (self._back_ns[k] if self._low[k] else self._until_ns[k])
        over &= bool(self._moved[k] or not self._low[k])
        if over or not (self._low[k] or off > self._near[k]):
            self._was[k] = np.nan
        return bool(self._low[k]) and not over

    def _middle(self, k: int) -> float:
        """Median of the neighbours of channel `k` that count; NaN for too few."""
        others = self._counts & (self._group == self._group[k]) & ~np.isnan(self._level)
        others[k] = False
        return float(np.median(self._level[others])) if np.count_nonzero(others) >= FEWEST_ALIKE - 1 else float("nan")
