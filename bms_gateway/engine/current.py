"""Means of one current input over a tick: of I, |I|, I² and, with a voltage beside it, of V and I·V.

The heat of a tick needs the mean of the square, not the square of the mean. Between two samples the current is held,
because a battery monitor sends readings and not slopes. A sample is held for at most `HOLD_S`, so that a current that
is no longer received becomes unknown and does not keep its last value.
"""

from dataclasses import dataclass
from math import nan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

HOLD_S = 1.5  # a current sent once a second still covers its tick when it comes half a second late
COVERED = 0.5  # share of a tick that must be covered for its means to count


@dataclass(frozen=True, slots=True)
class Means:
    """Means over one tick; NaN where too little of it was covered.

    Attributes
    ----------
    I, I2, V, IV : float
        A, A², V, W.
    I_abs : float
        Mean magnitude of the current, A.
    """

    I: float = nan  # noqa: E741  the field's symbol
    I2: float = nan
    V: float = nan
    IV: float = nan
    I_abs: float = nan


@dataclass(slots=True)
class Current:
    """Integrates one current; keeps the last sample from tick to tick."""

    _t: int = 0
    _I: float = nan
    _V: float = nan
    _t_V: int = 0

    def update(
        self,
        time_ns: NDArray[np.int64],
        I: Floats,  # noqa: E741
        V_time_ns: NDArray[np.int64],
        V: Floats,
        t0: int,
        t1: int,
    ) -> Means:
        """Integrate one tick.

        Parameters
        ----------
        time_ns, I : ndarray (K,)
            Accepted current samples with t0 ≤ time < t1, A.
        V_time_ns, V : ndarray (L,)
            Accepted voltage samples of the same tick, V; empty where there is no voltage.
        t0, t1 : int
            The tick, ns.
        """
        starts, values = np.empty(len(I) + 1, np.int64), np.empty(len(I) + 1)
        starts[0], starts[1:] = t0, time_ns
        values[0], values[1:] = self._I, I
        spans = np.empty(len(starts))
        spans[:-1], spans[-1] = starts[1:] - starts[:-1], t1 - starts[-1]
        weight = np.minimum(spans * 1e-9, HOLD_S)
        left = HOLD_S - (t0 - self._t) * 1e-9 if self._I == self._I else 0.0
        weight[0] = min(weight[0], max(left, 0.0))
        if weight[0] == 0.0:
            values[0] = 0.0
        volts = self._volts_at(starts, V_time_ns, V)
        if len(I):
            self._t, self._I = int(time_ns[-1]), float(I[-1])
        if len(V):
            self._t_V, self._V = int(V_time_ns[-1]), float(V[-1])
        enough = COVERED * (t1 - t0) * 1e-9
        covered = float(weight.sum())
        if covered < enough:
            return Means()
        charge = weight * values
        mean_I, mean_I2 = float(charge.sum()) / covered, float((charge * values).sum()) / covered
        I_abs = float(np.abs(charge).sum()) / covered
        if volts is None:
            return Means(mean_I, mean_I2, I_abs=I_abs)
        known = np.isfinite(volts)
        weight, volts = np.where(known, weight, 0.0), np.where(known, volts, 0.0)
        both = float(weight.sum())
        if both < enough:
            return Means(mean_I, mean_I2, I_abs=I_abs)
        mean_V, mean_IV = float((weight * volts).sum()) / both, float((weight * values * volts).sum()) / both
        return Means(mean_I, mean_I2, mean_V, mean_IV, I_abs)

    def _volts_at(self, starts: NDArray[np.int64], times: NDArray[np.int64], V: Floats) -> Floats | None:
        """Return the newest voltage at or before each instant, NaN if it is too old; None if there is no voltage."""
        if not len(V) and self._V != self._V:
            return None
        t, v = np.empty(len(V) + 1, np.int64), np.empty(len(V) + 1)
        t[0], t[1:] = self._t_V, times
        v[0], v[1:] = self._V, V
        at = t.searchsorted(starts, side="right") - 1
        age = starts - t.take(at, mode="clip")
        return np.where((age >= 0) & (age <= HOLD_S * 1e9), v.take(at, mode="clip"), np.nan)

    def forget(self) -> None:
        """Forget the last sample: a measurement from before a gap does not hold after it."""
        self._I = self._V = nan
