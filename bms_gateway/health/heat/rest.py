"""Strings at rest: no current flows while the bus is silent, so the watch continues between rare frames and in a sleep.

A string is at rest after `STOOD` ticks in a row, or `STOOD_S`, in which every known current was zero; the second number
is needed because a vehicle whose frames come once a minute also stops at a light. The rest ends when a current flows,
or when thermocouples are read more than once without a known current. While at rest, an unknown current counts as zero.
A time without frames is computed in long steps, with an inlet that is linear between its values before and after. If a
current flows at its end, its beginning is unknown, and the string starts again.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats

REST_RATE = 1e-4
"""Heating rate by the current, K/s, below which the string counts as at rest."""
UNSAID = 2
"""Ticks with readings and without a known current that may belong to a rest: frames of one burst fall into two
ticks."""
STOOD = 10
"""Ticks in a row with a known current of zero after which a string rests,"""
STOOD_S = 600.0
"""or time since the first of them, for rarer frames."""
STRIDES_S = (10.0, 60.0, 600.0)
MOST_STRIDES = 90
LONGEST_S = 36 * 3600.0
"""Longest sleep in the computation: cells have then forgotten their start."""
STRAYED_K = 3.0
"""If the median thermocouple differs by more from its prediction, there was no rest, or the air differs from the
inlet."""


@dataclass(slots=True)
class Rest:
    """State from which the rest of S strings is decided.

    Attributes
    ----------
    resting : ndarray of bool (S,)
    flows : ndarray of bool (S,)
        Whether the last known current was above zero.
    slept_s : float
        Time without frames that has not been computed yet.
    """

    resting: Bools
    flows: Bools
    _unsaid: Ints
    _stood: Ints
    _still_s: Floats
    slept_s: float = 0.0

    @classmethod
    def of(cls, strings: int) -> "Rest":
        """Start with no string known to be at rest."""
        no, none = np.zeros(strings, np.bool_), np.zeros(strings, np.int64)
        return cls(no, no, none, none + STOOD, np.zeros(strings))  # no current was ever known to flow

    def go_on(self, s: int) -> None:
        """Mark string `s` as one that rested before a restart."""
        self.resting[s], self._stood[s] = True, STOOD

    def sleep(self, gap_s: float, before_s: float) -> None:
        """Note a time without frames, s, after ticks of `before_s` that are not in a step yet."""
        self.slept_s += gap_s + before_s
        self._still_s += gap_s

    def take(self, square: Floats, current: Floats, most: Floats, y: Floats, tick_s: float) -> tuple[Floats, Floats]:
        """Note a tick; return square, A², and current, A, (S,), with zero for resting strings of unknown current.

        Parameters
        ----------
        square, current : ndarray (S,)
            NaN if unknown.
        most : ndarray (S,), A²
            Limit below which no current flows.
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
    """Divide a sleep into steps, s; their sum is its length to 10 s."""
    left = min(slept_s, LONGEST_S)
    longest = next((h for h in STRIDES_S if left / h <= MOST_STRIDES), STRIDES_S[-1])
    for h in reversed([h for h in STRIDES_S if h <= longest]):
        for _ in range(int((left + STRIDES_S[0] / 2.0) // h)):
            yield h
            left -= h
