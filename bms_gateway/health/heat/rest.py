"""Strings at rest: nothing flows while nobody speaks, so the watch goes on between rare frames and through a sleep.

A string is at rest once every current known in `STOOD` ticks in a row, or for `STOOD_S`, was nothing: a vehicle whose
frames come once a minute stops at a light as well. It rests until a current flows, or until its thermocouples were
heard more often than once without a current. What is unknown of the current then counts as nothing. A time without
frames is gone through in long steps with the inlet on a straight line from before to after; where a current flows at
its end, nobody knows since when, and the string begins anew.
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
STOOD = 10
"""Ticks with a known current in a row in which nothing flows,"""
STOOD_S = 600.0
"""or time since the first of them, for frames that are rarer than that."""
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
    flows : ndarray of bool (S,)
        Whether a current flowed when one was known last.
    slept_s : float
        Time without frames that has not been gone through yet.
    """

    resting: Bools
    flows: Bools
    _unsaid: Ints
    _stood: Ints
    _still_s: Floats
    slept_s: float = 0.0

    @classmethod
    def of(cls, strings: int) -> "Rest":
        """Know of no string that it rests."""
        no, none = np.zeros(strings, np.bool_), np.zeros(strings, np.int64)
        return cls(no, no, none, none + STOOD, np.zeros(strings))  # no current was ever known to flow

    def go_on(self, s: int) -> None:
        """Take string `s` as one that rested before a restart."""
        self.resting[s], self._stood[s] = True, STOOD

    def sleep(self, gap_s: float, before_s: float) -> None:
        """Take in a time without frames, s, after ticks of `before_s` that no step has taken in."""
        self.slept_s += gap_s + before_s
        self._still_s += gap_s

    def take(self, square: Floats, current: Floats, most: Floats, y: Floats, tick_s: float) -> tuple[Floats, Floats]:
        """Take in a tick; square, A², and current, A, (S,) with nothing where a string rests and nobody says so.

        Parameters
        ----------
        square, current : ndarray (S,)
            NaN where not known.
        most : ndarray (S,), A²
            Below it nothing flows.
        y : ndarray (S, n), °C
        tick_s : float, s
        """
        known = np.isfinite(square)
        with np.errstate(invalid="ignore"):
            nothing = square < most
        self._stood = np.where(nothing, self._stood + 1, np.where(known, 0, self._stood))
        self._still_s = np.where(self._stood > 0, self._still_s + tick_s, 0.0)
        self.flows = np.where(known, ~nothing, self.flows)
        stood = (self._stood >= STOOD) | (self._still_s >= STOOD_S)
        if known.all():
            self.resting = stood
            self._unsaid[:] = 0
            return square, current
        heard = np.isfinite(y).any(axis=1)
        self._unsaid = np.where(known, 0, self._unsaid + heard)
        self.resting = np.where(known, stood, self.resting & (self._unsaid <= UNSAID))
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
