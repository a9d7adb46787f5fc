"""A Kalman filter for strings of equal length that knows what normal life does to a pack, and nothing of faults.

It runs on a grid of some seconds: what heat of a cell's own does takes minutes. Beyond the temperatures it carries what
is common to all cells and what cells and thermocouples differ by (`layout`), each with the size that it has in sound
packs. What it is surprised by is judged elsewhere (`fault_evidence`), against a list of faults.

The method of Lin et al., Eq 18 (string) under a Kalman filter; the numbers beside the temperatures are ours.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.health.heat.balances import LEAST_LOSS, MOST_LOSS, Balances, coupling
from bms_gateway.health.heat.layout import COMMON, Bools, Layout
from bms_gateway.thermal import Floats, Start, StringModel, StringParameters, start_spread

HOUR_S = 3600.0
LOAD_SD, LOAD_S = 0.25, 7200.0
"""ln of the heat: R_e with temperature and charge; what the identifier does not know of R_e comes to it."""
BRISK_SD, BRISK_ALONE_SD, BRISK_S = 0.1, 0.25, 900.0
"""The same within minutes, by what a resistance does as charge moves and overpotentials build up; and where fewer than
three sensors leave nothing to hold a cell against, so that it is taken for granted."""
FLOW_SD, FLOW_S = 0.30, 3600.0
"""Share of the films' conductance: a flow that is not on the bus."""
INLET_SD, INLET_S = 1.0, 1800.0
"""K: the inlet's sensor against what meets the first cell."""
ENTROPY_SD, ENTROPY_S = 2e-4, 1800.0
"""V/K: an entropic coefficient, which changes as the charge moves."""
BIAS_SD, BIAS_WALK = 0.3, 0.1
"""K, and K in an hour^½: thermocouples of class 1 agree within this, and drift."""
OWN_SD, OWN_FIRST, OWN_S = 0.03, 0.12, 12 * HOUR_S
"""ln: by so much are cells of one string unlike, in heat and in R_u, or come to be; and places of a
thermocouple that nobody has seen yet."""
STOPPED, CALM_RATE = 0.7, 1e-3
"""Share of the films' conductance that is lost with a fan or pump that stands; and K/s of a cell's heat capacity below
which the current makes no heat. Then a lone thermocouple is not explained by more: no film makes a surface rise."""
MOST_OWN = 0.5
"""Share by which a cell's own film differs at most: beyond, a step of the grid would not be stable."""
HEAT_RATE, HEAT_S = 1e-4, HOUR_S
"""K/s of a cell's own heat capacity: what no model has, always there. Faults are far above."""
OPEN_RATE, OPEN_S = 1e-2, 1200.0
"""The same of a cell whose heat is known to be there: it grows and falls within minutes."""
ROUGH_RATE, ROUGH_SHARE = 2e-4, 0.03
"""White heat of each cell in a step of `ROUGH_S`: K/s of its heat capacity, and share of the heat by the current."""
ROUGH_S = 10.0
READING_SD, CASING_SD = 0.05, 0.03
"""K: least noise of a reading; and what the mean of a step is off whatever their number: lag, place."""
REFERENCE = 3
"""Sensors of a string from which one can be held against the others."""
LEAST_GAP_SD = 0.05
"""Relative sd of R_c at least, for the core of a cell that heats by itself."""
DEAF = 1e8
"""K²: noise of a reading that there is none of."""


@dataclass(frozen=True, slots=True)
class Step:
    """What was measured in one step of the grid, of S strings of n cells with m sensors.

    Attributes
    ----------
    heat : ndarray (S, n), W
        By current or voltage, mean.
    current : ndarray (S,), A
        Mean; 0 where not known.
    inlet0, inlet1 : ndarray (S,), °C
        Coolant at the inlet at the start and at the end.
    y, age, R : ndarray (S, m), °C, s, K²
        Mean of the readings, how long before the end they were taken on average, and variance; NaN where none.
    """

    heat: Floats
    current: Floats
    inlet0: Floats
    inlet1: Floats
    y: Floats
    age: Floats
    R: Floats


