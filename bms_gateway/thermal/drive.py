"""Inputs of a string over a record, as means over the intervals of one uniform grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isnan

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal.parameters import Floats

KNOWN_NAMES = frozenset({"flow", "soc", "voltage"})


@dataclass(frozen=True, slots=True)
class Drive:
    r"""Input means over N intervals of dt; N + 1 instants bound them.

    .. math:: \bar u_k = \frac{1}{\Delta t} \int_{k \Delta t}^{(k+1) \Delta t} u \, dt

    The mean square, the mean magnitude and the mean product with the voltage are stored with the mean current, because
    heat depends on them and they do not follow from the mean if the current changes within an interval.

    Parameters
    ----------
    dt : float
        Length of every interval, s.
    I, I2, I_abs : (N,)
        Current (discharge positive), A; its square, A²; its magnitude, A.
    T_in : (N,)
        Coolant inlet, °C.
    flow : (N,)
        Coolant flow over nominal; 1 if it was not recorded.
    soc : (N,)
        State of charge, 0…1; counted from 0.5 if its start is unknown.
    V, IV : (N,)
        Mean voltage of a cell, V, and the mean of current times that voltage, W; NaN without a voltage.
    hours : (N,)
        The interval's middle, in hours since the record began.
    known : frozenset of "flow", "soc", "voltage"
        Which of these were recorded or could be counted. The others have their neutral value.

    Raises
    ------
    ValueError
        When an array has another length than the others, or `dt` is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> one, none = np.ones(2), np.full(2, np.nan)
    >>> Drive(1.0, 10 * one, 100 * one, 10 * one, 20 * one, one, 0.5 * one, none, none, 0 * one, frozenset()).N
    2
    """

    dt: float
    I: Floats  # noqa: E741 - the paper's symbol
    I2: Floats
    I_abs: Floats
    T_in: Floats
    flow: Floats
    soc: Floats
    V: Floats
    IV: Floats
    hours: Floats
    known: frozenset[str]

    def __post_init__(self) -> None:
        shape = (np.size(self.I),)
        for name in ("I", "I2", "I_abs", "T_in", "flow", "soc", "V", "IV", "hours"):
            if np.shape(getattr(self, name)) != shape:
                raise ValueError(f"{name} of a drive has shape {np.shape(getattr(self, name))}, the current {shape}")
        if not self.dt > 0.0:
            raise ValueError(f"the intervals of a drive last {self.dt} s: must be above 0")
        if strange := sorted(self.known - KNOWN_NAMES):
            raise ValueError(f"a drive knows nothing called {strange[0]!r}: {', '.join(sorted(KNOWN_NAMES))}")

    @property
    def N(self) -> int:
        """Number of intervals."""
        return int(self.I.size)


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a record with one start: intervals `first` to `last` (not included)."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first


def cut(u: Drive, first: int, last: int) -> Drive:
    """Intervals `first` to `last` (not included) of a drive."""
    if first == 0 and last == u.N:
        return u
    return _map(u, lambda x: x[first:last])


def average(u: Drive) -> Drive:
    """Return one interval with the means of all intervals; missing values, of a voltage for example, are left out."""
    return _map(u, _mean)


def _mean(x: Floats) -> Floats:
    mean: Floats = np.add.reduce(x, keepdims=True)  # as np.mean, in half of its time
    mean /= len(x)
    if isnan(mean[0]) and np.isfinite(x).any():  # nanmean takes ten times as long
        return np.atleast_1d(np.nanmean(x))
    return mean


def at_instants(u: Drive) -> Drive:
    """Return the inputs at the N + 1 instants that bound the intervals: means of the neighbours."""
    return _map(u, between)


def every_second(u: Drive, spans: Sequence[Span]) -> tuple[Drive, tuple[Span, ...], NDArray[np.intp]]:
    """Join the intervals of each span in pairs; an odd last interval is left out.

    Returns
    -------
    u : Drive
        Means over the pairs.
    spans : tuple of Span
    rows : ndarray of int
        Rows of a trajectory under the old drive at the instants of the new one.
    """
    pairs, new, rows, row, last = [], [], [], 0, 0
    for s in spans:
        half = len(s) // 2
        pairs.append(s.first + 2 * np.arange(half))
        rows.append(row + 2 * np.arange(half + 1))
        new.append(Span(last, last + half))
        row, last = row + len(s) + 1, last + half
    k = np.concatenate(pairs)
    return replace(_map(u, lambda x: 0.5 * (x[k] + x[k + 1])), dt=2.0 * u.dt), tuple(new), np.concatenate(rows)


def between(x: Floats) -> Floats:
    """Values (N + 1, …) at the instants that bound N intervals: means of the neighbours."""
    return np.concatenate([x[:1], (x[1:] + x[:-1]) / 2.0, x[-1:]])


def _map(u: Drive, change: Callable[[Floats], Floats]) -> Drive:
    return replace(
        u,
        I=change(u.I),
        I2=change(u.I2),
        I_abs=change(u.I_abs),
        T_in=change(u.T_in),
        flow=change(u.flow),
        soc=change(u.soc),
        V=change(u.V),
        IV=change(u.IV),
        hours=change(u.hours),
    )
