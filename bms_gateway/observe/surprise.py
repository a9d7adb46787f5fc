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
from math import exp
from typing import Any, Final

import numpy as np

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
FINE_K: Final = 1e-4
"""Differences of readings below are rounding."""


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
        self._last, self._fine = np.full(sensors.shape, np.nan), np.full(sensors.shape, np.inf)
        times = np.maximum(np.array(TIMES_S), dt)[:, None, None]
        self._rough = np.full(sensors.shape, noise**2)
        self._wide = np.zeros(self._mean.shape)  # K², of the averages: by states that the filter itself knew badly
        self._settles = np.zeros(len(sensors))
        self._coolant = np.full(len(sensors), np.nan)
        self._before, self._count = np.zeros((2, *sensors.shape))
        self._off, self._step = np.full(self._mean.shape, OFF_K), np.zeros(sensors.shape)
        self._share = -np.expm1(-dt / times)
        self._white = self._share / (2.0 - self._share)  # variance of an average over that of one innovation
        self._times, self._calm = times, exp(-dt / CALM_S)
        self._grows = 2.0 * LASTS_S * dt  # s²: variance by own², of heat that lasts so long
        self.set_parameters(parameters)

    def set_parameters(self, parameters: Sequence[StringParameters]) -> None:
        """Take other numbers of the strings into use."""
        R_c, C_s, R_u = (np.stack([getattr(p, k) for p in parameters]) for k in ("R_c", "C_s", "R_u"))
        row = np.arange(len(parameters))[:, None]
        lag, ratio = (R_c * C_s)[row, self._sensors], (R_c / R_u)[row, self._sensors]
        self._lag, self._ratio = lag / self._dt, 1.0 + ratio

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
        settled = self._settles <= 0.0
        there = (value == value) & (np.logical_and.reduce(inputs, axis=1) & settled)[:, None]
        self._settles = np.where(settled, 0.0, self._settles - self._dt)
        value = np.where(there, value, 0.0)
        self._mean += self._share * (value - self._mean)
        self._follow(y, there)
        var = np.where(there, np.square(sd), 1.0)
        turn = np.square(value - self._before) / 2.0  # noise turns each time, what is odd does not
        self._count += there
        self._rough += np.where(there, np.maximum(NOISE_SHARE, 1.0 / (FIRST + self._count)) * (turn - self._rough), 0.0)
        self._before = np.where(there, value, self._before)
        wide = np.where(there & (var > UNSURE**2 * self._rough), var, 0.0)
        self._wide += self._share * (self._share * wide - (2.0 - self._share) * self._wide)
        vague = np.where(there, np.square(known) - var, 0.0)
        chance = np.sqrt(self._rough * self._white + self._wide + np.maximum(vague, 0.0))
        rounded = ROUNDED * np.maximum(self._step - BLURS * np.sqrt(self._rough), 0.0)
        self._coolant = np.where(np.isnan(self._coolant), inlet, self._coolant)
        self._coolant = self._coolant + (inlet - self._coolant) * self._share[-1, 0, 0]
        stirred = STIRRED * np.abs(inlet - self._coolant)[:, None]
        odd = there & (np.abs(self._mean) > ODD * chance + self._off + rounded + stirred)
        at_once = np.zeros_like(self.own)
        if odd.any():
            gain = np.maximum(0.0, 1.0 - self._noise**2 / var)
            off = np.where(odd, (self._lag * gain + self._ratio) * np.abs(self._mean), 0.0)
            at_once = np.where(self.own == 0.0, np.square(off.max(axis=0)), 0.0)
            self.own = np.maximum(self.own * self._calm, MORE * (off / self._times).max(axis=0))
        elif self.open.any():
            self.own = self.own * self._calm
        else:
            return None
        self.own[self.own < LEAST_K_S] = 0.0
        self.open = np.asarray((self.own > 0.0).any(axis=1), dtype=np.bool_)
        return at_once + self._grows * np.square(self.own)

    def _follow(self, y: Floats, there: Bools) -> None:
        """Find out the steps that readings come in."""
        step = np.abs(y - self._last)
        self._last = np.where(there, y, self._last)
        finer = (step > FINE_K) & (step < self._fine)
        if finer.any():
            self._fine = np.where(finer, step, self._fine)
            self._coarse()

    def _coarse(self) -> None:
        self._step = np.where(self._fine < np.inf, self._fine, 0.0)
        self._off = OFF_K + STEPS * self._step

    def snapshot(self) -> dict[str, Any]:
        """Return it as numbers and lists."""
        return {name.strip("_"): plain(getattr(self, name)) for name in _KEPT}

    def restored(self, snapshot: Mapping[str, Any] | None) -> "Surprise":
        """Make one like this from a snapshot; None, as older states have, knows nothing yet.

        Raises
        ------
        KeyError, TypeError, ValueError
            It is none of as many sensors.
        """
        new = copy(self)
        if snapshot is None:
            new.own, new._mean, new._wide = (
                np.zeros_like(self.own),
                np.zeros_like(self._mean),
                np.zeros_like(self._mean),
            )
            new.open = np.zeros_like(self.open)
            return new
        taken = {name: like(snapshot[name.strip("_")], getattr(self, name)) for name in _KEPT}
        numbers = [taken[k] for k in _KEPT if k not in ("_last", "_fine", "_coolant")]
        if not all(np.isfinite(a).all() for a in numbers) or (taken["own"] < 0.0).any() or (taken["_wide"] < 0.0).any():
            raise ValueError("surprise: holds what is no number")
        taken["_fine"] = np.where(np.isnan(taken["_fine"]), np.inf, taken["_fine"])
        for name, value in taken.items():
            setattr(new, name, value)
        new.open = np.asarray((new.own > 0.0).any(axis=1), dtype=np.bool_)
        new._coarse()
        return new


_KEPT = ("own", "_settles", "_mean", "_last", "_fine", "_rough", "_wide", "_before", "_count", "_coolant")
