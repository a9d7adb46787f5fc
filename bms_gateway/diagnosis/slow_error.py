r"""Noise of a model that differs from the cell: white, plus a slow Ornstein–Uhlenbeck discrepancy.

.. math::
    e_k = d_k + w_k, \qquad w_k \sim N(0, \sigma^2), \qquad \dot d = -d/\tau + v, \quad \operatorname{sd} d = s

With any thermocouple, two nodes with constant coefficients follow a real cell to a few hundredths of a kelvin at best,
and their error is slow. Treated as white noise, it makes superfluous effects look certain. Size s and time constant τ
are found for each hypothesis from its own marginal likelihood, on a grid: the innovations of the scalar Kalman filter
and their variances, for all grid points at once.

References
----------
Kennedy, O'Hagan: Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg

from bms_gateway.identify.coordinates import Measured
from bms_gateway.thermal import Floats

SIZES = (0.005, 0.01, 0.015, 0.022, 0.032, 0.047, 0.07, 0.1, 0.15, 0.22, 0.32, 0.5, 0.8)
"""K."""
TIMES = (20.0, 40.0, 80.0, 160.0, 320.0)
"""s: from the surface's own time constant to a few minutes; parameters explain slower errors."""
SIZE_PRIOR = (0.03, 1.0)
"""K, and sd of the logarithm: size of the lumped model's error on a cell that it fits well."""
TIME_PRIOR = (80.0, 0.7)
"""s, and sd of the logarithm."""


@dataclass(frozen=True, slots=True)
class Discrepancy:
    """Size [K] and time constant [s]."""

    size: float
    time: float

    @property
    def strain(self) -> float:
        """−2 log prior up to a constant."""
        a = np.log(self.size / SIZE_PRIOR[0]) / SIZE_PRIOR[1]
        b = np.log(self.time / TIME_PRIOR[0]) / TIME_PRIOR[1]
        return float(a * a + b * b)


START = Discrepancy(0.047, 80.0)
GRID = tuple(Discrepancy(s, t) for t, s in product(TIMES, SIZES))


@dataclass(frozen=True, slots=True)
class Series:
    """Readings of one thermocouple over one span.

    Attributes
    ----------
    rows : ndarray (K,) of int
        Their indices among the readings of all records.
    gaps : ndarray (K − 1,), s
    sigma : float, K
    """

    rows: np.ndarray
    gaps: Floats
    sigma: float


class Whitened:
    """Whitening by one discrepancy: a `Whitening` for `map_fit`."""

    def __init__(self, series: Sequence[Series], readings: int, d: Discrepancy) -> None:
        self._filters = [(s.rows, *_filter(s, d)) for s in series]
        self._readings = readings
        self.log_det = sum(float(np.sum(np.log(S))) for _, S, _, _ in self._filters)

    def __call__(self, x: Floats) -> Floats:
        """Return innovations over their standard deviation; zero for readings that are not used."""
        columns = x.reshape(self._readings, -1)
        out = np.zeros(columns.shape)
        for rows, S, band, gain in self._filters:
            if not columns.shape[1]:
                break
            m = columns[rows]
            drive = np.zeros_like(m)
            drive[1:] = gain[:-1, None] * m[:-1]
            predicted = scipy.linalg.solve_banded((1, 0), band, drive, check_finite=False)
            out[rows] = (m - predicted) / np.sqrt(S)[:, None]
        return np.asarray(out.reshape(x.shape))


class Noise:
    """Noise of the readings of some records with a discrepancy.

    Parameters
    ----------
    records : sequence of Measured
        Held-out readings are not included.
    """

    def __init__(self, records: Sequence[Measured]) -> None:
        self._series = _series(records)
        self._readings = sum(len(m.y) for m in records)
        self._known: dict[Discrepancy, Whitened] = {}

    def at(self, d: Discrepancy) -> Whitened:
        """Whitening by one discrepancy, computed once."""
        if d not in self._known:
            self._known[d] = Whitened(self._series, self._readings, d)
        return self._known[d]

    def profile(self, u: Floats, least: float) -> Discrepancy:
        """Likeliest discrepancy of the grid for residuals `u` (M,), K, of at least this size, K."""
        size, time = (np.array([getattr(d, k) for d in GRID]) for k in ("size", "time"))
        cost = np.array([d.strain for d in GRID])
        for s in self._series:
            cost += _deviance(u[s.rows], s, size, time)
        allowed = size >= min(least, SIZES[-1])
        return GRID[int(np.argmin(np.where(allowed, cost, np.inf)))]


def _series(records: Sequence[Measured]) -> list[Series]:
    found, first = [], 0
    for m in records:
        edges = np.cumsum([len(s) + 1 for s in m.spans])
        span = np.searchsorted(edges, m.row, side="right")
        t = (m.row + m.share) * m.drive.dt
        for i in range(len(m.spans)):
            for j in range(len(m.channels)):
                rows = np.flatnonzero((span == i) & (m.channel == j) & m.used)
                if len(rows):
                    sigma = float(np.hypot(m.sigma0[j], m.step[j] / np.sqrt(12.0)))
                    found.append(Series(first + rows, np.diff(t[rows]), sigma))
        first += len(m.y)
    return found


def _filter(s: Series, d: Discrepancy) -> tuple[Floats, Floats, Floats]:
    """Innovation variances (K,), the predictor's bidiagonal matrix, and its gains (K,)."""
    a = np.append(np.exp(-s.gaps / d.time), 0.0)
    q, white = d.size**2, s.sigma**2
    K = len(s.rows)
    S, gain = np.empty(K), np.empty(K)
    p = q
    for k, a_k in enumerate(a.tolist()):
        S[k] = p + white
        gain[k] = p / S[k]
        p = a_k * a_k * p * (1.0 - gain[k]) + q * (1.0 - a_k * a_k)
    band = np.ones((2, K))
    band[1] = -a * (1.0 - gain)
    return S, band, a * gain


def _deviance(u: Floats, s: Series, size: Floats, time: Floats) -> Floats:
    """−2 log marginal likelihood (G,) of residuals for every discrepancy."""
    q, white = size**2, s.sigma**2
    p, d, total = q.copy(), np.zeros_like(q), np.zeros_like(q)
    decay = np.exp(-np.append(s.gaps, 0.0)[:, None] / time)
    square = decay * decay
    fresh = q * (1.0 - square)
    for k, x in enumerate(u.tolist()):
        S = p + white
        e = x - d
        total += e * e / S + np.log(S)
        keep = white / S
        d = decay[k] * (d + (1.0 - keep) * e)
        p = square[k] * keep * p + fresh[k]
    return total
