r"""Readings that contradict the model: the core of that cell may then be wherever these readings point.

A filter explains unexpected readings by the common offsets of inlet and heat, however unlikely their values, and its
uncertainty of the cores does not grow. Therefore the innovations of each thermocouple are averaged over seconds and
over a minute. If an average is far from zero, the surface takes up heat that the model does not know. If that heat were
made in the core, the surface's balance would give a core error of

.. math::
    e_c = (R_c C_s K_s / \Delta t + 1 + R_c / R_u) \, \bar\nu

with the gain :math:`K_s` of the surface, which each step has moved by K_s ν̄. The variance of that core grows by
:math:`e_c^2` at once. It then grows as by heat of the cell's own of :math:`C_c e_c / \tau` watts (τ: time of the
average), until the innovations have been normal for minutes. The filter itself then separates what belongs to the core
from what is common to the string.

Beyond Lin et al., whose observer has one constant gain.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from math import exp, sqrt
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.observe.model import Bools, Ints
from bms_gateway.observe.stored import like, plain
from bms_gateway.thermal import Floats, StringParameters

TIMES_S: Final = (4.0, 20.0, 60.0)
"""Averaging times of the innovations: hundreds of watts are seen in seconds, ten watts within a minute."""
ODD: Final = 5.0
"""Standard deviations from zero from which an average is odd: those of white innovations reach 4."""
OFF_K: Final = 0.02
"""Tolerance of the averages, because no model is more exact; and the part of it in steps of the readings:"""
STEPS: Final = np.array([0.2, 0.1, 0.05])[:, None, None]
ROUNDED: Final = np.array([0.5, 0.4, 0.25])[:, None, None]
"""Additional share of the part of a step that noise does not blur: a constant reading errs in one direction."""
BLURS: Final = 2.0
"""A step of this many standard deviations of the noise is blurred."""
STIRRED: Final = 0.1
"""Share of the coolant's change within a minute by which an innovation may be off: a film is not known better."""
LATE: Final = 0.35
"""Share of that change which the cells have not felt yet: coolant comes late through hoses and plenums."""
COARSEST_K: Final = 1.5
"""Coarsest step of temperatures on a bus; a reading that moves by more each time has a loose contact."""
LASTS_S: Final = 10.0
"""Time for which the own heat of a cell stays about the same."""
MORE: Final = 3.0
"""Factor on the heat that explains the mean innovation, because the innovation is still growing."""
CALM_S: Final = 90.0
"""Time constant with which own heat is believed to end while the innovations are normal, s."""
LEAST_K_S: Final = 2e-3
"""K/s of the core: heat below is what filters reckon with anyway."""
SETTLES_S: Final = 30.0
"""s after new numbers in which nothing counts as odd: the filter first finds the state that fits them."""
UNSURE: Final = 3.0
"""An innovation above this multiple of the noise shows that the state was not known, as after a gap."""
NOISE_SHARE: Final = 0.005
"""Share of each innovation in the learnt noise of its sensor, which may differ from the filter's noise."""
FIRST: Final = 2.0
"""Number of readings for which the filter's own noise counts at the start."""
BLOCK: Final = 8
"""Steps after which noise, steps of the readings and the coolant's mean are learnt together …"""
YOUNG: Final = 60
"""… but after each step while a sensor has fewer readings than this."""
GONE_K2: Final = 1e-8
"""Least variance, K²; a smaller one is treated as zero."""
MOST_K: Final = 200.0
"""Upper limit for averages of innovations, K, and rates, K/s."""
CORE_K: Final = 300.0
"""Upper limit of the sd of a core: more than that no core and its surface differ, even in a thermal runaway."""
FINE_K: Final = 1e-4
"""Smaller differences of readings are rounding."""


def possible(grown: Floats, variance: Floats) -> Floats:
    """Limit the growth of the variances of cores, K², so that none grows beyond `CORE_K`.

    A thermocouple that comes off moves by 20 K at once. Heat in the core would need thousands of kelvins for that.
    """
    return np.minimum(grown, np.maximum(CORE_K**2 - variance, 0.0))


