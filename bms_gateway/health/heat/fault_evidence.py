r"""Comparison of faults: how each would change the innovations of the heat filter, and how well this fits.

A fault of amplitude f that began at θ moves the true numbers away from the filtered ones by s f. s follows the filter's
own loop, and the fault changes the innovations by g f (Willsky and Jones, 1976):

.. math::
    s^- = F s, \quad g = H s + d, \quad s = s^- - K g,

with s = e_j at θ for a fault that is a jump of the j-th number, and d the effect of a thermocouple's fault on its
reading. With innovations ν of covariance S,

.. math::
    C = \sum g^T S^{-1} g, \quad D = \sum g^T S^{-1} ν, \quad
    \ln E = \frac{D^2}{2 (C + 1/σ^2)} - \frac{1}{2} \ln(1 + σ^2 C)

is the ln of the evidence for the fault, of prior sd σ, over no fault. Instants θ are kept at ages in constant ratios up
to an hour. Everything is linear, so all faults of all strings are computed in one product.

References
----------
A. S. Willsky, H. L. Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems, IEEE TAC 21 (1976).
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np

from bms_gateway.health.heat.filter import HeatFilter, Linear
from bms_gateway.health.heat.layout import COMMON, Bools, Ints, Layout
from bms_gateway.health.heat.several import Likes, Products
from bms_gateway.health.heat.usual import REFERENCE
from bms_gateway.thermal import Floats

ONSETS = 10
OLDEST = 3600.0
"""s: older onsets are already contained in the filter's state,"""
OLDEST_READ = 20
"""if there were so many steps with readings since; frames of a parked string are rare."""
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
    STREAM = 8


ALIKE = (Kind.HEAT, Kind.JUMP, Kind.LOOSE, Kind.LAG)
"""Kinds of which several faults may begin together: a crash, a leak or a hand in a pack strikes more than one cell."""
SIZE = {
    Kind.JUMP: 1.5,  # K
    Kind.SLOPE: 1.5,  # K/h
    Kind.LOOSE: 0.4,  # share of the coolant in the reading
    Kind.LAG: 0.7,  # share of a reading that follows with the lag `LATE_S`
    Kind.FLOW: 0.5,  # share of the film's conductance lost
    Kind.INLET: 3.0,  # K
    Kind.LOAD: 0.7,  # share of the heat
    Kind.STREAM: 0.4,  # share of the coolant's warming along the string
}
"""Prior sd of the amplitudes."""
LATE_S = 90.0
"""Lag of a thermocouple that has come off its cell; a smaller lag is a smaller share."""
LIKELY_LN, NEAR_LN = 5.0, 24.0
"""ln evidence above which the likeliest onset of a fault is kept, and distance from the likeliest fault up to which
other onsets are kept: two faults can be distinguished only if both are tried since their beginning."""
SLOPE_S = 600.0
"""Time after which a drift can be recognised: its shape differs from that of heat when the heat has settled."""
ONE_FAULT_S = 1800.0
"""Time for which the likeliest heat or drift counts as one fault, and not as a defect of the model; and time after a
start in which no fault counts."""
MOST = {Kind.SLOPE: 4.0, Kind.LOOSE: 1.3, Kind.LAG: 1.6, Kind.FLOW: 1.0, Kind.LOAD: 1.5, Kind.STREAM: 1.0}
"""Limits of the amplitudes. A reading that changes by more kelvin in an hour is a cell that heats or a defect of the
model, no drift. Cells that seem to make so much more heat than the current are cooled less."""


