"""How strings have been doing of late, all at once: what says which of them must be looked at by itself."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp

import numpy as np

from bms_gateway.health.heat.balances import MOST_LOSS
from bms_gateway.health.heat.filter import HeatFilter
from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats

LEAP_K, LEAP_S, SOUND_INLET = 1.0, 900.0, -6.0
"""An inlet whose reading leaps so far in a step may be wrong for so long. One that neither leaps nor stands still is
sound for all that its reading says: ln of how much less likely its fault then is."""
MISSING, MISSING_SURE, MISSING_BACK = 0.35, 2.5, 0.5
"""Share of its heat that the current makes at most, with so many sd on top, where not credible; where it is again."""
COLD = -0.25
"""Share below which no current that is wrong takes it: cells that cool so are cooled by something else."""
WARMS_K, WARMS_ALONE_K = 0.7, 2.8
"""Warming of the cells, by the current believed, before its lack says anything; and with fewer than three sensors."""
COOLING, COOLING_BACK, COOLING_GRAVE = 0.5, 0.35, 1.5
"""Growth of R_u against the identified that is told, that is over, and that is an alarm."""
FLOW_USUAL_S, FLOW_SURE, FLOW_GRAVE = 3600.0, 3.0, 6.0
"""How long the films are remembered against which growth is told, and sd of it: where the films have changed at once,
and where they are so much worse that it does not matter how fast."""
FROZEN_S, FROZEN_K = 300.0, 0.8
"""An inlet that reads the same for so long, while the cells say that it moved by so much, is frozen."""
FOUND_STEPS = 60
"""Steps after a sleep in which the offset of the inlet is found."""
USUAL_LN, USUAL_S, USUAL_FIRST = 2.5, 1800.0, 4.5
"""Mean of the greatest ln evidence in sound strings whose model is good; over how long it is taken; and what it begins
with, as nobody knows how good the model is. Where it is more the model is worse, and all evidence counts less."""
VAGUE_DOUBT = 2.5
"""What evidence is divided by where a string has fewer than three sensors, so that its model is all it is held against,
or where nobody measures its coolant."""


@dataclass(slots=True)
class Course:
    """How S strings of n cells have been doing, all at once.

    Attributes
    ----------
    constant_inlet : ndarray of bool (S,)
        Whose inlet is a constant of the configuration.
    load : ndarray (S, n), W
        Heat by the current, ten minutes' mean.
    warmed : ndarray (S,), K
        What the current, if believed, has warmed the cells by in the last two minutes.
    frozen, leapt : ndarray of int (S,)
        For how many steps the inlet has read the same, and how many are left since it leapt.
    frozen_at : ndarray (S,), K
        Offset of the inlet when it last moved.
    film : ndarray (S,)
        Share of the films' conductance lost, as it usually is; NaN before it is known.
    cooling : ndarray of bool (S,)
        Where it is told that the films are worse.
    inlet : ndarray (S,), °C
        As last measured.
    fine : ndarray (S, m), K
        Steps of the thermocouples' readings; 0 where not known.
    ln : ndarray (S,)
        Mean of the greatest ln evidence so far: how good the models are.
    alone : ndarray of bool (S,)
        Which have too few sensors to hold one against the others.
    few : ndarray of bool (S,)
        Which have too few that are believed.
    """

    constant_inlet: Bools
    load: Floats
    warmed: Floats
    frozen: Ints
    leapt: Ints
    frozen_at: Floats
    film: Floats
    cooling: Bools
    inlet: Floats
    fine: Floats
    ln: Floats
    alone: Bools
    few: Bools

    @classmethod
    def of(cls, f: HeatFilter, constant_inlet: Sequence[bool]) -> "Course":
        """Begin with the strings of a filter."""
        S, n = f.at.strings, f.at.cells
        no, unknown = np.zeros(S, np.int64), np.full(S, np.nan)
        fixed = np.array(constant_inlet, np.bool_)
        no_flag, fine = np.zeros(S, np.bool_), np.zeros((S, f.at.sensed))
        ln = np.full(S, USUAL_FIRST)
        return cls(
            fixed,
            np.zeros((S, n)),
            np.zeros(S),
            no,
            no,
            np.zeros(S),
            unknown,
            no_flag,
            unknown,
            fine,
            ln,
            f.alone,
            f.alone,
        )

    @property
    def doubt(self) -> Floats:
        """What evidence (S,) is divided by."""
        vague = self.few | self.constant_inlet
        return np.asarray(np.maximum(1.0, self.ln / USUAL_LN) * np.where(vague, VAGUE_DOUBT, 1.0))

    @property
    def warms(self) -> Bools:
        """Whether the current would have warmed the cells of each string (S,) by enough to be seen."""
        return np.asarray(self.warmed > np.where(self.alone, WARMS_ALONE_K, WARMS_K), dtype=np.bool_)

    def grown(self, f: HeatFilter) -> Floats:
        """Growth of R_u (S,) against what it has been."""
        return (1.0 - self.film) / (1.0 - np.minimum(f.z[:, f.at.flow], MOST_LOSS)) - 1.0

    def forget(self, new: Bools) -> None:
        """Begin anew with some of the strings: films and the inlet's offset are what they will be found to be."""
        self.film[new], self.frozen[new] = np.nan, 0

    def sleep(self, slept_s: float) -> None:
        """Take in a time in which nothing flowed; what the inlet is off the cells is found anew."""
        self.frozen = np.full_like(self.frozen, -FOUND_STEPS)
        self.load = self.load * exp(-slept_s / 600.0)
        self.warmed = self.warmed * exp(-slept_s / 120.0)

    def take(self, f: HeatFilter, heat: Floats, inlet: Floats, heard: Bools) -> Bools:
        """Take in a step: heat by the current (S, n), W, inlet (S,), °C; tell which strings are to be looked at."""
        at, dt = f.at, f.dt
        made, made_var = f.made()
        real = heat * np.maximum(1.0, made)[:, None]
        self.load = self.load + (real - self.load) * min(1.0, dt / 600.0)
        self.warmed = (self.warmed + heat.mean(axis=1) * dt / f.balances.C.mean(axis=1)) * exp(-dt / 120.0)
        step = np.abs(inlet - self.inlet)
        still = step == 0.0
        self.frozen = np.where(still | (self.frozen < 0), self.frozen + 1, 0)
        self.leapt = np.where(step > LEAP_K, round(LEAP_S / dt), np.maximum(0, self.leapt - 1))
        film, off, film_sd = f.z[:, at.flow], f.z[:, at.inlet], np.sqrt(f.P[:, at.flow, at.flow])
        self.frozen_at = np.where(self.frozen > 0, self.frozen_at, off)
        self.inlet = inlet
        self.film = np.where(np.isnan(self.film), film, self.film)
        grown = self.grown(f)
        usual = heard & ~self.cooling & (grown < COOLING_BACK)
        self.film = np.where(usual, self.film + (film - self.film) * min(1.0, dt / FLOW_USUAL_S), self.film)
        absent = self.warms & missing(made, np.sqrt(made_var))
        slower = (grown > COOLING) & (film - self.film > FLOW_SURE * film_sd)
        frozen = (self.frozen * dt >= FROZEN_S) & ~self.constant_inlet & (np.abs(off - self.frozen_at) > FROZEN_K)
        return np.asarray(absent | slower | frozen, dtype=np.bool_)


def missing(share: Floats | float, sd: Floats | float) -> Bools:
    """Whether the current makes so small a share of its heat (S,), known with sd, that it is not credible."""
    return np.asarray((share + MISSING_SURE * sd < MISSING) & (share + MISSING_SURE * sd > COLD), dtype=np.bool_)
