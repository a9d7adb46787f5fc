"""A Kalman filter for strings of equal length that allows for all changes of a sound pack, and for no fault.

It runs on a grid of some seconds, because heat of a cell's own acts within minutes. Besides the temperatures, its
states are the changes that are common to all cells and the differences of cells and thermocouples (`layout`), each with
the size that it has in sound packs (`usual`). `fault_evidence` judges its innovations against a list of faults.

The string is that of Lin et al., Eq 18; the states besides the temperatures are not part of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.health.heat.balances import LEAST_LOSS, MOST_LOSS, Balances, coupling
from bms_gateway.health.heat.layout import COMMON, Bools, Layout
from bms_gateway.health.heat.usual import HOUR_S, INLET_S, Usual
from bms_gateway.thermal import Floats, Start, StringModel, StringParameters, start_spread

BIAS_WALK = 0.1
"""K per hour^½: drift of a thermocouple."""
OWN_FIRST = 0.12
"""ln: difference of a cell of which nothing has been read yet, in heat and in R_u; it includes the position of its
thermocouple."""
STOPPED, CALM_RATE = 0.7, 1e-3
"""Share of the films' conductance that is lost when a fan or pump stops; and heat of the current, K/s of a cell's heat
capacity, below which a string counts as without load. Without load, the reading of the only thermocouple of a string is
not explained by a greater loss, because less cooling alone makes no surface rise."""
MOST_OWN = 0.5
"""Greatest share by which the film of a single cell differs: beyond it, a step of the grid would not be stable."""
OPEN_RATE, OPEN_S = 1e-2, 1200.0
"""Rate, K/s of the heat capacity, and time constant of the heat of a cell in which heat has been found."""
ROUGH_RATE, ROUGH_SHARE = 2e-4, 0.03
"""White heat of each cell in a step of `ROUGH_S`: K/s of its heat capacity, and share of the heat of the current."""
ROUGH_S = 10.0
READING_SD, CASING_SD = 0.05, 0.03
"""K: least noise of a reading; error of the mean of a step that more readings do not reduce (lag, position)."""
DEAF = 1e8
"""K²: variance of a missing reading."""


@dataclass(frozen=True, slots=True)
class Step:
    """Measurements of one step of the grid, for S strings of n cells with m sensors.

    Attributes
    ----------
    heat : ndarray (S, n), W
        Mean heat by the current, or by the voltage.
    current : ndarray (S,), A
        Mean; 0 where unknown.
    inlet0, inlet1 : ndarray (S,), °C
        Coolant at the inlet at the start and at the end.
    y, age, R : ndarray (S, m), °C, s, K²
        Mean of the readings, mean time from a reading to the end of the step, and variance; NaN without a reading.
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
    """Matrices and innovations of a step, for the states of `fault_evidence`, which follow the same equations.

    Attributes
    ----------
    G : ndarray (S, 2n, N)
        Derivatives of the temperatures after the step by all states before it.
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
    usual : Usual
        Sizes and time constants of the states in sound packs.
    open : ndarray of bool (S, a)
        Cells in which a fault makes heat.
    flows : ndarray (S,)
        Coolant flow, over nominal.
    calm : ndarray of bool (S,)
        The current made no heat in the last step.
    before : ndarray (S, 5)
        States that are common to all cells, before the last step.
    """

    def __init__(self, models: Sequence[StringModel], dt: float) -> None:
        self.at, self.dt = Layout.of(models), dt
        at, S = self.at, len(models)
        self._strings = [m.nominal for m in models]
        self.balances = Balances.of(self._strings, dt)
        self._strides: dict[float, Balances] = {}
        self.H = at.readings()
        self.usual = Usual.of(models, at, self.balances.C[np.arange(S)[:, None], at.told])
        self.decay: Floats = np.exp(-dt / self.usual.lasts_s)
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
        """Set the states of string `s` to those of an unknown sound string."""
        at = self.at
        first = self.usual.sd[s].copy()
        first[at.own_load] = first[at.own_flow] = OWN_FIRST
        self.z[s], self.P[s] = 0.0, np.diag(np.square(first))
        self.P[s, : at.nodes, : at.nodes] = self._start
        self.open[s], self.running[s] = False, False

    def begin(self, s: int, level: float) -> None:
        """Start the temperatures of string `s` about `level`, °C; the other states stay."""
        T = slice(self.at.nodes)
        self.z[s, T] = level
        self.P[s, T, :], self.P[s, :, T] = 0.0, 0.0
        self.P[s, T, T] = self._start
        self.running[s] = True

    def stride(self, dt: float) -> None:
        """Make steps of `dt` seconds from now on."""
        if dt == self.dt:
            return
        self._strides[self.dt] = self.balances
        if dt not in self._strides:
            flows = zip(self._strings, self.flows.tolist(), strict=True)
            self._strides[dt] = Balances.of([p.with_flow_ratio(ratio) for p, ratio in flows], dt)
        self.dt, self.balances, self.decay = dt, self._strides[dt], np.exp(-dt / self.usual.lasts_s)

    def made(self) -> tuple[Floats, Floats]:
        """Heat of each string (S,) over that which its current makes by the model, and the variance of this ratio."""
        n = [self.at.load, self.at.brisk]
        return 1.0 + self.z[:, n].sum(axis=1), self.P[:, n][:, :, n].sum(axis=(1, 2))

    def parameters(self, s: int) -> StringParameters:
        """Numbers of string `s` at nominal flow."""
        return self._strings[s]

    def set_parameters(self, s: int, p: StringParameters) -> None:
        """Use other numbers for string `s`; the states that describe departures from the old numbers are converted."""
        old, at = self._strings[s], self.at
        self.z[s, at.load] = (1.0 + self.z[s, at.load]) * float(np.exp(np.mean(np.log(old.R_e / p.R_e)))) - 1.0
        self.z[s, at.flow] = 1.0 - (1.0 - self.z[s, at.flow]) * float(np.exp(np.mean(np.log(p.R_u / old.R_u))))
        self._exchange(s, p.with_flow_ratio(float(self.flows[s])))
        self._strings[s] = p

    def set_flow(self, s: int, ratio: float) -> None:
        """Set the coolant flow of string `s`, over nominal."""
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
        """Advance one step and use its readings."""
        at, b, z = self.at, self.balances, self.z
        N = at.nodes
        self.before = z[:, at.common].copy()
        T_s = z[:, 1:N:2]
        # a mean of the inlet's offset: at first a loss of cooling appears as such an offset, and the newest offset
        # would reduce the flux by which the loss of cooling shows
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
        there = np.isfinite(m.y) & at.fitted
        nu = np.where(there, m.y - (after - m.age * rate) - z1[:, at.bias], 0.0)
        PHt = np.matmul(P, self.H.transpose(0, 2, 1))
        S = np.matmul(self.H, PHt)
        k = np.arange(at.sensed)
        S[:, k, k] += np.where(there, m.R, DEAF)
        S_inv = np.linalg.inv(S)
        K = np.matmul(PHt, S_inv)
        # one or two thermocouples cannot separate a cell's heat from common changes: these are held meanwhile
        held = np.flatnonzero(self.usual.alone & self.open.any(axis=1))
        K[held, at.common] = 0.0
        self.z = z1 + np.matmul(K, nu[:, :, None])[:, :, 0]
        self.calm = np.asarray((m.heat < CALM_RATE * b.C).all(axis=1), np.bool_)
        most = np.where(self.usual.alone & self.calm, STOPPED, MOST_LOSS)
        self.z[:, at.flow] = np.clip(self.z[:, at.flow], LEAST_LOSS, most)
        self.z[:, at.own_flow] = np.clip(self.z[:, at.own_flow], -MOST_OWN, MOST_OWN)
        less = np.matmul(K, PHt.transpose(0, 2, 1))
        # the variance of what is held stays, as in a Schmidt-Kalman filter
        less[held, at.common] = less[held, :, at.common].transpose(0, 2, 1)
        P -= less
        self.P = (P + P.transpose(0, 2, 1)) / 2.0
        coolant = b.coolant(z1[:, 1:N:2], m.inlet1 + z1[:, at.inlet])[row, at.sensors]
        return Linear(G, K, S_inv, nu, coolant, after, rate)

    def _spread(self, G: Floats, heat: Floats) -> Floats:
        """Covariance after a step, before its readings are used."""
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
        out[:, k, k] += np.square(self.usual.sd[:, N:]) * (1.0 - np.square(decay))
        b = np.arange(at.bias.start, at.bias.stop)
        out[:, b, b] += BIAS_WALK**2 * self.dt / HOUR_S
        if self.open.any():
            h = np.arange(at.heat.start, at.heat.stop)
            out[:, h, h] += np.where(self.open, np.square(self._open_sd) * (2.0 * self.dt / OPEN_S), 0.0)
        return out

    def move(self, s: int, along: Floats, amplitude: float, var: float) -> None:
        """Shift the states of string `s` along a direction (N,) by `amplitude`, which has the variance `var`."""
        self.z[s] += along * amplitude
        self.P[s] += var * np.outer(along, along)

    def open_heat(self, s: int, k: int, watts: float) -> None:
        """Allow heat of its own in the `k`-th of the observed cells from now on."""
        self.open[s, k] = True
        held = abs(float(self.z[s, self.at.heat.start + k]))  # heat that may be in several cells is stored for each
        self._open_sd[s, k] = max(OPEN_RATE * self.usual.C[s, k], 0.5 * abs(watts), 0.5 * held)

    def close_heat(self, s: int, k: int) -> None:
        """Treat the `k`-th of the observed cells as sound again."""
        self.open[s, k] = False
        at, h = self.at, self.at.heat.start + k
        ratio = min(1.0, self.usual.sd[s, h] / float(np.sqrt(self.P[s, h, h])))
        self.P[s, h, :] *= ratio
        self.P[s, :, h] *= ratio
        self.z[s, at.heat.start + k] = 0.0
