"""How thermocouples read: their noise, and the steps that a bus rounds them to, both learnt from what they read."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_gateway.health.heat.filter import CASING_SD, READING_SD
from bms_gateway.thermal import Floats

NOISE_SHARE = 0.005  # of what each reading tells of its noise
SAME = 1e-3
"""K: readings that differ by less are the same but for rounding."""
COARSEST = 1.0
"""K: no bus rounds a temperature to more."""
ENOUGH = 3
"""Changes of a reading that tell its step. Before, it is at most what the readings of the string have in common: a bus
counts temperatures in whole steps, mostly from 0 °C, and all of them alike."""
STAIRS = 4
"""Readings equal to the one before, per reading that is not, from which on a thermocouple reads in stairs. What a
resampled log has between two stairs is their mean: steps are learnt from values that were read twice in a row."""


class Thermocouples:
    """Thermocouples of S strings with m each.

    Parameters
    ----------
    strings, sensors : int
        S, m.
    """

    def __init__(self, strings: int, sensors: int) -> None:
        shape = strings, sensors
        self._last = np.full(shape, np.nan)
        self._all, self._stairs = CommonStep(shape), CommonStep(shape)
        self._repeats = np.zeros(shape, np.int64)
        self._noise = np.full(shape, READING_SD**2)

    @property
    def _in_stairs(self) -> NDArray[np.bool_]:
        """Which thermocouples (S, m) read in stairs."""
        return np.asarray(self._repeats >= STAIRS * np.maximum(self._all.changes, 1), dtype=np.bool_)

    @property
    def step(self) -> Floats:
        """Steps of the readings (S, m), K; 0 where none is known."""
        stairs = self._in_stairs
        # a mean was read, and no second stair yet: the steps are those of the first
        first = stairs & (self._all.changes > 0) & (self._stairs.changes == 0)
        step = np.where(stairs, self._stairs.step, self._all.step)
        return np.where(first, common_divisor(np.full(step.shape, COARSEST), self._stairs.most), step)

    def pause(self) -> None:
        """Take in a time without frames."""
        self._last[:] = np.nan

    def take(self, y: Floats) -> tuple[Floats, Floats]:
        """Take in the readings of a step of some ticks.

        Parameters
        ----------
        y : ndarray (ticks, S, m), °C
            NaN where nothing was read.

        Returns
        -------
        mean, variance : ndarray (S, m), °C, K²
            Of each thermocouple; NaN where it was not read.
        """
        there = np.isfinite(y)
        number = there.sum(axis=0)
        divisor = np.where(number > 0, number, np.nan)
        mean = np.where(there, y, 0.0).sum(axis=0) / divisor
        for now in y:  # steps show between rare frames too
            stands = np.abs(now - self._all.newest) <= SAME
            self._repeats += stands
            self._all.take(now)
            self._stairs.take(np.where(stands, now, np.nan))
        change = np.abs(np.diff(np.concatenate((self._last[None], y)), axis=0))
        both = np.isfinite(change)
        square = np.where(both, np.square(change), 0.0).sum(axis=0) / 2.0
        self._noise = self._noise + (square - both.sum(axis=0) * self._noise) * NOISE_SHARE
        self._last = np.where(there[-1], y[-1], np.nan)
        step2 = np.square(self.step)
        coarse = np.where(step2 / 6.0 > self._noise, step2, step2 / 12.0 / divisor)
        return mean, np.maximum(self._noise, READING_SD**2) / divisor + coarse + CASING_SD**2

    def snapshot(self) -> dict[str, Any]:
        """Return what a restart takes up: steps, K, noise, K², and newest readings, °C."""
        step = np.where(self._in_stairs, self._stairs.common, self._all.common)
        named = {"step": step, "noise": self._noise, "newest": self._all.newest}
        return {k: [[x if np.isfinite(x) else None for x in row] for row in v.tolist()] for k, v in named.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a snapshot.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none, or of other strings.
        """
        step, noise, newest = (np.array(state[k], np.float64) for k in ("step", "noise", "newest"))  # None is NaN
        if not step.shape == noise.shape == newest.shape == self._noise.shape or not (noise >= 0.0).all():
            raise ValueError("heat: not of these strings")
        self._noise = noise
        for values in (self._all, self._stairs):
            values.common, values.newest = np.where(step > 0.0, step, np.inf), newest
            values.changes = np.where(step > 0.0, ENOUGH, 0)


class CommonStep:
    """The step that the values which each thermocouple reads have in common.

    Attributes
    ----------
    newest : ndarray (S, m), °C
        The last value; NaN before the first.
    common : ndarray (S, m), K
        Greatest common divisor of all changes; infinite before the first.
    changes : ndarray (S, m)
        Their number.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.newest = np.full(shape, np.nan)
        self.common, self._whole = np.full((2, *shape), np.inf)
        self.changes = np.zeros(shape, np.int64)

    @property
    def most(self) -> Floats:
        """The greatest step that the values allow (S, m), K."""
        together = np.minimum(self._whole.min(axis=1, keepdims=True), COARSEST)
        return np.where(self.changes < ENOUGH, together, COARSEST)

    @property
    def step(self) -> Floats:
        """Steps of the values (S, m), K; 0 where none is known."""
        return np.where(np.isfinite(self.common), np.minimum(self.common, self.most), 0.0)

    def take(self, now: Floats) -> None:
        """Take in values (S, m), °C, NaN where there are none."""
        moved = np.abs(now - self.newest)
        changed = moved > SAME
        self.common = finer(self.common, moved, changed)
        self._whole = finer(self._whole, np.abs(now), self.changes < ENOUGH)
        self.changes += changed
        self.newest = np.where(np.isfinite(now), now, self.newest)


def finer(step: Floats, x: Floats, asked: NDArray[np.bool_]) -> Floats:
    """Make steps divide `x` too where they are asked to; nearly always they do already, which is quickly seen.

    >>> finer(np.array([0.5, 0.5, 0.5]), np.array([1.5, 0.7, 0.7]), np.array([True, True, False])).round(4).tolist()
    [0.5, 0.1, 0.5]
    """
    asked = asked & np.isfinite(x)
    if not asked.any():
        return step
    known = np.isfinite(step) & (step > SAME)
    of = np.where(known, step, 1.0)
    divided = known & (np.abs(x - of * np.rint(x / of)) < SAME)
    if divided[asked].all():
        return step
    found = common_divisor(step, x)
    times = np.rint(np.where(found > SAME, x / np.where(found > SAME, found, 1.0), 0.0))
    # each round of Euclid multiplies the error of the last: the reading itself is exact
    exact = np.where(times != 0.0, x / np.where(times != 0.0, times, 1.0), found)
    return np.where(asked, exact, step)


def common_divisor(a: Floats, b: Floats) -> Floats:
    """Greatest common divisor of `a` and `b`, K, to `SAME` (Euclid); where either is none (infinite, NaN), the other.

    >>> common_divisor(np.array([1.0, 5.0 / 3.0, np.inf]), np.array([0.7, 10.0 / 9.0, 0.3])).round(4).tolist()
    [0.1, 0.5556, 0.3]
    """
    a, b = np.where(np.isfinite(a), a, b), np.where(np.isfinite(b), b, a)
    while (b > SAME).any():
        divisor = np.where(b > SAME, b, 1.0)
        rest = np.mod(np.where(np.isfinite(a), a, 0.0), divisor)
        rest = np.where(divisor - rest < SAME, 0.0, rest)
        a, b = np.where(b > SAME, b, a), np.where(b > SAME, rest, b)
    return a
