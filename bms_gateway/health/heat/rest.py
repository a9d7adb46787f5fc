"""Strings at rest: nothing flows while nobody speaks, so the watch goes on between rare frames and through a sleep.

A string whose last known current was nothing is at rest until a current is known again, or until its thermocouples were
heard more often than once without it. What is unknown of the current then counts as nothing. A time without frames is
gone through in long steps with the inlet on a straight line from before to after.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats

REST_RATE = 1e-4
"""K/s of a cell's heat capacity by the current: below, nothing flows."""
UNSAID = 2
"""Ticks with readings and no current, since one was known, that may be at rest: frames of one burst fall into two."""
STRIDES_S = (10.0, 60.0, 600.0)
MOST_STRIDES = 90
LONGEST_S = 36 * 3600.0
"""A longer sleep counts as so long: by then cells have forgotten where they began."""
STRAYED_K = 3.0
"""If the median thermocouple is further from what rest makes of it, there was none, or the air is not the inlet's."""


@dataclass(slots=True)
class Rest:
    """What says whether S strings are at rest.

    Attributes
    ----------
    resting : ndarray of bool (S,)
    slept_s : float
        Time without frames that has not been gone through yet.
    """

    resting: Bools
    unsaid: Ints
    slept_s: float = 0.0

    @classmethod
    def of(cls, strings: int) -> "Rest":
        """Know of no string that it rests."""
        return cls(np.zeros(strings, np.bool_), np.zeros(strings, np.int64))

    def take(self, square: Floats, current: Floats, most: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Take in a tick; square, A², and current, A, (S,) with nothing where a string rests and nobody says so.

        Parameters
        ----------
        square, current : ndarray (S,)
            NaN where not known.
        most : ndarray (S,), A²
            Below it nothing flows.
        y : ndarray (S, n), °C
        """
        known = np.isfinite(square)
        if known.all():
            self.resting = square < most
            self.unsaid[:] = 0
            return square, current
        heard = np.isfinite(y).any(axis=1)
        self.unsaid = np.where(known, 0, self.unsaid + heard)
        with np.errstate(invalid="ignore"):
            self.resting = np.where(known, square < most, self.resting & (self.unsaid <= UNSAID))
        assumed = self.resting & ~known
        return np.where(assumed, 0.0, square), np.where(assumed, 0.0, current)


def strides(slept_s: float) -> Iterator[float]:
    """Cut a sleep into steps, s; together they are its length to 10 s."""
    left = min(slept_s, LONGEST_S)
    longest = next((h for h in STRIDES_S if left / h <= MOST_STRIDES), STRIDES_S[-1])
    for h in reversed([h for h in STRIDES_S if h <= longest]):
        for _ in range(int((left + STRIDES_S[0] / 2.0) // h)):
            yield h
            left -= h
