"""Does the model still explain the surfaces? The size of the innovations against what the observer expects of them.

All strings are judged at once, a second apart; only a flag that is raised, or may be soon, is looked at by itself.
"""

from dataclasses import dataclass, field
from math import nan

import numpy as np

from bms_gateway.health.flag import Flag, Thresholds
from bms_gateway.thermal import Floats

GRACE_S = 120.0
"""After a start or a pause the observer finds the state first: what it is surprised by then says nothing."""
WINDOW_S = 600.0  # ten minutes: longer than a burst of noise, shorter than a drive
# Mean square of innovations in units of their own variance: 1 when all is well. Model error is slow, so it stays close
# to 1 for long; 4 means that the surfaces are off by twice the band, minute after minute: suspected; 9 confirmed.
EXCESS = Thresholds(rise=(4.0, 9.0), fall=(2.0, 6.0), hold=60)


class Mismatches:
    """Model mismatch of S strings side by side.

    Parameters
    ----------
    strings : int

    Attributes
    ----------
    excess : ndarray (S,)
        Sliding mean of the squared normalised innovation; NaN before the first reading.
    flags : list of Flag
    """

    def __init__(self, strings: int) -> None:
        self.excess = np.full(strings, nan)
        self.flags = [Flag(EXCESS) for _ in range(strings)]
        self._grace = np.full(strings, GRACE_S)
        self._waits = True
        self._stirred: set[int] = set()  # whose flag is raised or about to be

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
        share = min(1.0, dt / WINDOW_S)
        excess = self.excess + (now - self.excess) * share
        if not self._stirred and excess.max() < EXCESS.rise[0]:  # all known, and nothing to tell: as nearly always
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
        """Begin string `k` anew after a pause; a raised flag stays until the readings speak against it."""
        self._grace[k], self.excess[k], self._waits = GRACE_S, nan, True


@dataclass(frozen=True, slots=True)
class Mismatch:
    """Model mismatch of string `k` of many, or of one by itself."""

    of: Mismatches = field(default_factory=lambda: Mismatches(1))
    k: int = 0

    @property
    def flag(self) -> Flag:
        """Only readings move its level."""
        return self.of.flags[self.k]

    @property
    def excess(self) -> float:
        """Sliding mean of the squared normalised innovation; NaN before the first reading."""
        return float(self.of.excess[self.k])

    def resume(self) -> None:
        """Begin anew after a pause; a raised flag stays until the readings speak against it."""
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
