"""Judges whether the model still explains the surfaces: it compares the innovations with their expected sd.

All strings are judged together at each tick. A single string is looked at only when its flag is raised or near it.
"""

from dataclasses import dataclass, field
from math import nan

import numpy as np

from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.thermal import Floats

GRACE_S = 120.0
"""After a start or a pause the observer must first find the temperatures; its innovations in this time do not count."""
WINDOW_S = 600.0
"""Time constant of the sliding mean: longer than a burst of noise, shorter than a drive. In the first ten minutes the
plain mean of all innovations is used instead. With a sliding mean from the first innovation on, one large first
innovation would dominate these ten minutes: of strings with two sensors, one start in seventy raised a false flag."""
# Mean square of the innovations in units of their own variance: 1 if the model is right. At 4 the surfaces have been
# wrong by twice the band for minutes: a model error is suspected. At 9 it is confirmed.
MOST = 16.0
"""Greatest value that one tick adds to the mean, four times the band. When a loose thermocouple is repaired, it
jumps by several K; without this bound, one jump would keep the flag raised for half an hour."""
EXCESS = Thresholds(rise=(4.0, 9.0), fall=(2.0, 6.0), hold=60)


class Mismatches:
    """Model mismatch of S strings side by side.

    Attributes
    ----------
    excess : ndarray (S,)
        Mean of the squared normalised innovation over the last ten minutes; NaN before the first reading.
    flags : list of Flag
    """

    def __init__(self, strings: int) -> None:
        self.excess = np.full(strings, nan)
        self.flags = [Flag(EXCESS) for _ in range(strings)]
        self._grace = np.full(strings, GRACE_S)
        self._waits = True
        self._seen_s = np.zeros(strings)  # how long there have been readings
        self._fills = True
        self._stirred: set[int] = set()  # strings whose flag is raised, or has begun to count

    def take(self, now: Floats, dt: float) -> list[int]:
        """Take the mean squares (S,) of one tick's normalised innovations.

        Parameters
        ----------
        now : ndarray (S,)
            NaN where there was no reading.
        dt : float
            Seconds since the last tick.

        Returns
        -------
        list of int
            Strings whose flag's level changed.
        """
        if self._waits:
            waiting = self._grace > 0.0
            now = np.where(waiting, nan, now)
            self._grace[waiting] -= dt
            self._waits = bool(waiting.any())
        now = np.minimum(now, MOST)
        share: float | Floats = min(1.0, dt / WINDOW_S)
        if self._fills:
            self._seen_s += np.where(now == now, dt, 0.0)
            share = np.minimum(1.0, dt / np.clip(self._seen_s, dt, WINDOW_S))
            self._fills = bool((self._seen_s < WINDOW_S).any())
        excess = self.excess + (now - self.excess) * share
        if not self._stirred and excess.max() < EXCESS.rise[0]:  # the usual case: all are known and none is large
            self.excess = excess
            return []
        known = now == now
        start = np.where(known & (self.excess != self.excess), now, self.excess)
        self.excess = np.where(known, start + (now - start) * share, start)
        looked_at = self._stirred.union((self.excess >= EXCESS.rise[0]).nonzero()[0].tolist())
        changed = [k for k in sorted(looked_at) if known[k] and self.flags[k].update(float(self.excess[k]))]
        self._stirred = {k for k in looked_at if self.flags[k].stirred}
        return changed

    def resume(self, k: int) -> None:
        """Start the mean of string `k` again after a pause; a raised flag stays until new readings lower it."""
        self._grace[k], self.excess[k], self._waits = GRACE_S, nan, True
        self._seen_s[k], self._fills = 0.0, True


@dataclass(frozen=True, slots=True)
class Mismatch:
    """Model mismatch of string `k` among many strings, or of a single string."""

    of: Mismatches = field(default_factory=lambda: Mismatches(1))
    k: int = 0

    @property
    def flag(self) -> Flag:
        """Flag of the string; only new readings change its level."""
        return self.of.flags[self.k]

    @property
    def excess(self) -> float:
        """Sliding mean of the squared normalised innovation; NaN before the first reading."""
        return float(self.of.excess[self.k])

    def resume(self) -> None:
        """Start the mean again after a pause; a raised flag stays until new readings lower it."""
        self.of.resume(self.k)

    def sentence(self) -> str:
        """Say what the flag means and what to do."""
        if self.flag.level:
            return (
                f"the model does not explain the surfaces (innovations {self.excess**0.5:.1f} times their band over "
                "ten minutes): a physical effect is missing or a sensor errs; bms-gateway export --last 2h --out "
                "recent.csv, then bms-gateway diagnose recent.csv --model the string's model file"
            )
        return "the model explains the surfaces again"
