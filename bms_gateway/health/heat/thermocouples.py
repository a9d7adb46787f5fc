"""Properties of thermocouples, learnt from their readings: noise, and the step to which a bus rounds them.

Other errors of their means, by lag or position on a cell, are learnt from the innovations of the heat filter.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bms_gateway.health.heat.filter import CASING_SD, READING_SD
from bms_gateway.health.heat.layout import Bools
from bms_gateway.thermal import Floats

NOISE_SHARE = 0.005  # share of each reading in the learnt noise
SAME = 1e-3
"""K: readings that differ by less are equal except for rounding."""
COARSEST = 1.0
"""K: greatest resolution of a temperature on a bus."""
ENOUGH = 3
"""Changes of a reading that determine its step. Before, the step is at most the common divisor of the string's
readings: a bus counts temperatures in whole steps, mostly from 0 °C, with the same step for all."""
STAIRS = 4
"""Ratio of unchanged to changed readings above which a thermocouple reads in stairs. A resampled log has their mean
between two stairs: the step is then learnt from values that were read twice in a row."""


LEAST_CASING_SD = 0.01
"""K: least error of the mean of a step that more readings do not reduce. It begins with `CASING_SD`, its greatest."""
LEARN_S, LONG = 600.0, 18
"""Time constant, s, with which this error is learnt; and number of steps whose mean innovation must also agree with its
sd: a lag or a drift of minutes is not visible from one step to the next."""
UNUSUAL, LEAST_RUN, LEARNT = 3.0, 20, 600
"""A thermocouple stands unusually still if it has read the same for so many times the longest such time of the last
hour, and for so many ticks; so many ticks show what is usual. A sensor that has frozen does."""
HOUR = 3600.0  # ticks
MOST_GROWN = 5.0
"""Greatest rate at which the error grows, over that of `LEARN_S`."""


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
        self._run, self._longest, self._ticks = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._noise = np.full(shape, READING_SD**2)
        self._casing = np.full((2, *shape), CASING_SD**2)  # K², driven and at rest
        self._ratios = np.ones((2, 2, *shape))  # squared innovations over their variance: of a step, of `LONG`
        self._calm = np.zeros(strings, np.bool_)
        self._sums, self._summed = np.zeros((2, 2, *shape)), np.zeros((2, *shape), np.int64)

    @property
    def _in_stairs(self) -> Bools:
        """Which thermocouples (S, m) read in stairs."""
        return np.asarray(self._repeats >= STAIRS * np.maximum(self._all.changes, 1), dtype=np.bool_)

    @property
    def step(self) -> Floats:
        """Steps of the readings (S, m), K; 0 if unknown."""
        stairs = self._in_stairs
        # a mean was read, and no second stair yet: use the step of all readings
        first = stairs & (self._all.changes > 0) & (self._stairs.changes == 0)
        step = np.where(stairs, self._stairs.step, self._all.step)
        return np.where(first, common_divisor(np.full(step.shape, COARSEST), self._stairs.most), step)

    @property
    def still(self) -> Floats:
        """Number of ticks (S, m) for which a thermocouple has read the same, if that is unusual for it; else 0."""
        unusual = (self._run >= LEAST_RUN) & (self._run > UNUSUAL * self._longest) & (self._ticks >= LEARNT)
        return np.where(unusual, self._run, 0.0)

    def _follow(self, stands: Bools, read: Bools) -> None:
        """Note which thermocouples (S, m) repeat their reading in a tick, of those that have one."""
        moves = read & ~stands
        self._ticks += read
        self._longest *= 1.0 - 1.0 / HOUR
        self._longest = np.where(moves, np.maximum(self._longest, self._run), self._longest)
        self._run = np.where(moves, 0.0, self._run + stands)

    def pause(self) -> None:
        """Note a time without frames."""
        self._last[:] = np.nan

    def learn(self, nu: Floats, var: Floats, sound: Bools, calm: Bools, dt: float) -> None:
        """Learn the error of the means besides noise from a step; it falls while innovations are not above their sd.

        Parameters
        ----------
        nu, var : ndarray (S, m), K, K²
            Innovations of the filter, and their stated variance.
        sound : ndarray of bool (S, m)
            Which of them belong to a sound thermocouple in a string without a suspicion.
        calm : ndarray of bool (S,)
            Strings without load, which are learnt separately.
        dt : float, s
            Length of the step.
        """
        self._calm = calm
        there = np.stack((~calm, calm))[:, :, None] & sound
        self._sums += np.where(there, np.stack((nu, var))[:, None], 0.0)
        self._summed += there
        whole = self._summed >= LONG
        long = np.square(self._sums[0]) / np.where(whole, self._sums[1], 1.0)
        share = min(1.0, dt / LEARN_S)
        self._ratios[0] += np.where(there, np.square(nu) / var - self._ratios[0], 0.0) * share
        self._ratios[1] += np.where(whole, long - self._ratios[1], 0.0) * min(1.0, share * LONG)
        self._sums[:, whole], self._summed[whole] = 0.0, 0
        grown = np.where(there, np.exp(np.minimum(self._ratios.max(axis=0) - 1.0, MOST_GROWN) * share), 1.0)
        self._casing = np.clip(self._casing * grown, LEAST_CASING_SD**2, CASING_SD**2)

    def take(self, y: Floats) -> tuple[Floats, Floats]:
        """Include the readings of a step of some ticks.

        Parameters
        ----------
        y : ndarray (ticks, S, m), °C
            NaN without a reading.

        Returns
        -------
        mean, variance : ndarray (S, m), °C, K²
            Of each thermocouple; NaN without a reading.
        """
        there = np.isfinite(y)
        number = there.sum(axis=0)
        divisor = np.where(number > 0, number, np.nan)
        mean = np.where(there, y, 0.0).sum(axis=0) / divisor
        for now in y:  # steps are visible between rare frames too
            stands = np.abs(now - self._all.newest) <= SAME
            self._repeats += stands
            self._follow(np.asarray(stands, np.bool_), np.isfinite(now))
            self._all.take(now)
            self._stairs.take(np.where(stands, now, np.nan))
        change = np.abs(np.diff(np.concatenate((self._last[None], y)), axis=0))
        both = np.isfinite(change)
        square = np.where(both, np.square(change), 0.0).sum(axis=0) / 2.0
        self._noise = self._noise + (square - both.sum(axis=0) * self._noise) * NOISE_SHARE
        self._last = np.where(there[-1], y[-1], np.nan)
        step2 = np.square(self.step)
        coarse = np.where(step2 / 6.0 > self._noise, step2, step2 / 12.0 / divisor)
        casing = np.where(self._calm[:, None], self._casing[1], self._casing[0])
        return mean, np.maximum(self._noise, READING_SD**2) / divisor + coarse + casing

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a restart: steps, K, noise and error, K², and newest readings, °C."""
        step = np.where(self._in_stairs, self._stairs.common, self._all.common)
        named = {"step": step, "noise": self._noise, "newest": self._all.newest}
        named |= {"driven": self._casing[0], "rest": self._casing[1]}
        return {k: [[x if np.isfinite(x) else None for x in row] for row in v.tolist()] for k, v in named.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a snapshot.

        Raises
        ------
        KeyError, TypeError, ValueError
            `state` is not such a snapshot, or belongs to other strings.
        """
        step, noise, newest = (np.array(state[k], np.float64) for k in ("step", "noise", "newest"))  # None is NaN
        if not step.shape == noise.shape == newest.shape == self._noise.shape or not (noise >= 0.0).all():
            raise ValueError("heat: not of these strings")
        error = [np.array(state.get(k, x), np.float64) for k, x in zip(("driven", "rest"), self._casing, strict=True)]
        if not all(x.shape == noise.shape and (x >= 0.0).all() for x in error):  # states of older versions have none
            raise ValueError("heat: not of these strings")
        self._casing = np.clip(error, LEAST_CASING_SD**2, CASING_SD**2)
        self._noise = noise
        for values in (self._all, self._stairs):
            values.common, values.newest = np.where(step > 0.0, step, np.inf), newest
            values.changes = np.where(step > 0.0, ENOUGH, 0)


class CommonStep:
    """The common step of the values that each thermocouple reads.

    Attributes
    ----------
    newest : ndarray (S, m), °C
        The last value; NaN before the first.
    common : ndarray (S, m), K
        Greatest common divisor of all changes; infinite before the first.
    changes : ndarray (S, m)
        Number of changes.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.newest = np.full(shape, np.nan)
        self.common, self._whole = np.full((2, *shape), np.inf)
        self.changes = np.zeros(shape, np.int64)

    @property
    def most(self) -> Floats:
        """Greatest step (S, m), K, that is consistent with the values."""
        together = np.minimum(self._whole.min(axis=1, keepdims=True), COARSEST)
        return np.where(self.changes < ENOUGH, together, COARSEST)

    @property
    def step(self) -> Floats:
        """Steps of the values (S, m), K; 0 if unknown."""
        return np.where(np.isfinite(self.common), np.minimum(self.common, self.most), 0.0)

    def take(self, now: Floats) -> None:
        """Include values (S, m), °C, NaN for none."""
        moved = np.abs(now - self.newest)
        changed = moved > SAME
        self.common = finer(self.common, moved, changed)
        self._whole = finer(self._whole, np.abs(now), self.changes < ENOUGH)
        self.changes += changed
        self.newest = np.where(np.isfinite(now), now, self.newest)


def finer(step: Floats, x: Floats, asked: Bools) -> Floats:
    """Make steps divide `x` too, where `asked`; nearly always they do already, which is checked fast.

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
    # each round of Euclid's algorithm multiplies the error of the last round: the reading itself is exact
    exact = np.where(times != 0.0, x / np.where(times != 0.0, times, 1.0), found)
    return np.where(asked, exact, step)


def common_divisor(a: Floats, b: Floats) -> Floats:
    """Greatest common divisor of `a` and `b`, K, to `SAME` (Euclid); if one is infinite or NaN, the other.

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