class SensorNoise:
    """Noise of m thermocouples of S strings, learnt from innovations and readings, and the coolant's mean.

    Steps wait until a block of them is full, and are then learnt from together.

    Parameters
    ----------
    shape : (int, int)
        S, m.
    dt : float, s
    noise : float, K
        White noise of a reading, as in the filter.

    Attributes
    ----------
    fine : ndarray (S, m), K
        Smallest step of the readings; infinite if none was seen: then their resolution is not known.
    rough : ndarray (S, m), K²
        Variance of an innovation that contains only noise.
    coolant : ndarray (S,), °C
        Mean of the coolant over the last minute.
    """

    def __init__(self, shape: tuple[int, ...], dt: float, noise: float) -> None:
        self._dt = dt
        nothing = np.zeros(shape)  # the first innovation counts as noise in full
        # newest reading, newest counted innovation
        self._last = np.stack((np.full_like(nothing, np.nan), nothing))
        self.fine = np.full(shape, np.inf)
        self.rough, self._count = np.full(shape, noise**2), np.zeros(shape)
        self.coolant = np.full(shape[0], np.nan)
        self._waiting = np.full((BLOCK, 2, *shape), np.nan)
        self._waits, self._young = 0, True  # whether some sensor may be young
        self._noise, self._held, self._some_coarse = noise, np.full(shape, np.nan), True  # newest readings, if coarse

    def take(self, y: Floats, value: Floats, there: Bools) -> bool:
        """Store readings and innovations of a step; `there`: which of them count. Return whether to `learn` now."""
        waiting = self._waiting[self._waits]
        waiting[0] = y
        waiting[1] = np.where(there, value, np.nan)
        self._waits += 1
        return self._waits == BLOCK or (self._young and bool((there & (self._count < YOUNG)).any()))

    def finer(self, y: Floats) -> bool:
        """Return whether a coarse sensor, or one whose steps are unknown, has made its smallest step so far."""
        if not self._some_coarse:
            return False
        step = np.abs(y - self._held)
        self._held = np.where(np.isnan(y), self._held, y)
        less = (step > FINE_K) & (step < self.fine) & (self.fine > self._noise)
        if not less.any():
            return False
        self.fine = np.where(less, step, self.fine)
        self._some_coarse = bool((self.fine > self._noise).any())
        return True

    def learn(self, inlet: Floats) -> None:
        """Learn the noise of the sensors, the steps of their readings and the coolant's mean from a block of steps."""
        filled = self._waiting[: self._waits].copy()
        turned = np.isfinite(filled)
        for k, before in enumerate((self._last, *filled[:-1])):  # a sensor may be read in some steps only
            filled[k] = np.where(turned[k], filled[k], before)
        y, value = np.abs(np.diff(np.concatenate((self._last[None], filled)), axis=0)).swapaxes(0, 1)
        self.fine = np.minimum(self.fine, np.where(y > FINE_K, y, np.inf).min(axis=0))
        self._last = filled[-1]
        there = turned[:, 1] & np.isfinite(value)
        n = there.sum(axis=0)
        self._count += n
        self._young = bool((self._count < YOUNG).any())
        share = np.maximum(1.0 - (1.0 - NOISE_SHARE) ** n, n / (FIRST + self._count))
        turn = np.where(there, np.square(value) / 2.0, 0.0)  # noise changes its sign each time, odd heat does not
        self.rough += share * (turn.sum(axis=0) / np.maximum(n, 1) - self.rough)
        before = np.where(np.isnan(self.coolant), inlet, self.coolant)
        self.coolant = before - (inlet - before) * np.expm1(-self._waits * self._dt / TIMES_S[-1])
        self._waiting[:], self._waits = np.nan, 0

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _LEARNT} | {"waits": self._waits}

    def restored(self, snapshot: Mapping[str, Any] | None) -> "SensorNoise":
        """Create an object like this from a snapshot; None copies this one.

        Raises
        ------
        KeyError, TypeError, ValueError
            `snapshot` is not a snapshot of as many sensors.
        """
        new = copy(self)
        if snapshot is None:
            for name in _LEARNT:
                setattr(new, name, getattr(self, name).copy())
            return new
        taken = {name: like(snapshot[name.strip("_")], getattr(self, name)) for name in _LEARNT}
        waits = snapshot["waits"]
        if not all(np.isfinite(taken[name]).all() for name in ("rough", "_count")):
            raise ValueError("surprise: holds what is no number")
        if type(waits) is not int or not 0 <= waits < BLOCK:
            raise ValueError("surprise: waits for no block")
        taken["fine"] = np.where(np.isnan(taken["fine"]), np.inf, taken["fine"])
        for name, value in taken.items():
            setattr(new, name, value)
        new._waits, new._young = waits, True
        new._held, new._some_coarse = new._last[0], True
        for row in new._waiting[:, 0]:
            new._held = np.where(np.isnan(row), new._held, row)
        return new


