"""A Kalman filter for strings of equal length that allows for all changes of a sound pack, and for no fault.

It runs on a grid of some seconds, because heat of a cell's own acts within minutes. Besides the temperatures, its
states are the changes that are common to all cells and the differences of cells and thermocouples (`layout`), each with
the size that it has in sound packs (`usual`). `fault_evidence` judges its innovations against a list of faults.

The string is that of Lin et al., Eq 18; the states besides the temperatures are not part of the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.balances import LEAST_LOSS, MOST_LOSS, Around, Balances, Response, Unknown, coupling, even
from bms_gateway.health.heat.layout import COMMON, Bools, Ints, Layout
from bms_gateway.health.heat.usual import HOUR_S, INLET_S, Usual
from bms_gateway.thermal import Floats, Start, StringModel, StringParameters, start_spread

BIAS_WALK = 0.1
"""K per hour^½: drift of a thermocouple."""
OWN_FIRST = 0.12
"""ln: difference of a cell without readings so far, in heat and in R_u; it includes the position of its
thermocouple."""
STOPPED, CALM_RATE = 0.7, 1e-3
"""Share of the films' conductance that is lost when a fan or pump stops; and heat of the current, K/s of a cell's heat
capacity, below which a string counts as without load. Without load, the reading of the only thermocouple of a string is
not explained by a greater loss, because less cooling alone makes no surface rise."""
STILL_K = 0.4
"""K: gap between casings and coolant of a string at rest, below which its films are not estimated. Fixed films leave
traces in the innovations that look like new evidence; above this gap, films are estimated even if the gap says little
of them."""
MOST_OWN = 0.5
"""Greatest share by which the film of a single cell differs."""
HOT_OFFSET_K = 4.0
OPEN_RATE, OPEN_S = 1e-2, 1200.0
"""Rate, K/s of the heat capacity, and time constant of the heat of a cell in which heat has been found."""
ROUGH_RATE, ROUGH_SHARE = 2e-4, 0.03
"""White heat of each cell in a step of `ROUGH_S`: K/s of its heat capacity, and share of the heat of the current."""
ROUGH_S = 10.0
LATE_S, LATE_SHARE, LATE_K = 40.0, 0.7, 0.5
"""Coolant that changed at the inlet's sensor reaches the cells later, through hoses and plenums: white error of the
inlet in each step, as a share of how far it is from its mean of so many seconds, weighted exponentially. The offset of
the inlet covers what is less far than the third number."""
READING_SD, CASING_SD = 0.05, 0.03
"""K: least noise of a reading; error of the mean of a step that more readings do not reduce (lag, position)."""
DEAF = 1e8
"""K²: variance of a missing reading."""
FALL, MOST_FALL = 0.01, 1.0
"""Relative fall of R_e per kelvin of the core's warming since R_e was identified, and greatest change of its ln. Cells
have 1 to 3 %; twice this value makes cores 1 to 2.5 K too cold if R_e does not fall. The covariance ignores it: an
uncertain core does not become more certain. If the model has effects, they determine how R_e falls."""


@dataclass(frozen=True, slots=True)
class Step:
    """Measurements of one step of the grid, for S strings of n cells with m sensors; a step has L ticks.

    Attributes
    ----------
    heat : ndarray (L, S, n), W
        Mean heat of each tick by the current, or by the voltage.
    current : ndarray (S,), A
        Mean; 0 where unknown.
    inlet0, inlet1 : ndarray (S,), °C
        Coolant at the inlet at the start and at the end.
    y, R : ndarray (S, m), °C, K²
        Mean of the readings, and its variance; NaN without a reading.
    when : ndarray (S, m, 2 L + 1)
        Weights of the ends of the ticks, from the start of the previous step on, in that mean; their sum is 1.
    """

    heat: Floats
    current: Floats
    inlet0: Floats
    inlet1: Floats
    y: Floats
    R: Floats
    when: Floats


@dataclass(frozen=True, slots=True)
class Linear:
    """Matrices and innovations of a step, for the states of `fault_evidence`, which follow the same equations.

    Attributes
    ----------
    G : ndarray (S, 2n + m, N)
        Derivatives of the temperatures after the step, then of the readings, by all states before it.
    K : ndarray (S, N, m)
    S_inv : ndarray (S, m, m), 1/K²
    nu, var : ndarray (S, m), K, K²
        Reading minus prediction, and its variance; 0 and `DEAF` without a reading.
    coolant, surface, rate : ndarray (S, m), °C, °C, K/s
        At the sensors, after the step.
    mean : ndarray (S, m), °C
        Surfaces at the sensors, averaged over the readings; like `surface`, before the readings were used.
    """

    G: Floats
    K: Floats
    S_inv: Floats
    nu: Floats
    var: Floats
    coolant: Floats
    surface: Floats
    rate: Floats
    mean: Floats


@dataclass(slots=True)
class Coolant:
    """Recent course of the inlet of S strings: the mean of its offset, and its recent movement.

    Attributes
    ----------
    off : ndarray (S,), K
        Mean of the inlet's offset over `INLET_S`. A loss of cooling appears as such an offset at first; the newest
        offset would therefore hide a part of the flux that shows the loss.
    moved : ndarray (S,), K
        Reading of the inlet minus its exponential mean over `LATE_S`.
    """

    off: Floats
    moved: Floats

    def take(self, off: Floats, change: Floats, dt: float) -> Floats:
        """Add a step with offset (S,) and change (S,) of the reading, K; return the variance of its inlet, K² (S,)."""
        self.off = self.off + (off - self.off) * (dt / INLET_S)
        left = float(np.exp(-dt / LATE_S))
        before, self.moved = self.moved, self.moved * left + change * (LATE_S / dt) * (1.0 - left)
        far = np.maximum(0.0, (np.square(before) + np.square(self.moved)) / 2.0 - LATE_K**2)
        return np.asarray(LATE_SHARE**2 * far, dtype=np.float64)


class HeatFilter:
    """Filter of S strings.

    Parameters
    ----------
    models : sequence of StringModel
        Of equal length, each with a sensor at least.
    dt : float, s
        Step.
    ticks : int
        Number of ticks of a step.

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
    before : ndarray (S, 6)
        States that are common to all cells, before the last step.
    plain : ndarray of bool (S,)
        The model has no effects.
    told_at : ndarray (S, n), °C
        Cores when R_e was identified; NaN before the first step of a string.
    film : ndarray (S,)
        Usual loss of the films' conductance, as a share; NaN before it is known.
    """

    def __init__(self, models: Sequence[StringModel], dt: float, ticks: int) -> None:
        self.at, self.dt, self._ticks = Layout.of(models), dt, ticks
        at, S = self.at, len(models)
        self._strings = [m.nominal for m in models]
        self.balances = Balances.of(self._strings, dt, ticks, at.sensors)
        self._strides: dict[float, Balances] = {}
        self.usual = Usual.of(models, at, self.balances.C[np.arange(S)[:, None], at.told])
        self.decay: Floats = np.exp(-dt / self.usual.lasts_s)
        self.flows = np.ones(S)
        self._start = start_spread(at.cells, Start())
        self.z, self.P = np.zeros((S, at.states)), np.zeros((S, at.states, at.states))
        self._coolant = Coolant(np.zeros(S), np.zeros(S))
        self.open: Bools = np.zeros((S, at.near), np.bool_)
        self._open_sd = np.zeros((S, at.near))
        self.running: Bools = np.zeros(S, np.bool_)
        self._past: Floats = np.zeros((S, at.sensed, ticks))  # K: casings in the previous step, minus those at its end
        self.plain: Bools = np.array([not m.effects for m in models], np.bool_)
        self.told_at: Floats = np.full((S, at.cells), np.nan)
        self.film: Floats = np.full(S, np.nan)
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

    def hot_by_offset(self) -> Bools:
        """Return which strings (S,) have a thermocouple whose reading above the others is taken for its offset.

        No thermocouple of class 1 is so far off: the cell may have been hot when the state was found.
        """
        off = np.where(self.at.fitted, self.z[:, self.at.bias], 0.0)
        return np.asarray((off.max(axis=1) > HOT_OFFSET_K) & ~self.usual.alone, dtype=np.bool_)

    def unlearn(self, s: int) -> None:
        """Set the states of string `s` but the temperatures to those of an unknown sound string.

        Temperatures of cells with a thermocouple follow its reading, which the offset of the thermocouple explained.
        """
        at = self.at
        T, off = slice(at.nodes), np.zeros(at.nodes)
        off[2 * at.sensors[s]] = off[2 * at.sensors[s] + 1] = np.where(at.fitted[s], self.z[s, at.bias], 0.0)
        z, P = self.z[s, T] + off, self.P[s, T, T].copy()
        self._forget(s)
        self.z[s, T], self.P[s, T, T] = z, P + np.diag(np.square(off))
        self.running[s] = True

    def begin(self, s: int, level: float) -> None:
        """Start the temperatures of string `s` at about `level`, °C; the other states are kept."""
        T = slice(self.at.nodes)
        self.z[s, T] = level
        self.P[s, T, :], self.P[s, :, T] = 0.0, 0.0
        self.P[s, T, T] = self._start
        self._past[s], self._coolant.moved[s] = 0.0, 0.0
        self.told_at[s] = np.where(np.isnan(self.told_at[s]), level, self.told_at[s])
        self.running[s] = True

    def stride(self, dt: float) -> None:
        """Use steps of `dt` seconds from now on."""
        if dt == self.dt:
            return
        self._strides[self.dt], self._past[:] = self.balances, 0.0
        if dt not in self._strides:
            flows = zip(self._strings, self.flows.tolist(), strict=True)
            self._strides[dt] = self._balances([p.with_flow_ratio(ratio) for p, ratio in flows], dt, self.at.sensors)
        self.dt, self.balances, self.decay = dt, self._strides[dt], np.exp(-dt / self.usual.lasts_s)

    def made(self) -> tuple[Floats, Floats]:
        """Heat of each string (S,) over the heat of its current by the model, and the variance of this ratio."""
        n = [self.at.load, self.at.brisk]
        return 1.0 + self.z[:, n].sum(axis=1), self.P[:, n][:, :, n].sum(axis=(1, 2))

    def parameters(self, s: int) -> StringParameters:
        """Numbers of string `s` at nominal flow."""
        return self._strings[s]

    def set_parameters(self, s: int, p: StringParameters) -> None:
        """Use other numbers for string `s`; the states that describe differences from the old numbers are converted."""
        old, at = self._strings[s], self.at
        if self.running[s] and (p.R_e != old.R_e).any():
            self.z[s, at.load] = (1.0 + self.z[s, at.load]) * float(np.mean(self.falls[s])) - 1.0
            self.told_at[s] = self.z[s, 0 : at.nodes : 2]
        self.z[s, at.load] = (1.0 + self.z[s, at.load]) * float(np.exp(np.mean(np.log(old.R_e / p.R_e)))) - 1.0
        self.z[s, at.flow] = 1.0 - (1.0 - self.z[s, at.flow]) * float(np.exp(np.mean(np.log(p.R_u / old.R_u))))
        self._exchange(s, p.with_flow_ratio(float(self.flows[s])))
        self._strings[s] = p

    def set_flow(self, s: int, ratio: float) -> None:
        """Set the coolant flow of string `s`, over nominal."""
        self._exchange(s, self._strings[s].with_flow_ratio(ratio))
        self.flows[s] = ratio

    def _balances(self, strings: Sequence[StringParameters], dt: float, sensors: Ints) -> Balances:
        return Balances.of(strings, dt, self._ticks, sensors)

    def _exchange(self, s: int, p: StringParameters) -> None:
        one = self._balances([p], self.dt, self.at.sensors[s : s + 1])
        self.balances = self.balances.with_string(s, one)
        self._strides.clear()

    @property
    def falls(self) -> Floats:
        """R_e of each cell (S, n) over the identified one: it falls as the core warms."""
        warmed = np.nan_to_num(self.z[:, 0 : self.at.nodes : 2] - self.told_at)
        ln = np.clip(-FALL * warmed, -MOST_FALL, MOST_FALL)
        return np.asarray(np.exp(np.where(self.plain[:, None], ln, 0.0)), dtype=np.float64)

    def step(self, m: Step) -> Linear:
        """Advance one step and use its readings."""
        at, b, z = self.at, self.balances, self.z
        N = at.nodes
        self.before = z[:, at.common].copy()
        late = self._coolant.take(z[:, at.inlet], m.inlet1 - m.inlet0, self.dt)
        heated, q = b.heated(m.heat), m.heat.mean(axis=0)
        row = np.arange(at.strings)[:, None]
        # an older reading counts as read at the step's start, corrected by the casings' change since
        when = m.when[:, :, b.ticks :].copy()
        when[:, :, 0] += m.when[:, :, : b.ticks].sum(axis=2)
        both = Response(np.concatenate((b.end.of, np.matmul(when[:, :, None, :], b.at.of)[:, :, 0]), axis=1))
        heated_at = heated[:, row, 2 * at.sensors + 1].transpose(1, 2, 0)
        heated_both = np.concatenate((heated[-1], (heated_at * when).sum(axis=2)), axis=1)
        casings = b.mean.free(z[:, :N], m.inlet0, m.inlet1) + np.tensordot(even(b.ticks), heated[:, :, 1::2], 1)
        around = Around.of(b, casings, (m.inlet0 + m.inlet1) / 2.0 + self._coolant.off)
        by = Unknown.of(b, at, z, q, around, m.current, self.film)
        X, moved = coupling(both, at, z, by, heated_both)
        T = both.free(z[:, :N], m.inlet0, m.inlet1) + heated_both + moved
        z1, mean = np.concatenate((T[:, :N], z[:, N:] * self.decay), axis=1), T[:, N:]
        self.calm = np.asarray((q < CALM_RATE * b.C).all(axis=1), np.bool_)
        # Linearised about the identified films. If the heat kept by a lost film grew with the gap here, each new value
        # of the loss would distinguish a film from an offset of the inlet although no reading does, and the loss of the
        # films would be falsely certain and drift (Huang et al., 2008).
        G = np.concatenate((both.Phi, X), axis=2)
        k = np.arange(at.sensed)
        G[:, N + k, at.bias.start + k] = 1.0
        before, after = z[row, 2 * at.sensors + 1], z1[row, 2 * at.sensors + 1]
        there = np.isfinite(m.y) & at.fitted
        earlier = (m.when[:, :, : b.ticks] * self._past).sum(axis=2)
        nu = np.where(there, m.y - mean - earlier - z[:, at.bias], 0.0)
        inputs = np.concatenate((z[:, :N], np.zeros_like(z[:, :N]), m.inlet0[:, None], m.inlet1[:, None]), axis=1)
        path = np.matmul(b.at.of, inputs[:, None, :, None])[:, :, :, 0] + heated_at
        self._past = path[:, :, :-1] - path[:, :, -1:]
        P, PHt, S = self._spread(G, both, q, late)
        S[:, k, k] += np.where(there, m.R, DEAF)
        S_inv = np.asarray(np.linalg.inv(S), dtype=np.float64)
        K = np.matmul(PHt, S_inv)
        # one or two thermocouples cannot separate a cell's heat from common changes: these are held meanwhile
        held = np.flatnonzero(self.usual.alone & self.open.any(axis=1))
        K[held, at.common] = 0.0
        # Without current, films show only by a gap that the coolant has made. Without such a gap the readings do not
        # contain their values, and a gap from the heat of one cell does not show how large that heat is: the films
        # would absorb a part of it.
        still = np.flatnonzero(self.calm & ((np.abs(around.gap) < STILL_K).all(axis=1) | self.open.any(axis=1)))
        K[still, at.flow] = 0.0
        self.z = z1 + np.matmul(K, nu[:, :, None])[:, :, 0]
        most = np.where(self.usual.alone & self.calm, STOPPED, MOST_LOSS)
        self.z[:, at.flow] = np.clip(self.z[:, at.flow], LEAST_LOSS, most)
        self.z[:, at.own_flow] = np.clip(self.z[:, at.own_flow], -MOST_OWN, MOST_OWN)
        less = np.matmul(K, PHt.transpose(0, 2, 1))
        # the variance of a fixed state is kept, as in a Schmidt-Kalman filter
        less[held, at.common] = less[held, :, at.common].transpose(0, 2, 1)
        less[still, at.flow] = less[still, :, at.flow]
        P -= less
        self.P = (P + P.transpose(0, 2, 1)) / 2.0
        coolant = b.coolant(z1[:, 1:N:2], m.inlet1 + z1[:, at.inlet])[row, at.sensors]
        rate = np.asarray((after - before) / self.dt, dtype=np.float64)
        return Linear(G, K, S_inv, nu, S[:, k, k], coolant, after, rate, mean + earlier)

    def _spread(self, G: Floats, r: Response, heat: Floats, late: Floats) -> tuple[Floats, Floats, Floats]:
        """Covariances after a step, before its readings are used: of the states, with the readings, of the readings.

        Rough heat in the step's cores, and an inlet that the cells feel late, move its end and its readings alike, by
        `r`: 2n + m temperatures.
        """
        at, N, P, decay = self.at, self.at.nodes, self.P, self.decay
        rough = (np.square(ROUGH_RATE * self.balances.C) + np.square(ROUGH_SHARE * heat)) * (ROUGH_S / self.dt)
        GP = np.matmul(G, P)
        by = np.concatenate((r.core, r.inlet.sum(axis=-1, keepdims=True)), axis=2)
        white = by * np.concatenate((rough, late[:, None]), axis=1)[:, None, :]
        moved = np.matmul(GP, G.transpose(0, 2, 1)) + np.matmul(white, by.transpose(0, 2, 1))
        beside = GP[:, :, N:] * decay
        out, with_read = np.empty_like(P), np.empty((at.strings, at.states, at.sensed))
        out[:, :N, :N], with_read[:, :N] = moved[:, :N, :N], moved[:, :N, N:]
        out[:, :N, N:] = beside[:, :N]
        out[:, N:, :N], with_read[:, N:] = beside[:, :N].transpose(0, 2, 1), beside[:, N:].transpose(0, 2, 1)
        out[:, N:, N:] = P[:, N:, N:] * (decay[:, None] * decay)
        k = np.arange(N, at.states)
        out[:, k, k] += np.square(self.usual.sd[:, N:]) * (1.0 - np.square(decay))
        b = np.arange(at.bias.start, at.bias.stop)
        out[:, b, b] += BIAS_WALK**2 * self.dt / HOUR_S
        if self.open.any():
            h = np.arange(at.heat.start, at.heat.stop)
            out[:, h, h] += np.where(self.open, np.square(self._open_sd) * (2.0 * self.dt / OPEN_S), 0.0)
        return out, with_read, moved[:, N:, N:]

    def set_common(self, s: int, z: Floats, P: Floats) -> None:
        """Set the states common to all cells of string `s` to values (6,) of this covariance, independent of others."""
        c = self.at.common
        self.z[s, c] = z
        self._coolant.off[s] = self.z[s, self.at.inlet]
        self.P[s, c, :], self.P[s, :, c] = 0.0, 0.0
        self.P[s, c, c] = P

    def move(self, s: int, along: Floats, amplitude: float, var: float) -> None:
        """Shift the states of string `s` along a direction (N,) by `amplitude`, which has the variance `var`."""
        self.z[s] += along * amplitude
        self.P[s] += var * np.outer(along, along)

    def doubt_offset(self, s: int, place: int, residual: float) -> None:
        """Let thermocouple `place` of string `s`, which is used again, have an offset of about this size, K."""
        i = self.at.bias.start + place
        self.part(s, i, self.usual.sd[s, i] ** 2 + residual**2)

    def part(self, s: int, i: int, var: float) -> None:
        """Let state `i` of string `s` be known with this variance, and independent of the others."""
        self.P[s, i, :], self.P[s, :, i] = 0.0, 0.0
        self.P[s, i, i] = var

    def open_heat(self, s: int, k: int, watts: float) -> None:
        """Allow unexplained heat in the `k`-th observed cell from now on."""
        self.open[s, k] = True
        held = abs(float(self.z[s, self.at.heat.start + k]))  # heat that may be in several cells is stored for each
        self._open_sd[s, k] = max(OPEN_RATE * self.usual.C[s, k], 0.5 * abs(watts), 0.5 * held)

    def close_heat(self, s: int, k: int) -> None:
        """Treat the `k`-th observed cell as sound again."""
        self.open[s, k] = False
        at, h = self.at, self.at.heat.start + k
        ratio = min(1.0, self.usual.sd[s, h] / float(np.sqrt(self.P[s, h, h])))
        self.P[s, h, :] *= ratio
        self.P[s, :, h] *= ratio
        self.z[s, at.heat.start + k] = 0.0
