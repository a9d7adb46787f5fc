r"""What readings say against everything that is believed of a cell: its core may then be anywhere that they point to.

A filter takes what it cannot explain for an offset of the inlet or of the heat in common, however far these lie beyond
their prior, and stays as sure of the cores as before. So the innovations of each thermocouple are averaged over seconds
and over a minute. Where an average is far from zero, the surface takes up heat that the model does not know. Were that
heat made in the core, then by the surface's balance the core would be off by

.. math::
    e_c = (R_c C_s K_s / \Delta t + 1 + R_c / R_u) \, \bar\nu

with the gain :math:`K_s` of the surface, which has been moved by K_s ν̄ in each step. The variance of that core grows by
:math:`e_c^2` at once, and then as heat of the cell's own makes it grow, of :math:`C_c e_c / \tau` watts where τ is the
time of the average, until nothing has been odd for minutes. The filter then finds out by itself what belongs to the
core, and what is common stays common.

Beyond Lin et al., whose observer has one gain for ever.
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
"""Over how long innovations are averaged: hundreds of watts are seen in seconds, ten watts within a minute."""
ODD: Final = 5.0
"""Averages so many standard deviations from zero are no chance: white ones come to 4."""
OFF_K: Final = 0.02
"""What averages may be off beside, for no model is true to less; and a share of the step of the readings:"""
STEPS: Final = np.array([0.2, 0.1, 0.05])[:, None, None]
ROUNDED: Final = np.array([0.5, 0.4, 0.25])[:, None, None]
"""Share, beside, of the part of a step that noise does not blur: a reading that stands still errs in one direction."""
BLURS: Final = 2.0
"""A step of so many standard deviations of the noise is blurred."""
STIRRED: Final = 0.1
"""Share of what the coolant has moved by within a minute, for a film is known to no better."""
COARSEST_K: Final = 1.5
"""No bus sends temperatures in coarser steps: what moves by more each time is a loose contact."""
LASTS_S: Final = 10.0
"""For how long heat of a cell's own is about as great as it was."""
MORE: Final = 3.0
"""By how much more it may be than it takes to be off by so much after the time of an average: it goes on growing."""
CALM_S: Final = 90.0
"""How soon it is believed to be over while nothing is odd, e-folding."""
LEAST_K_S: Final = 2e-3
"""K/s of the core: heat below is what filters reckon with anyway."""
SETTLES_S: Final = 30.0
"""For which after other numbers have come into use nothing is odd: the filter first finds the state that fits them."""
UNSURE: Final = 3.0
"""An innovation that may be so many times the noise says what the state was not known to, as after a gap."""
NOISE_SHARE: Final = 0.005
"""Of what each innovation tells of its sensor's noise, which may be less or more than the filter reckons with."""
FIRST: Final = 2.0
"""Readings that what the filter reckons with counts as, at the start."""
BLOCK: Final = 8
"""Steps after which noise, steps of the readings and the coolant's mean are learnt together …"""
YOUNG: Final = 60
"""… but at once of sensors that have been read less often."""
GONE_K2: Final = 1e-8
"""K²: a variance below is none."""
MOST_K: Final = 200.0
"""No average of innovations, and no rate in K/s, is as large."""
FINE_K: Final = 1e-4
"""Differences of readings below are rounding."""


