"""Recent history of all strings, computed together; it shows which strings must be judged one by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, nan

import numpy as np

from bms_gateway.health.heat.balances import MOST_LOSS
from bms_gateway.health.heat.filter import CALM_RATE, OWN_FIRST, HeatFilter
from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.health.heat.usual import REFERENCE
from bms_gateway.health.heat.voltage_witness import VoltageWitness
from bms_gateway.thermal import Floats

LEAP_K, LEAP_S, SOUND_INLET = 1.0, 900.0, -100.0
"""A jump of the inlet's reading by the first number in one step makes it doubtful for the time of the second. An inlet
that neither jumps nor is constant counts as good, because coolant that is warmer than its reading looks like a film
that cools less. The third number is the ln prior of its fault."""
MISSING, MISSING_SURE, MISSING_BACK = 0.35, 2.5, 0.5
"""Ratio of the measured heat to that of the current. The current is not credible if the ratio plus so many sd is below
the first number, and is credible again above the third."""
DENIED_SURE = 1.0  # the sd that suffices where the voltage denies the current too
COLD = -0.25
"""Least ratio that a wrong current can cause: below it, the cells are cooled by something else."""
WARMS_K, WARMS_ALONE_K = 0.7, 2.8
"""Least warming that the measured current should have caused, before missing heat is judged; the second number holds
for strings with fewer than three sensors."""
COOLING, COOLING_BACK, COOLING_GRAVE = 0.5, 0.35, 1.5
"""Growth of R_u against the identified value at which it is reported, at which it has ended, and at which it is an
alarm."""
FLOW_USUAL_S, FLOW_SURE, FLOW_GRAVE = 3600.0, 3.0, 6.0
"""Time constant of the usual state of the films, and the sd by which the loss must exceed it: for a sudden change, and
for a loss so large that its speed does not matter."""
SLOW_S, MUCH = 300.0, 0.8
"""Time for which a loss that came slowly, as a dirty filter or a weak fan makes it, must have been there; and the
growth of R_u above which a minute is enough."""
FROZEN_S, FROZEN_K = 300.0, 0.8
"""An inlet is frozen if it reads the same for so long while the cells show that it moved by so much."""
STUCK_S, LIVELY, LIVELY_S, MOVES = 240.0, 0.25, 900.0, 1.5
"""An inlet is frozen, too, if it reads the same for the first time, s, although it moved before in a larger share
of the steps than the second number. The third number is the time constant of that share, s. A change of the reading is
a move if it exceeds its least change by the last factor: a coarse reading at the border of two values is not lively."""
FOUND_STEPS = 60
"""Number of steps after a sleep in which the filter finds the offset of the inlet."""
USUAL_LN, USUAL_S, USUAL_FIRST = 2.5, 1800.0, 4.5
"""Mean of the greatest ln evidence in sound strings with a good model; its time constant; and its first value, while
the quality of the model is unknown. A greater mean shows a poorer model; all evidence is then reduced."""
DRIVEN_FIRST, DRIVEN_S = 16.0, 900.0
"""The same first value while a current warms the cells, and the time of warming in which it decays: no rest has shown
yet how much the cells differ."""
POOR_LN, POOR_K, POOR_SHARE = 10.0, 1.2, 0.3
"""Limits above which a thermocouple that drifts or lags, and films that are lost slowly, are not reported, because the
model lacks more than they would show: this mean; an offset of a thermocouple in use that none of class 1 has and that
no jump explains; a difference of a sensed cell in heat or film that no two cells of a string have."""
VAGUE_DOUBT = 2.5
"""Divisor of the evidence of a string with fewer than three sensors, which can only be compared with its model, or
without a measured coolant inlet."""


@dataclass(slots=True)
class Course:
    """Recent history of S strings of n cells.

    Attributes
    ----------
    constant_inlet : ndarray of bool (S,)
        The inlet is a constant of the configuration.
    load : ndarray (S, n), W
        Heat by the current, mean of ten minutes.
    warmed : ndarray (S,), K
        Warming of the cells in the last two minutes that the measured current should have caused.
    frozen, leapt : ndarray of int (S,)
        Number of steps for which the inlet has read the same, and for which it still counts as doubtful after a jump.
    frozen_at : ndarray (S,), K
        Offset of the inlet when it last moved.
    finest, lively : ndarray (S,), K, 1
        Least step of the inlet's reading so far, and the share of steps in which the reading moved.
    stuck : ndarray of bool (S,)
        A lively inlet reads the same.
    film : ndarray (S,)
        Usual loss of the films' conductance, as a share; NaN before it is known.
    cooling : ndarray of bool (S,)
        Worse cooling has been reported.
    inlet : ndarray (S,), °C
        Last measured value.
    fine : ndarray (S, m), K
        Resolution of the thermocouples' readings; 0 where unknown.
    ln : ndarray (S,)
        Mean of the greatest ln evidence so far; it shows the quality of the models.
    alone : ndarray of bool (S,)
        The string has too few sensors to compare one of them with the others.
    few : ndarray of bool (S,)
        The string has too few sensors whose readings are used.
    unlike : ndarray of bool (S,)
        Whether a thermocouple in use, or its cell, differs from the others by more than any of them does alone.
    driven : ndarray (S,), s
        Time for which the current has warmed the cells.
    apart : ndarray (S,)
        ln evidence on how much a cell with a thermocouple differs from the others.
    voltage : VoltageWitness
    """

    constant_inlet: Bools
    load: Floats
    warmed: Floats
    frozen: Ints
    leapt: Ints
    frozen_at: Floats
    finest: Floats
    lively: Floats
    stuck: Bools
    film: Floats
    cooling: Bools
    inlet: Floats
    fine: Floats
    ln: Floats
    alone: Bools
    few: Bools
    unlike: Bools
    driven: Floats
    apart: Floats
    voltage: VoltageWitness

    @classmethod
    def of(cls, f: HeatFilter, constant_inlet: Sequence[bool]) -> "Course":
        """Start with the strings of a filter."""
        S, n = f.at.strings, f.at.cells
        return cls(
            constant_inlet=np.array(constant_inlet, np.bool_),
            load=np.zeros((S, n)),
            warmed=np.zeros(S),
            frozen=np.zeros(S, np.int64),
            leapt=np.zeros(S, np.int64),
            frozen_at=np.zeros(S),
            finest=np.full(S, np.inf),
            lively=np.zeros(S),
            stuck=np.zeros(S, np.bool_),
            film=np.full(S, np.nan),
            cooling=np.zeros(S, np.bool_),
            inlet=np.full(S, np.nan),
            fine=np.zeros((S, f.at.sensed)),
            ln=np.full(S, USUAL_FIRST),
            alone=f.usual.alone,
            few=f.usual.alone,
            unlike=np.zeros(S, np.bool_),
            driven=np.zeros(S),
            apart=np.zeros(S),
            voltage=VoltageWitness.of(CALM_RATE * f.balances.C.mean(axis=1)),
        )

    @property
    def denied(self) -> Bools:
        """Which strings (S,) have a voltage that denies the current."""
        return self.voltage.denies

    @property
    def doubt(self) -> Floats:
        """Divisor of the evidence (S,)."""
        vague = self.few | self.constant_inlet
        first = np.where(self.warms, DRIVEN_FIRST * np.exp(-self.driven / DRIVEN_S), 0.0)
        usual = np.maximum(np.maximum(self.ln, first), self.apart)
        return np.asarray(np.maximum(1.0, usual / USUAL_LN) * np.where(vague, VAGUE_DOUBT, 1.0))

    @property
    def warms(self) -> Bools:
        """Whether the current would have warmed the cells of each string (S,) enough to be seen."""
        return np.asarray(self.warmed > np.where(self.alone, WARMS_ALONE_K, WARMS_K), dtype=np.bool_)

    def grown(self, f: HeatFilter) -> Floats:
        """Growth of R_u (S,) against its usual value."""
        return (1.0 - self.film) / (1.0 - np.minimum(f.z[:, f.at.flow], MOST_LOSS)) - 1.0

    def shows_films(self, f: HeatFilter) -> Bools:
        """Return which strings (S,) show the cooling of their films by the heat of the last minutes, without effects.

        Effects that are known to a tenth look like films that are a little worse.
        """
        driven = self.load.mean(axis=1) > CALM_RATE * f.balances.C.mean(axis=1)
        return np.asarray(driven & f.plain & ~self.few & ~self.poor, dtype=np.bool_)

    @property
    def poor(self) -> Bools:
        """Which strings (S,) have models that are too poor to detect slow changes."""
        return np.asarray((self.ln > POOR_LN) | self.unlike, dtype=np.bool_)

    def compare(self, f: HeatFilter, used: Bools, jumped: Bools) -> None:
        """Note which thermocouples (S, m) are used, and which of them have jumped."""
        at, sound = f.at, used & ~jumped
        off = np.where(sound, np.abs(f.z[:, at.bias]), 0.0).max(axis=1)
        own = np.matmul(at.told_of, np.stack((f.z[:, at.own_load], f.z[:, at.own_flow]), axis=2))
        shares = np.abs(own[np.arange(at.strings)[:, None], at.sensors]).max(axis=2)
        share = np.where(sound, shares, 0.0).max(axis=1)
        self.few = used.sum(axis=1) < REFERENCE
        self.unlike = np.asarray((off > POOR_K) | (share > POOR_SHARE), dtype=np.bool_)
        self.apart = np.square(share / OWN_FIRST) / 2.0

    def forget(self, new: Bools) -> None:
        """Reset some of the strings: films and the inlet's offset are to be found anew."""
        self.film[new], self.frozen[new] = np.nan, 0

    def lose(self, lost: Bools, found: Bools) -> None:
        """Note which strings (S,) have lost their inlet or found it again: what it did meanwhile is no step or rest."""
        self.frozen[lost | found], self.leapt[lost] = 0, 0
        self.inlet[found] = np.nan

    def reads_all_along(self, s: int) -> float:
        """Return what the inlet of a string reads, °C; NaN if it may rightly read the same for ever."""
        return nan if self.constant_inlet[s] else float(self.inlet[s])

    def sleep(self, slept_s: float) -> None:
        """Note a time without current; the offset between inlet and cells is then found anew."""
        self.frozen = np.full_like(self.frozen, -FOUND_STEPS)
        self.load = self.load * exp(-slept_s / 600.0)
        self.warmed = self.warmed * exp(-slept_s / 120.0)

    def hear(self, inlet: Floats, read: Bools, dt: float) -> None:
        """Note the inlet (S,), °C, of a step of `dt` seconds, and for which strings (S,) its sensor was read in it."""
        step = np.where(read, np.abs(inlet - self.inlet), np.nan)
        self.finest = np.where(step > 0.0, np.minimum(self.finest, step), self.finest)
        moves = step > MOVES * self.finest
        share = self.lively + (moves - self.lively) * min(1.0, dt / LIVELY_S)
        self.lively = np.where(np.isfinite(step), share, self.lively)
        same = (self.frozen * dt >= STUCK_S) & (step == 0.0) & ~self.constant_inlet
        stuck = same & (self.stuck | (self.lively > LIVELY))
        self.stuck = np.asarray(np.where(np.isfinite(step), stuck, self.stuck & (self.frozen > 0)), dtype=np.bool_)

    def take(self, f: HeatFilter, heat: Floats, inlet: Floats, heard: Bools) -> Bools:
        """Note a step with heat by the current (S, n), W, and inlet (S,), °C; return which strings must be judged."""
        at, dt = f.at, f.dt
        made, made_var = f.made()
        real = heat * np.maximum(1.0, made)[:, None]
        self.load = self.load + (real - self.load) * min(1.0, dt / 600.0)
        self.warmed = (self.warmed + heat.mean(axis=1) * dt / f.balances.C.mean(axis=1)) * exp(-dt / 120.0)
        self.driven = self.driven + dt * self.warms
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
        absent = self.warms & missing(made, np.sqrt(made_var), self.denied)
        slower = (grown > COOLING) & (film - self.film > FLOW_SURE * film_sd)
        frozen = (self.frozen * dt >= FROZEN_S) & ~self.constant_inlet & (np.abs(off - self.frozen_at) > FROZEN_K)
        return np.asarray(absent | slower | frozen | self.stuck, dtype=np.bool_)


def missing(share: Floats | float, sd: Floats | float, denied: Bools | bool = False) -> Bools:
    """Whether the current makes so small a share of its heat (S,), with its sd, that it is not credible.

    `denied`: the voltage denies the current, too.
    """
    most = share + np.where(denied, DENIED_SURE, MISSING_SURE) * sd
    return np.asarray((most < MISSING) & (most > COLD), dtype=np.bool_)
