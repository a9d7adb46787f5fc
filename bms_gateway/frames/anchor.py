"""The value at which each channel stays (anchor), and the longest such value (home); `guard` explains the words."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.neighbours import Compared

__all__ = ["ANCHORED", "AT_HOME", "HOME_MEMORY_S", "LONGEST_STEP_S", "SETTLED", "Anchors", "Left"]

Index = NDArray[np.intp]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
ANCHORED = 3
"""Net samples that must differ before a channel has left its value."""
AT_HOME = 2
"""Net samples at exactly the old value that count as a return."""
SETTLED = 2.0
"""A home counts if it was held once for this many times `stuck_after_s`, in seconds and in samples. With steps of
0.01 K, noise of 0.05 K holds a value for 20 samples once in 50,000 hours and never for 40; noise of 0.02 K holds a
value for 40 samples once in 100,000 hours."""
HOME_MEMORY_S = 300.0
"""Active time away from a home after which it is forgotten."""
LONGEST_STEP_S = 10.0
"""A longer gap between intervals does not count as time of standing still."""


@dataclass(frozen=True, slots=True)
class Left:
    """Result of one sample of each of several channels.

    Attributes
    ----------
    moved : ndarray of bool
        It left its anchor.
    returned : ndarray of bool
        It came back to its home after active time.
    at_home : ndarray of bool
        It came back to a home that noise cannot have made.
    """

    moved: Bools
    returned: Bools
    at_home: Bools


@dataclass(frozen=True, slots=True)
class Standing:
    """Data by which an anchor is judged.

    Attributes
    ----------
    clock : ndarray
        Active time of each channel, s.
    limit : ndarray
        Active time after which an anchor makes a channel stuck, s.
    stuck : ndarray of bool
        Which channels were stuck before.
    alone : Compared or None
        Comparison with their neighbours; None if all are trusted.
    """

    clock: Floats
    limit: Floats
    stuck: Bools
    alone: Compared | None


class Anchors:
    """Anchors and homes of m channels.

    Attributes
    ----------
    since : ndarray (m,)
        Active time at which each channel took its anchor, s.
    held : ndarray of int64 (m,)
        Samples since then.
    home : ndarray (m,)
        NaN for none.
    """

    def __init__(self, m: int) -> None:
        self.since, self.held, self.home = np.zeros(m), np.zeros(m, np.int64), np.full(m, np.nan)
        self._value, self._count, self._held_s = np.full(m, np.nan), np.zeros(m, np.int64), np.zeros(m)
        self._home_held, self._home_held_s, self._home_seen = np.zeros(m, np.int64), np.zeros(m), np.zeros(m)

    def follow(self, c: Index | slice, value: Floats, usable: Bools, seconds: Floats, at: Standing) -> Left:
        """Include one sample of each of several channels, `seconds` after the previous one."""
        clock = at.clock
        same = value == self._value[c]
        count = np.where(same, np.minimum(self._count[c] + 1, ANCHORED), self._count[c] - 1)
        moved = usable & (count <= 0)
        count = np.where(moved, 1, np.where(usable, count, self._count[c]))
        held = np.where(moved, 1, self.held[c] + usable)
        held_s = np.where(moved, 0.0, self._held_s[c] + usable * np.minimum(seconds, LONGEST_STEP_S))
        anchor = np.where(moved, value, self._value[c])
        self._count[c], self.held[c], self._held_s[c], self._value[c] = count, held, held_s, anchor
        self.since[c] = np.where(moved, clock, self.since[c])
        there = usable & same & (anchor == self.home[c]) & (count >= AT_HOME)
        longest = held > self._home_held[c]
        # at rest a good sensor may return to the same hundredth too; a sensor that was stuck before stays stuck
        returned = at_home = there & ~longest & ((clock > self._home_seen[c]) | at.stuck)
        if returned.any():
            settled = np.minimum(self._home_held[c], self._home_held_s[c]) >= SETTLED * at.limit
            at_home = returned & (at.stuck | settled)
            if at.alone is not None:
                at_home |= returned & at.alone.strays & (count >= ANCHORED)
        renewed = longest | (clock - self._home_seen[c] > HOME_MEMORY_S)
        self.home[c] = np.where(renewed, anchor, self.home[c])
        self._home_held[c] = np.where(renewed, held, self._home_held[c])
        self._home_held_s[c] = np.where(renewed, held_s, self._home_held_s[c])
        self._home_seen[c] = np.where(renewed | there, clock, self._home_seen[c])
        return Left(moved, returned, at_home)
