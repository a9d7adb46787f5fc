r"""Faults held against each other: what each would have done to the surprises of the heat filter, and how well it fits.

A fault of amplitude f that began at θ moves the true numbers away from the filtered ones by s f, where s obeys the
filter's own loop, and it moves the surprises by g f (Willsky and Jones, 1976):

.. math::
    s^- = F s, \quad g = H s + d, \quad s = s^- - K g,

with s = e_j at θ for a fault that is a jump of the j-th number, and d what a fault of a thermocouple adds to its
reading. Of the surprises ν with covariance S then

.. math::
    C = \sum g^T S^{-1} g, \quad D = \sum g^T S^{-1} ν, \quad
    \ln E = \frac{D^2}{2 (C + 1/σ^2)} - \frac{1}{2} \ln(1 + σ^2 C)

is the ln of the evidence for the fault, of prior sd σ, over none. Instants θ are kept at ages of even ratios up to an
hour. Everything is linear, so all faults of all strings go through one product.

References
----------
A. S. Willsky, H. L. Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems, IEEE TAC 21 (1976).
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from bms_gateway.health.heat.filter import HeatFilter, Linear
from bms_gateway.health.heat.layout import COMMON, Ints
from bms_gateway.thermal import Floats

ONSETS = 10
OLDEST = 3600.0
"""s: what is older has gone into what the filter carries,"""
OLDEST_READ = 20
"""if it was read in so many steps since; frames of a parked string are rare."""
HEAT_SIZE = 4e-2
"""K/s of the cell's heat capacity: prior sd of a fault's heat."""


class Kind(IntEnum):
    """Kinds of faults."""

    HEAT = 0
    JUMP = 1
    SLOPE = 2
    LOOSE = 3
    LAG = 4
    FLOW = 5
    INLET = 6
    LOAD = 7


SIZE = {
    Kind.JUMP: 1.5,  # K
    Kind.SLOPE: 1.5,  # K/h
    Kind.LOOSE: 0.4,  # share of the coolant in the reading
    Kind.LAG: 0.7,  # share of a reading that follows in `LATE_S`
    Kind.FLOW: 0.5,  # share of the film's conductance lost
    Kind.INLET: 3.0,  # K
    Kind.LOAD: 0.7,  # share of the heat
}
"""Prior sd of the amplitudes."""
LATE_S = 90.0
"""A thermocouple that has come off its cell follows it so late; less lag is a smaller share."""
LIKELY_LN, NEAR_LN = 5.0, 24.0
"""ln evidence from which on the likeliest onset of a fault is kept, and distance from the likeliest fault up to which:
one fault is told from another only if both are tried since when they would have begun."""
SLOPE_S = 600.0
"""A drift is told from heat by its shape after so long: heat has come to rest by then."""
MOST = {Kind.SLOPE: 4.0, Kind.LOOSE: 1.3, Kind.LAG: 1.6, Kind.FLOW: 1.0, Kind.LOAD: 1.5}
"""Amplitudes beyond are none: a reading that climbs or falls by more kelvin in an hour is no drift but a cell that
heats or what a model lacks, and cells that seem to make so much more heat than the current are cooled less."""


@dataclass(frozen=True, slots=True)
class Weighed:
    """Evidence for each fault at each onset, (S, onsets, faults).

    Attributes
    ----------
    ln : ndarray
        Of the evidence over that for none; −inf where the amplitude has a sign that there is none of.
    amplitude, var : ndarray
        Posterior.
    """

    ln: Floats
    amplitude: Floats
    var: Floats


class Evidence:
    """Faults of the strings of a filter.

    Attributes
    ----------
    kinds, place : ndarray of int (H,)
        Kind of each fault, and the number of its cell or sensor among those told of.
    at : Layout
    of : HeatFilter
    """

    def __init__(self, of: HeatFilter) -> None:
        at = of.at
        m, a, S = at.sensed, at.near, at.strings
        sensor_kinds = (Kind.JUMP, Kind.SLOPE, Kind.LOOSE, Kind.LAG)
        common = {Kind.FLOW: at.flow, Kind.INLET: at.inlet, Kind.LOAD: at.load}
        self.kinds = np.array([*[Kind.HEAT] * a, *(k for k in sensor_kinds for _ in range(m)), *common], np.int64)
        self.place = np.array([*range(a), *(j for _ in sensor_kinds for j in range(m)), 0, 0, 0], np.int64)
        H = len(self.kinds)
        self._first = np.zeros((at.states, H))
        self._first[np.arange(at.heat.start, at.heat.stop), np.arange(a)] = 1.0
        self._first[np.arange(at.bias.start, at.bias.stop), a + np.arange(m)] = 1.0
        for j, place in enumerate(common.values()):
            self._first[place, a + 4 * m + j] = 1.0
        size = np.array([[SIZE.get(Kind(k), 1.0) for k in self.kinds]] * S)
        size[:, :a] = HEAT_SIZE * of.usual.C
        self._size2: Floats = np.square(size)[:, None, :]
        real = np.ones((S, H), np.bool_)
        real[:, :a] = at.seen
        for j in range(4):
            real[:, a + j * m : a + (j + 1) * m] = at.fitted
        self._real = real[:, None, :]
        self._most = np.array([MOST.get(Kind(k), np.inf) for k in self.kinds])
        self._least = np.where(self.kinds == Kind.SLOPE, -self._most, -np.inf)
        self._least[np.isin(self.kinds, (Kind.HEAT, Kind.LAG, Kind.LOOSE))] = 0.0
        self.at, self.of = at, of
        self._s = np.zeros((S, at.states, ONSETS, H))
        self._C, self._D = np.zeros((2, S, ONSETS, H))
        self._born = np.zeros((S, ONSETS))  # s, of the onset
        self._before = np.zeros((S, ONSETS, COMMON))
        self._late = np.full((S, m, ONSETS), np.nan)
        self._tried = 0  # onsets so far, at most as many as there are places
        self._birth = np.zeros((S, ONSETS))  # s
        self._read_before = np.zeros((S, ONSETS), np.int64)
        self._dear = np.zeros((S, ONSETS), np.bool_)
        self._read = 0  # steps with readings
        self.now = 0.0  # s of the filter's steps
        for s in range(S):
            self.forget(s)

    def forget(self, s: int) -> None:
        """Begin anew with string `s`."""
        self._s[s] = self._first[:, None, :]
        self._C[s], self._D[s] = 0.0, 0.0
        self._born[s], self._before[s] = self.now, self.of.before[s]
        self._late[s] = np.nan

    def take(self, x: Linear, *, read: bool = True) -> None:
        """Take in one step of the filter; `read`: of which readings came."""
        self._dear &= read  # in a sleep, onsets that may begin in it matter as much
        self._begin()
        self._read += read
        at, H = self.at, len(self.kinds)
        N, m, a = at.nodes, at.sensed, at.near
        flat = self._s.reshape(at.strings, at.states, ONSETS * H)
        moved = np.matmul(x.G, flat)
        g = moved[:, N:].reshape(at.strings, m, ONSETS, H)
        decay = self.of.decay
        s = np.concatenate((moved[:, :N], flat[:, N:] * decay[:, None]), axis=1)
        if not read:  # a fault lasts while the filter forgets; this shows only where frames are rare
            lasting = s.reshape(at.strings, at.states, ONSETS, H)
            j = np.arange(a)
            lasting[:, at.heat.start + j, :, j] += 1.0 - decay[at.heat.start - N]
        self.now += self.of.dt
        k = np.arange(m)
        hours = (self.now - self._born) / 3600.0
        g[:, k, :, a + m + k] += hours
        g[:, k, :, a + 2 * m + k] += (x.coolant - x.mean).T[:, :, None]
        g[:, k, :, a + 3 * m + k] += self._lagging(x).transpose(1, 0, 2)
        g = g.reshape(at.strings, m, ONSETS * H)
        V = np.matmul(x.S_inv, g)
        shape = at.strings, ONSETS, H
        self._C += np.einsum("smj,smj->sj", g, V).reshape(shape)
        self._D += np.einsum("smj,sm->sj", V, x.nu).reshape(shape)
        s -= np.matmul(x.K, g)
        self._s = s.reshape(self._s.shape)

    def _lagging(self, x: Linear) -> Floats:
        """Tell what readings (S, m, onsets) that follow late since the onset are off in the mean of a step, K."""
        before = (x.surface - x.rate * self.of.dt)[:, :, None]
        late = np.where(np.isnan(self._late), before, self._late)
        self._late = late + (x.mean[:, :, None] - late) * -np.expm1(-self.of.dt / LATE_S)
        return np.asarray((late + self._late) / 2.0 - x.mean[:, :, None], dtype=np.float64)

    def _begin(self) -> None:
        """Let one more onset begin now, in each string in the place of the one that is missed least."""
        row = np.arange(self.at.strings)
        slot = self._spare() if self._tried == ONSETS else np.full_like(row, self._tried)
        self._tried = min(self._tried + 1, ONSETS)
        self._birth[row, slot], self._read_before[row, slot] = self.now, self._read
        self._s[row, :, slot] = self._first
        self._C[row, slot], self._D[row, slot] = 0.0, 0.0
        self._born[row, slot], self._before[row, slot] = self.now, self.of.before
        self._late[row, :, slot] = np.nan

    def _spare(self) -> Ints:
        """Places (S,) of the onsets that are missed least: ages stay in even ratios, and what is likeliest stays."""
        row, order = np.arange(self.at.strings), np.argsort(self._birth, axis=1)
        ages = self.now + self.of.dt - np.take_along_axis(self._birth, order, axis=1)
        ratios = ages[:, :-2] / ages[:, 2:]
        dear = np.take_along_axis(self._dear, order, axis=1)[:, 1:-1]
        ratios = ratios + np.where(dear & ~dear.all(axis=1, keepdims=True), 1e3, 0.0)
        read = self._read - self._read_before[row, order[:, 0]]
        old = (ages[:, 0] > OLDEST) & (read >= OLDEST_READ)
        return np.asarray(order[row, np.where(old, 0, ratios.argmin(axis=1) + 1)], np.int64)

    def weigh(self) -> Weighed:
        """Weigh all faults."""
        prec = self._C + 1.0 / self._size2
        amplitude = self._D / prec
        ln = 0.5 * self._D * amplitude - 0.5 * np.log(1.0 + self._size2 * self._C)
        young = (self.now - self._born)[:, :, None] < SLOPE_S
        ln = np.where(young & (self.kinds == Kind.SLOPE), -np.inf, ln)
        ln = np.where(self._real & (amplitude > self._least) & (amplitude < self._most), ln, -np.inf)
        best = ln.max(axis=1, keepdims=True)
        likely = best > np.maximum(best.max(axis=2, keepdims=True) - NEAR_LN, LIKELY_LN)
        self._dear = np.asarray(((ln == best) & likely).any(axis=2), np.bool_)
        return Weighed(ln, amplitude, 1.0 / prec)

    def moved(self, s: int, onset: int, fault: int) -> Floats:
        """Tell what the fault of amplitude 1 has done to the numbers (N,) of string `s`."""
        return np.asarray(self._s[s, :, onset, fault], dtype=np.float64)

    def before(self, s: int, onset: int) -> Floats:
        """Tell what was common to all cells (5,) of string `s` before an onset."""
        return np.asarray(self._before[s, onset], dtype=np.float64)

    def ages(self, s: int) -> Floats:
        """Tell how many seconds ago each onset (onsets,) of string `s` was."""
        return np.asarray(self.now - self._born[s], dtype=np.float64)

    def reads(self, s: int, onset: int) -> int:
        """Tell in how many steps with readings an onset of string `s` has been tried."""
        return self._read - int(self._read_before[s, onset])

    def resolution(self, age_s: float) -> Floats:
        """Sd (S, a) to which heat of each cell is told that began about so many seconds ago, W."""
        a = self.at.near
        tried = np.s_[:, : max(1, self._tried)]
        row, slot = np.arange(self.at.strings), np.abs(self.now - self._birth[tried] - age_s).argmin(axis=1)
        return np.asarray(1.0 / np.sqrt(self._C[row, slot, :a] + 1.0 / self._size2[:, 0, :a]), dtype=np.float64)