@dataclass(frozen=True, slots=True)
class Weighed:
    """Evidence for each fault at each onset, (S, onsets, faults).

    Attributes
    ----------
    ln : ndarray
        ln evidence over no fault; −inf if the sign of the amplitude is impossible.
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
        Kind of each fault, and the number of its observed cell or sensor.
    at : Layout
    of : HeatFilter
    products : Products
        Of the pairs of faults of one kind.
    """

    def __init__(self, of: HeatFilter) -> None:
        at = of.at
        m, a, S = at.sensed, at.near, at.strings
        sensor_kinds = (Kind.JUMP, Kind.SLOPE, Kind.LOOSE, Kind.LAG)
        common = {Kind.FLOW: at.flow, Kind.INLET: at.inlet, Kind.LOAD: at.load, Kind.STREAM: at.stream}
        self.kinds = np.array([*[Kind.HEAT] * a, *(k for k in sensor_kinds for _ in range(m)), *common], np.int64)
        self.place = np.array([*range(a), *(j for _ in sensor_kinds for j in range(m)), *[0] * len(common)], np.int64)
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
        real[:, self.kinds == Kind.STREAM] = ~of.usual.alone[:, None]
        self._real = real[:, None, :]
        most = np.array([MOST.get(Kind(k), np.inf) for k in self.kinds])
        least = np.where(self.kinds == Kind.SLOPE, -most, -np.inf)
        least[np.isin(self.kinds, (Kind.HEAT, Kind.LAG, Kind.LOOSE))] = 0.0
        self._range = least, most  # of the amplitudes
        self.of = of
        self.products = Products(self.kinds, S, ONSETS, ALIKE)
        self._s = np.zeros((S, at.states, ONSETS, H))
        self._C, self._D = np.zeros((2, S, ONSETS, H))
        self._born = np.zeros((S, ONSETS))  # s, of the onset
        self._before = np.zeros((S, ONSETS, COMMON))
        self._late = np.full((S, m, ONSETS), np.nan)
        self._tried = 0  # number of onsets so far, at most the number of places
        self._birth = np.zeros((S, ONSETS))  # s
        self._read_before = np.zeros((S, ONSETS), np.int64)
        self._dear = np.zeros((S, ONSETS), np.bool_)
        self._read = 0  # steps with readings
        self.now = 0.0  # s of the filter's steps
        for s in range(S):
            self.forget(s)

    @property
    def at(self) -> Layout:
        """Order of the states."""
        return self.of.at

    @cached_property
    def group(self) -> Ints:
        """0-based cell of the thermocouple that is nearest to each fault (S, H); −1 for faults of all cells."""
        at, kinds = self.at, self.kinds
        near, group = np.take_along_axis(at.nearest(), at.told, axis=1), np.full((at.strings, len(kinds)), -1)
        heat, own = kinds == Kind.HEAT, (kinds > Kind.HEAT) & (kinds < Kind.FLOW)
        group[:, heat], group[:, own] = near[:, self.place[heat]], at.sensors[:, self.place[own]]
        return group

    def forget(self, s: int) -> None:
        """Start again with string `s`."""
        self._s[s] = self._first[:, None, :]
        self._C[s], self._D[s] = 0.0, 0.0
        self.products.begin(s, np.s_[:])
        self._born[s], self._before[s] = self.now, self.of.before[s]
        self._late[s] = np.nan

    def renew(self, s: int) -> None:
        """Note that the states common to all cells of string `s` have been set back to earlier values.

        No fault of a cell or thermocouple has moved them so far, and faults of all cells begin again.
        """
        of_all = self.kinds >= Kind.FLOW
        self._s[s, self.at.common] = 0.0
        self._s[s][:, :, of_all] = self._first[:, None, of_all]
        self._C[s][:, of_all] = self._D[s][:, of_all] = 0.0

    def take(self, x: Linear, *, read: bool = True) -> None:
        """Include one step of the filter; `read`: which readings came."""
        self._dear &= read  # in a sleep, all onsets that may begin in it are equally important
        self._begin()
        self._read += read
        at, H = self.at, len(self.kinds)
        N, m, a = at.nodes, at.sensed, at.near
        flat = self._s.reshape(at.strings, at.states, ONSETS * H)
        moved = np.matmul(x.G, flat)
        g = moved[:, N:].reshape(at.strings, m, ONSETS, H)
        decay = self.of.decay
        s = np.concatenate((moved[:, :N], flat[:, N:] * decay[:, None]), axis=1)
        if not read:  # a fault lasts while the filter forgets; this is visible only where frames are rare
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
        each = at.strings, m, ONSETS, H
        self.products.take(g.reshape(each), V.reshape(each))
        s -= np.matmul(x.K, g)
        self._s = s.reshape(self._s.shape)

    def _lagging(self, x: Linear) -> Floats:
        """Error in the mean of a step, K, of readings (S, m, onsets) that lag since the onset."""
        before = (x.surface - x.rate * self.of.dt)[:, :, None]
        late = np.where(np.isnan(self._late), before, self._late)
        self._late = late + (x.mean[:, :, None] - late) * -np.expm1(-self.of.dt / LATE_S)
        return np.asarray((late + self._late) / 2.0 - x.mean[:, :, None], dtype=np.float64)

    def _begin(self) -> None:
        """Start one more onset now; in each string, it replaces the least important one."""
        row = np.arange(self.at.strings)
        slot = self._spare() if self._tried == ONSETS else np.full_like(row, self._tried)
        self._tried = min(self._tried + 1, ONSETS)
        self._birth[row, slot], self._read_before[row, slot] = self.now, self._read
        self._s[row, :, slot] = self._first
        self._C[row, slot], self._D[row, slot] = 0.0, 0.0
        self.products.begin(row, slot)
        self._born[row, slot], self._before[row, slot] = self.now, self.of.before
        self._late[row, :, slot] = np.nan

    def _spare(self) -> Ints:
        """Places (S,) of the least important onsets: ages keep constant ratios, and likely onsets are kept."""
        row, order = np.arange(self.at.strings), np.argsort(self._birth, axis=1)
        ages = self.now + self.of.dt - np.take_along_axis(self._birth, order, axis=1)
        ratios = ages[:, :-2] / ages[:, 2:]
        dear = np.take_along_axis(self._dear, order, axis=1)[:, 1:-1]
        ratios = ratios + np.where(dear & ~dear.all(axis=1, keepdims=True), 1e3, 0.0)
        read = self._read - self._read_before[row, order[:, 0]]
        old = (ages[:, 0] > OLDEST) & (read >= OLDEST_READ)
        return np.asarray(order[row, np.where(old, 0, ratios.argmin(axis=1) + 1)], np.int64)

    def weigh(self, metered: Bools | None = None) -> Weighed:
        """Compute the evidence of all faults; in `metered` strings (S,), the flow is measured: no step is unseen."""
        prec = self._C + 1.0 / self._size2
        amplitude = self._D / prec
        ln = 0.5 * self._D * amplitude - 0.5 * np.log(1.0 + self._size2 * self._C)
        least, most = self._range
        ln = np.where(self._real & (amplitude > least) & (amplitude < most), ln, -np.inf)
        if metered is not None:
            ln[np.ix_(metered, np.arange(ONSETS), self.kinds == Kind.STREAM)] = -np.inf
        best = ln.max(axis=1, keepdims=True)
        likely = best > np.maximum(best.max(axis=2, keepdims=True) - NEAR_LN, LIKELY_LN)
        self._dear = np.asarray(((ln == best) & likely).any(axis=2), np.bool_)
        return Weighed(ln, amplitude, 1.0 / prec)

    def usual(self, w: Weighed, known: Bools) -> Floats:
        """Greatest ln evidence (S,) that may be usual in a string because of defects of its model.

        A drift is not usual. If heat or a drift has been the likeliest fault of a string for long (`known`, (S,)), no
        other evidence of the same thermocouple is usual either: a fault must not weaken its own evidence over time.
        """
        row, each = np.arange(self.at.strings), w.ln.max(axis=1)
        first = np.where(self.group >= 0, each, -np.inf).argmax(axis=1)
        born = self._born[row, w.ln[row, :, first].argmax(axis=1)]
        one = known & (self.now - born < ONE_FAULT_S) & np.isin(self.kinds[first], (Kind.HEAT, Kind.SLOPE))
        one &= self.at.fitted.sum(axis=1) >= REFERENCE
        own = one[:, None] & (self.group == self.group[row, first][:, None])
        return np.asarray(np.where(own | (self.kinds == Kind.SLOPE), -np.inf, each).max(axis=1), dtype=np.float64)

    def likes(self, s: int, kind: Kind) -> Likes:
        """Return all faults of a kind in string `s`, to be weighed in sets; those that it has not have no size."""
        here = self.products.faults[kind]
        real = self._real[s, 0, here]
        C = self.products.of(s, kind) * (real[:, None] & real)
        limits = float(self._range[0][here[0]]), float(self._range[1][here[0]])
        return Likes(C, self._D[s][:, here] * real, 1.0 / self._size2[s, 0, here], limits)

    def moved(self, s: int, onset: int, fault: int) -> Floats:
        """Change of the numbers (N,) of string `s` by the fault with amplitude 1."""
        return np.asarray(self._s[s, :, onset, fault], dtype=np.float64)

    def before(self, s: int, onset: int) -> Floats:
        """States common to all cells (6,) of string `s` before an onset."""
        return np.asarray(self._before[s, onset], dtype=np.float64)

    def ages(self, s: int) -> Floats:
        """Age, s, of each onset (onsets,) of string `s`."""
        return np.asarray(self.now - self._born[s], dtype=np.float64)

    def reads(self, s: int, onset: int) -> int:
        """Count the steps with readings since an onset of string `s`."""
        return self._read - int(self._read_before[s, onset])

    def resolution(self, age_s: float) -> Floats:
        """Sd (S, a), W, of the heat of each cell if it began about `age_s` ago."""
        a = self.at.near
        tried = np.s_[:, : max(1, self._tried)]
        row, slot = np.arange(self.at.strings), np.abs(self.now - self._birth[tried] - age_s).argmin(axis=1)
        return np.asarray(1.0 / np.sqrt(self._C[row, slot, :a] + 1.0 / self._size2[:, 0, :a]), dtype=np.float64)