class Surprise:
    """Innovations of m thermocouples of S strings, and what they imply for the cores.

    Parameters
    ----------
    parameters : sequence of StringParameters
    sensors : ndarray of int (S, m)
        0-based cells.
    dt : float, s
        Step.
    noise : float, K
        White noise of a reading, as in the filter.

    Attributes
    ----------
    own : ndarray (S, m), K/s
        Rate at which heat of the cell's own may warm its core.
    open : ndarray of bool (S,)
        Strings with such a cell.
    """

    def __init__(self, parameters: Sequence[StringParameters], sensors: Ints, dt: float, noise: float) -> None:
        self._sensors, self._dt, self._noise = sensors, dt, noise
        self.own = np.zeros(sensors.shape)
        self.open: Bools = np.zeros(len(sensors), np.bool_)
        self._mean = np.zeros((len(TIMES_S), *sensors.shape))
        self._wide = np.zeros(self._mean.shape)  # K², of the averages: from uncertain states
        self._sensed = SensorNoise(sensors.shape, dt, noise)
        self._settles = np.zeros(len(sensors))
        times = np.maximum(np.array(TIMES_S), dt)[:, None, None]
        self._share = -np.expm1(-dt / times)
        self._white = self._share / (2.0 - self._share)  # variance of an average over that of one innovation
        self._times = times
        self._judge()
        self.set_parameters(parameters)

    def set_parameters(self, parameters: Sequence[StringParameters]) -> None:
        """Take other numbers of the strings into use."""
        R_c, C_s, R_u = (np.stack([getattr(p, k) for p in parameters]) for k in ("R_c", "C_s", "R_u"))
        self._of_cells = R_c * C_s / self._dt, 1.0 + R_c / R_u, self._dt / (R_u * C_s)
        self._weigh()

    def _weigh(self) -> None:
        """Take lag, ratio and share of the coolant in a step of the sensed cells from those of all."""
        row = np.arange(len(self._sensors))[:, None]
        self._of_sensed = tuple(a[row, self._sensors] for a in self._of_cells)

    def move(self, sensors: Ints) -> None:
        """Set the cells (S, m) of the sensors."""
        if not np.array_equal(sensors, self._sensors):
            self._sensors = sensors
            self._weigh()

    def assign(self, source: NDArray[np.int8], said: Floats) -> None:
        """Do nothing: each reading here always belongs to one cell; see `StatisticSurprise.assign`."""

    def settle(self, s: int) -> None:
        """Give string `s` time to find the state that fits new numbers."""
        self._mean[:, s], self._settles[s] = 0.0, SETTLES_S

    def step(self, y: Floats, value: Floats, sd: Floats, known: Floats, inputs: Bools, inlet: Floats) -> Floats | None:
        """Use the innovations of a step.

        Parameters
        ----------
        y : ndarray (S, m), °C
            Readings; NaN where there is none.
        value, sd : ndarray (S, m), K
            Innovations, NaN without a reading; their standard deviations if the numbers were exact.
        known : ndarray (S, m), K
            Their standard deviations with the uncertainty of the numbers.
        inputs : ndarray of bool (S, 2)
            Whether inlet and current were measured; if not, nothing is odd.
        inlet : ndarray (S,), °C

        Returns
        -------
        ndarray (S, m), K², or None
            Growth of the variances of the cores in this step; None if no core's grows, as nearly always.
        """
        there = value == value
        if self._settles.any() or not inputs.all():
            settled = self._settles <= 0.0
            there &= (np.logical_and.reduce(inputs, axis=1) & settled)[:, None]
            self._settles = np.where(settled, 0.0, self._settles - self._dt)
        finer = self._sensed.finer(y)
        if self._sensed.take(y, value, there):
            self._sensed.learn(inlet)
            self._judge()
        elif finer:
            self._judge()
        value = np.where(there, value, 0.0)
        self._mean += self._share * (value - self._mean)
        unsure = there & (sd > self._unsure)
        if self._wide.any() or unsure.any():
            wide = np.where(unsure, np.square(sd), 0.0)
            self._wide += self._share * (self._share * wide - (2.0 - self._share) * self._wide)
            self._wide[self._wide < GONE_K2] = 0.0
        grown = None
        off = np.abs(self._mean)
        if self.open.any() or (off > self._least).any():
            grown = self._grown(np.where(there, off, 0.0), sd, known, inlet)
        return grown

    def _grown(self, off: Floats, sd: Floats, known: Floats, inlet: Floats) -> Floats | None:
        """Growth of the variances of the cores where averages lie `off` (3, S, m), K, from zero."""
        var = np.square(sd)
        vague = np.maximum(np.square(known) - var, 0.0)  # NaN after a step without a reading: nothing is odd then
        chance = np.sqrt(self._sensed.rough * self._white + self._wide + vague)
        moved = np.where(np.isnan(self._sensed.coolant), 0.0, np.abs(inlet - self._sensed.coolant))
        lag, ratio, by_coolant = self._of_sensed
        gain = np.maximum(0.0, 1.0 - self._noise**2 / var)
        # what late coolant does in a step is taken up by the gain, so that much of it stays in the innovations
        late = by_coolant / np.maximum(gain, by_coolant)
        odd = off > ODD * chance + self._beside + np.maximum(STIRRED, LATE * late) * moved[:, None]
        at_once, calm = np.zeros_like(self.own), exp(-self._dt / CALM_S)
        if odd.any():
            core = np.where(odd, (lag * gain + ratio) * off, 0.0)
            at_once = np.where(self.own == 0.0, np.square(core.max(axis=0)), 0.0)
            self.own = np.maximum(self.own * calm, MORE * (core / self._times).max(axis=0))
        elif self.open.any():
            self.own = self.own * calm
        else:
            return None
        self.own[self.own < LEAST_K_S] = 0.0
        self.open = np.asarray((self.own > 0.0).any(axis=1), dtype=np.bool_)
        return at_once + 2.0 * LASTS_S * self._dt * np.square(self.own)  # of heat that lasts this long

    def rounded(self, sd: Floats) -> Floats:
        """Widen standard deviations `sd` (S, m) of innovations by the steps of readings that noise does not blur."""
        return np.hypot(sd, self._rounding) if self._coarse else sd

    def _judge(self) -> None:
        """Compute the limits above which averages and deviations are odd, from the learnt noise of the sensors."""
        step, rough = self._sensed.fine, self._sensed.rough  # infinite before the first step: nothing is odd then
        self._rounding = np.where((step > self._noise) & (step <= COARSEST_K), step, 0.0) / sqrt(12.0)
        self._coarse = bool(self._rounding.any())
        rounded = ROUNDED * np.maximum(step - BLURS * np.sqrt(rough), 0.0)
        self._beside = OFF_K + STEPS * step + rounded
        self._least = ODD * np.sqrt(rough * self._white) + self._beside  # other tolerances
        self._unsure = UNSURE * np.sqrt(rough)

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _KEPT} | self._sensed.snapshot()

    def restored(self, snapshot: Mapping[str, Any] | None) -> "Surprise":
        """Create an object like this from a snapshot; None, as in states of older versions, starts without knowledge.

        Raises
        ------
        KeyError, TypeError, ValueError
            `snapshot` is not a snapshot of as many sensors.
        """
        new = copy(self)
        new._sensed = self._sensed.restored(snapshot)
        if snapshot is None:
            new._settles = self._settles.copy()
            for name in ("own", "open", "_mean", "_wide"):
                setattr(new, name, np.zeros_like(getattr(self, name)))
            return new
        taken = {name: like(snapshot[name.strip("_")], getattr(self, name)) for name in _KEPT}
        if not all(np.isfinite(a).all() for a in taken.values()) or any(
            (taken[k] < 0.0).any() for k in ("own", "_wide")
        ):
            raise ValueError("surprise: holds what is no number")
        if any(
            (np.abs(taken[name]) > most).any()
            for name, most in (("_mean", MOST_K), ("own", MOST_K), ("_wide", MOST_K**2))
        ):
            raise ValueError("surprise: holds what no reading is off by")
        for name, value in taken.items():
            setattr(new, name, value)
        new.open = np.asarray((new.own > 0.0).any(axis=1), dtype=np.bool_)
        new._judge()
        return new


_KEPT = ("own", "_settles", "_mean", "_wide")
_LEARNT = ("_last", "fine", "rough", "_count", "coolant", "_waiting")
"""Fields that the snapshots of both contain."""