@dataclass(frozen=True, slots=True)
class Linear:
    """The step as it was linearised, for whatever else goes the same way.

    Attributes
    ----------
    G : ndarray (S, 2n, N)
        Temperatures after the step by all numbers before it.
    K : ndarray (S, N, m)
    S_inv : ndarray (S, m, m), 1/K²
    nu : ndarray (S, m), K
        Reading less prediction; 0 where nothing was read.
    coolant, surface, rate : ndarray (S, m), °C, °C, K/s
        At the sensors, after the step.
    """

    G: Floats
    K: Floats
    S_inv: Floats
    nu: Floats
    coolant: Floats
    surface: Floats
    rate: Floats


class HeatFilter:
    """Filter of S strings.

    Parameters
    ----------
    models : sequence of StringModel
        Of equal length, each with a sensor at least.
    dt : float, s
        Step.

    Attributes
    ----------
    z, P : ndarray (S, N), (S, N, N)
        Mean and covariance; see `Layout`.
    open : ndarray of bool (S, a)
        Cells with a fault that heats.
    flows : ndarray (S,)
        Coolant flow, over nominal.
    calm : ndarray of bool (S,)
        Where the current made no heat in the last step.
    before : ndarray (S, 5)
        What is common to all cells, as it was before the last step.
    """

    def __init__(self, models: Sequence[StringModel], dt: float) -> None:
        self.at, self.dt = Layout.of(models), dt
        at, S = self.at, len(models)
        self._strings = [m.nominal for m in models]
        self.balances = Balances.of(self._strings, dt)
        self._strides: dict[float, Balances] = {}
        self.H = at.readings()
        self._fitted = at.fitted
        sd = np.zeros((S, at.states))
        sd[:, at.load] = [max(LOAD_SD, m.priors["R_e"].rel_sd) for m in models]
        sd[:, at.flow] = [max(FLOW_SD, m.priors["R_u"].rel_sd) for m in models]
        sd[:, at.inlet], sd[:, at.entropy] = INLET_SD, ENTROPY_SD
        known = [np.hypot(m.priors["R_c"].rel_sd, m.tolerances["cell_R_c"]) for m in models]
        self.gap_sd = np.maximum(LEAST_GAP_SD, np.array(known))
        self.beside_sd = np.array([m.priors["R_cc"].rel_sd if m.has_conduction else 0.0 for m in models])
        self.alone = np.array([len(m.sensors) < REFERENCE for m in models])
        sd[:, at.brisk] = np.where(self.alone, BRISK_ALONE_SD, BRISK_SD)
        row = np.arange(S)[:, None]
        sd[:, at.bias], self.C = BIAS_SD, self.balances.C[row, at.told]
        sd[:, at.heat] = HEAT_RATE * self.C
        sd[:, at.own_load] = sd[:, at.own_flow] = OWN_SD
        self.sd = sd
        lasts = np.full(at.states, np.inf)
        lasts[at.load], lasts[at.flow], lasts[at.inlet], lasts[at.entropy] = LOAD_S, FLOW_S, INLET_S, ENTROPY_S
        lasts[at.brisk] = BRISK_S
        lasts[at.heat], lasts[at.own_load], lasts[at.own_flow] = HEAT_S, OWN_S, OWN_S
        self._lasts = lasts[at.nodes :]
        self.decay: Floats = np.exp(-dt / self._lasts)
        self.flows = np.ones(S)
        self._start = start_spread(at.cells, Start())
        self.z, self.P = np.zeros((S, at.states)), np.zeros((S, at.states, at.states))
        self._usual_inlet = np.zeros(S)
        self.open: Bools = np.zeros((S, at.near), np.bool_)
        self._open_sd = np.zeros((S, at.near))
        self.running: Bools = np.zeros(S, np.bool_)
        self.before: Floats = np.zeros((S, COMMON))
        self.calm: Bools = np.zeros(S, np.bool_)
        for s in range(S):
            self._forget(s)

    def _forget(self, s: int) -> None:
        """Know of string `s` what is known of any."""
        at = self.at
        first = self.sd[s].copy()
        first[at.own_load] = first[at.own_flow] = OWN_FIRST
        self.z[s], self.P[s] = 0.0, np.diag(np.square(first))
        self.P[s, : at.nodes, : at.nodes] = self._start
        self.open[s], self.running[s] = False, False

    def begin(self, s: int, level: float) -> None:
        """Start the temperatures of string `s` about `level`, °C; what is known beside them stays."""
        T = slice(self.at.nodes)
        self.z[s, T] = level
        self.P[s, T, :], self.P[s, :, T] = 0.0, 0.0
        self.P[s, T, T] = self._start
        self.running[s] = True

    def stride(self, dt: float) -> None:
        """Let steps be of `dt` seconds from now on, until told otherwise."""
        if dt == self.dt:
            return
        self._strides[self.dt] = self.balances
        if dt not in self._strides:
            flows = zip(self._strings, self.flows.tolist(), strict=True)
            self._strides[dt] = Balances.of([p.with_flow_ratio(ratio) for p, ratio in flows], dt)
        self.dt, self.balances, self.decay = dt, self._strides[dt], np.exp(-dt / self._lasts)

    def made(self) -> tuple[Floats, Floats]:
        """Share of its heat that the current makes in each string (S,), and its variance."""
        n = [self.at.load, self.at.brisk]
        return 1.0 + self.z[:, n].sum(axis=1), self.P[:, n][:, :, n].sum(axis=(1, 2))

    def parameters(self, s: int) -> StringParameters:
        """Numbers of string `s` at nominal flow."""
        return self._strings[s]

    def set_parameters(self, s: int, p: StringParameters) -> None:
        """Take other numbers of string `s` into use; what was held against the old ones counts for the new."""
        old, at = self._strings[s], self.at
        self.z[s, at.load] = (1.0 + self.z[s, at.load]) * float(np.exp(np.mean(np.log(old.R_e / p.R_e)))) - 1.0
        self.z[s, at.flow] = 1.0 - (1.0 - self.z[s, at.flow]) * float(np.exp(np.mean(np.log(p.R_u / old.R_u))))
        self._exchange(s, p.with_flow_ratio(float(self.flows[s])))
        self._strings[s] = p

    def set_flow(self, s: int, ratio: float) -> None:
        """Let string `s` have another coolant flow, over nominal."""
        self._exchange(s, self._strings[s].with_flow_ratio(ratio))
        self.flows[s] = ratio

    def _exchange(self, s: int, p: StringParameters) -> None:
        one, b = Balances.of([p], self.dt), self.balances
        names = Balances.__slots__
        arrays = {k: getattr(b, k).copy() for k in names}
        for k in names:
            arrays[k][s] = getattr(one, k)[0]
        self.balances = replace(b, **arrays)
        self._strides.clear()

    def step(self, m: Step) -> Linear:
        """Advance one step and take its readings in."""
        at, b, z = self.at, self.balances, self.z
        N = at.nodes
        self.before = z[:, at.common].copy()
        T_s = z[:, 1:N:2]
        # an offset of the inlet as it has been: what a loss of cooling first passes for would hide its own lever
        self._usual_inlet += (z[:, at.inlet] - self._usual_inlet) * (self.dt / INLET_S)
        flux = (T_s - b.coolant(T_s, m.inlet0 + self._usual_inlet)) / b.R_u
        X, moved = coupling(b, at, z, m.heat, flux, m.current)
        z1 = np.empty_like(z)
        z1[:, N:] = z[:, N:] * self.decay
        z1[:, :N] = np.matmul(b.Phi, z[:, :N, None])[:, :, 0] + np.matmul(b.core, m.heat[:, :, None])[:, :, 0] + moved
        z1[:, :N] += b.inlet0 * m.inlet0[:, None] + b.inlet1 * m.inlet1[:, None]
        G = np.concatenate((b.Phi, X), axis=2)
        P = self._spread(G, m.heat)
        row = np.arange(at.strings)[:, None]
        before, after = z[row, 2 * at.sensors + 1], z1[row, 2 * at.sensors + 1]
        rate = (after - before) / self.dt
        there = np.isfinite(m.y) & self._fitted
        nu = np.where(there, m.y - (after - m.age * rate) - z1[:, at.bias], 0.0)
        PHt = np.matmul(P, self.H.transpose(0, 2, 1))
        S = np.matmul(self.H, PHt)
        k = np.arange(at.sensed)
        S[:, k, k] += np.where(there, m.R, DEAF)
        S_inv = np.linalg.inv(S)
        K = np.matmul(PHt, S_inv)
        # a lone thermocouple cannot tell a cell's heat from what else changes meanwhile: nothing else does
        held = np.flatnonzero(self.alone & self.open.any(axis=1))
        K[held, at.common] = 0.0
        self.z = z1 + np.matmul(K, nu[:, :, None])[:, :, 0]
        self.calm = np.asarray((m.heat < CALM_RATE * b.C).all(axis=1), np.bool_)
        most = np.where(self.alone & self.calm, STOPPED, MOST_LOSS)
        self.z[:, at.flow] = np.clip(self.z[:, at.flow], LEAST_LOSS, most)
        self.z[:, at.own_flow] = np.clip(self.z[:, at.own_flow], -MOST_OWN, MOST_OWN)
        less = np.matmul(K, PHt.transpose(0, 2, 1))
        less[held, at.common] = less[held, :, at.common].transpose(0, 2, 1)  # Schmidt's filter: as uncertain as before
        P -= less
        self.P = (P + P.transpose(0, 2, 1)) / 2.0
        coolant = b.coolant(z1[:, 1:N:2], m.inlet1 + z1[:, at.inlet])[row, at.sensors]
        return Linear(G, K, S_inv, nu, coolant, after, rate)

    def _spread(self, G: Floats, heat: Floats) -> Floats:
        """Covariance after a step, before its readings."""
        at, N, P, decay = self.at, self.at.nodes, self.P, self.decay
        out = np.empty_like(P)
        GP = np.matmul(G, P)
        rough = (np.square(ROUGH_RATE * self.balances.C) + np.square(ROUGH_SHARE * heat)) * (ROUGH_S / self.dt)
        core = self.balances.core
        out[:, :N, :N] = np.matmul(GP, G.transpose(0, 2, 1)) + np.matmul(
            core * rough[:, None, :], core.transpose(0, 2, 1)
        )
        out[:, :N, N:] = GP[:, :, N:] * decay
        out[:, N:, :N] = out[:, :N, N:].transpose(0, 2, 1)
        out[:, N:, N:] = P[:, N:, N:] * (decay[:, None] * decay)
        k = np.arange(N, at.states)
        out[:, k, k] += np.square(self.sd[:, N:]) * (1.0 - np.square(decay))
        b = np.arange(at.bias.start, at.bias.stop)
        out[:, b, b] += BIAS_WALK**2 * self.dt / HOUR_S
        if self.open.any():
            h = np.arange(at.heat.start, at.heat.stop)
            out[:, h, h] += np.where(self.open, np.square(self._open_sd) * (2.0 * self.dt / OPEN_S), 0.0)
        return out

    def move(self, s: int, along: Floats, amplitude: float, var: float) -> None:
        """Move the numbers of string `s` by `amplitude`, known with variance `var`, along a direction (N,)."""
        self.z[s] += along * amplitude
        self.P[s] += var * np.outer(along, along)

    def open_heat(self, s: int, k: int, watts: float) -> None:
        """Let cell number `k` of those told of heat by itself from now on."""
        self.open[s, k] = True
        held = abs(float(self.z[s, self.at.heat.start + k]))  # where it may sit in several cells, each has its own
        self._open_sd[s, k] = max(OPEN_RATE * self.C[s, k], 0.5 * abs(watts), 0.5 * held)

    def close_heat(self, s: int, k: int) -> None:
        """Let cell number `k` be sound again."""
        self.open[s, k] = False
        at, h = self.at, self.at.heat.start + k
        ratio = min(1.0, self.sd[s, h] / float(np.sqrt(self.P[s, h, h])))
        self.P[s, h, :] *= ratio
        self.P[s, :, h] *= ratio
        self.z[s, at.heat.start + k] = 0.0