class SensorNoise:
    """What innovations and readings of m thermocouples of S strings tell of their noise and of the coolant.

    Steps wait until a block of them is full, and are then learnt from together.

    Parameters
    ----------
    shape : (int, int)
        S, m.
    dt : float, s
    noise : float, K
        White noise of a reading, as the filter has it.

    Attributes
    ----------
    fine : ndarray (S, m), K
        Smallest step of the readings; infinite where none was seen: then nothing tells how coarse they are.
    rough : ndarray (S, m), K²
        Variance of an innovation that is only noise.
    coolant : ndarray (S,), °C
        Mean of the coolant over the last minute.
    """

    def __init__(self, shape: tuple[int, ...], dt: float, noise: float) -> None:
        self._dt = dt
        nothing = np.zeros(shape)  # what the first innovation is off counts as noise
        # newest reading, newest innovation that counted
        self._last = np.stack((np.full_like(nothing, np.nan), nothing))
        self.fine = np.full(shape, np.inf)
        self.rough, self._count = np.full(shape, noise**2), np.zeros(shape)
        self.coolant = np.full(shape[0], np.nan)
        self._waiting = np.full((BLOCK, 2, *shape), np.nan)
        self._waits, self._young = 0, True  # whether some sensor may be young
        self._noise, self._held, self._some_coarse = noise, np.full(shape, np.nan), True  # newest readings, if coarse

    def take(self, y: Floats, value: Floats, there: Bools) -> bool:
        """Let a step wait: readings and innovations, and `there`, which of these count. Whether to `learn` now."""
        waiting = self._waiting[self._waits]
        waiting[0] = y
        waiting[1] = np.where(there, value, np.nan)
        self._waits += 1
        return self._waits == BLOCK or (self._young and bool((there & (self._count < YOUNG)).any()))

    def finer(self, y: Floats) -> bool:
        """Tell whether a sensor whose steps noise does not blur, or have not been seen, has moved by less than ever."""
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
        turn = np.where(there, np.square(value) / 2.0, 0.0)  # noise turns each time, what is odd does not
        self.rough += share * (turn.sum(axis=0) / np.maximum(n, 1) - self.rough)
        before = np.where(np.isnan(self.coolant), inlet, self.coolant)
        self.coolant = before - (inlet - before) * np.expm1(-self._waits * self._dt / TIMES_S[-1])
        self._waiting[:], self._waits = np.nan, 0

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _LEARNT} | {"waits": self._waits}

    def restored(self, snapshot: Mapping[str, Any] | None) -> "SensorNoise":
        """Make one like this from a snapshot; None copies it.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of as many sensors.
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
    """Innovations of m thermocouples of S strings, and what they say of the cores.

    Parameters
    ----------
    parameters : sequence of StringParameters
    sensors : ndarray of int (S, m)
        0-based cells.
    dt : float, s
        Step.
    noise : float, K
        White noise of a reading, as the filter has it.

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
        self._wide = np.zeros(self._mean.shape)  # K², of the averages: by states that the filter itself knew badly
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
        self._of_cells = R_c * C_s / self._dt, 1.0 + R_c / R_u
        self._weigh()

    def _weigh(self) -> None:
        """Take lag and ratio of the sensed cells from those of all."""
        row = np.arange(len(self._sensors))[:, None]
        self._lag, self._ratio = (a[row, self._sensors] for a in self._of_cells)

    def move(self, sensors: Ints) -> None:
        """Let the sensors be at other cells (S, m)."""
        if not np.array_equal(sensors, self._sensors):
            self._sensors = sensors
            self._weigh()

    def assign(self, source: NDArray[np.int8], said: Floats) -> None:
        """Leave it: each reading here is of one cell for ever; see `StatisticSurprise.assign`."""

    def settle(self, s: int) -> None:
        """Let string `s` find the state that fits other numbers."""
        self._mean[:, s], self._settles[s] = 0.0, SETTLES_S

    def step(self, y: Floats, value: Floats, sd: Floats, known: Floats, inputs: Bools, inlet: Floats) -> Floats | None:
        """Take in the innovations of a step.

        Parameters
        ----------
        y : ndarray (S, m), °C
            Readings; NaN where there is none.
        value, sd : ndarray (S, m), K
            Innovations, NaN where nothing was read; and what they should be, the numbers taken for true.
        known : ndarray (S, m), K
            What they should be with all that is not known of the numbers.
        inputs : ndarray of bool (S, 2)
            Whether inlet and current were measured: without them nothing is odd.
        inlet : ndarray (S,), °C

        Returns
        -------
        ndarray (S, m), K², or None
            What the variances of the cores grow by in this step; None where none does, as nearly always.
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
        """Tell what the variances of the cores grow by where averages lie `off` (3, S, m), K, from zero."""
        var = np.square(sd)
        vague = np.maximum(np.square(known) - var, 0.0)  # NaN after a step without a reading: then nothing is odd
        chance = np.sqrt(self._sensed.rough * self._white + self._wide + vague)
        moved = np.where(np.isnan(self._sensed.coolant), 0.0, np.abs(inlet - self._sensed.coolant))
        odd = off > ODD * chance + self._beside + STIRRED * moved[:, None]
        at_once, calm = np.zeros_like(self.own), exp(-self._dt / CALM_S)
        if odd.any():
            gain = np.maximum(0.0, 1.0 - self._noise**2 / var)
            core = np.where(odd, (self._lag * gain + self._ratio) * off, 0.0)
            at_once = np.where(self.own == 0.0, np.square(core.max(axis=0)), 0.0)
            self.own = np.maximum(self.own * calm, MORE * (core / self._times).max(axis=0))
        elif self.open.any():
            self.own = self.own * calm
        else:
            return None
        self.own[self.own < LEAST_K_S] = 0.0
        self.open = np.asarray((self.own > 0.0).any(axis=1), dtype=np.bool_)
        return at_once + 2.0 * LASTS_S * self._dt * np.square(self.own)  # of heat that lasts so long

    def rounded(self, sd: Floats) -> Floats:
        """Widen what innovations should be, `sd` (S, m), by the steps of readings that noise does not blur."""
        return np.hypot(sd, self._rounding) if self._coarse else sd

    def _judge(self) -> None:
        """Reckon what averages and deviations are no chance, by what is known of the sensors."""
        step, rough = self._sensed.fine, self._sensed.rough  # infinite before the first: then nothing is odd
        self._rounding = np.where((step > self._noise) & (step <= COARSEST_K), step, 0.0) / sqrt(12.0)
        self._coarse = bool(self._rounding.any())
        rounded = ROUNDED * np.maximum(step - BLURS * np.sqrt(rough), 0.0)
        self._beside = OFF_K + STEPS * step + rounded
        self._least = ODD * np.sqrt(rough * self._white) + self._beside  # whatever else is not known
        self._unsure = UNSURE * np.sqrt(rough)

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _KEPT} | self._sensed.snapshot()

    def restored(self, snapshot: Mapping[str, Any] | None) -> "Surprise":
        """Make one like this from a snapshot; None, as older states have, knows nothing yet.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of as many sensors.
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
"""What snapshots hold of both."""
