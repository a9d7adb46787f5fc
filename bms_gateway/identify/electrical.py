r"""Electrical resistance of each cell by energy balance: voltage against current, on all time scales at once.

.. math::
    V = U_0 + k\,Q - R_{el} I + v, \qquad Q = \int I\,dt

by least squares. Offset and charge slope describe the open-circuit voltage; R_el = −cov(V, I)/var(I) of the rest is the
cell's loss at its terminals per I², slow polarisation included. A pulse resistance contains only the fast part. Sums of
ten numbers per cell and segment are kept; means of I² and I·V over a tick enter as such, so no variation within a tick
is lost. Polarisation leaves residuals that are not noise but common to the cells: the error of the R_el relative to
each other is found by omitting one segment after the other (jackknife).

Voltage and current must be sampled at the same time: a skew τ reduces R_el by 1 − ρ(τ), ρ being the current's
autocorrelation, which the sums contain: 1.8 % at half a second on a drive cycle.

Beyond Lin et al., who use no voltage.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.thermal import Floats

SEGMENT_S = 300.0
"""s of samples per segment: as long as slow polarisation."""
LEAST = 3
"""Least number of segments from which R_el of a cell is stated."""
TOGETHER = 60
"""Ticks added to the sums at once."""
MOST = 48
"""Number of separate segments; older segments are merged in pairs."""
LEAST_SWING_A = 2.0
"""A: least rms of the current about its mean and its charge; with less, the voltage's noise would be fitted."""


@dataclass(frozen=True, slots=True)
class ElectricalResistance:
    """Result from the voltages.

    Attributes
    ----------
    value : ndarray (n,), Ω
        NaN for a cell without enough samples.
    rel_sd : ndarray (n,)
        Relative between the cells, by the measurement alone: without joints, skew and common errors.
    skew_share : float, 1/s
        Relative reduction of R_el per second of skew.
    """

    value: Floats
    rel_sd: Floats
    skew_share: float

    @property
    def known(self) -> bool:
        """Whether any cell has a value."""
        return bool(np.isfinite(self.value).any())

    def with_skew(self, skew_s: float) -> Floats:
        """Relative sd (n,) with a possible skew of `skew_s`."""
        return np.asarray(np.hypot(self.rel_sd, self.skew_share * skew_s), dtype=np.float64)

    def warning(self, skew_s: float, joint_sd: float) -> str:
        """Return a sentence if the skew adds more error than the joints; otherwise an empty string."""
        cost = self.skew_share * skew_s
        if not self.known or cost <= 0.5 * joint_sd:
            return ""
        return (
            f"cell voltages may be up to {skew_s:g} s off the current, which costs {100 * cost:.1f} % of a cell's "
            f"resistance on this drive: sample both within {0.5 * joint_sd / self.skew_share:.1g} s"
        )


@dataclass(frozen=True, slots=True)
class PairMeans:
    """Means of one tick over each cell's voltage samples and the current at their instants.

    Attributes
    ----------
    I, I2, V, IV : ndarray (n,)
        A, A², V, W; NaN for a cell without a sample.
    """

    I: Floats  # noqa: E741  the field's symbol
    I2: Floats
    V: Floats
    IV: Floats


class ElectricalSums:
    """Running sums of one string."""

    def __init__(self, cells: int) -> None:
        self._cells = cells
        self.reset()

    def reset(self) -> None:
        """Discard everything: after a gap the moved charge is unknown."""
        self._segments = [np.zeros((self._cells, 4, 4))]  # upper triangles of ∫ z zᵀ dt, z = (1, Q, I, V)
        self._waiting: list[tuple[PairMeans, float, float]] = []  # with charge and dt: added together, for speed
        self._charge = 0.0
        self._last = np.nan
        self._neighbours = np.zeros(4)  # of I, I', I I', I² at neighbouring ticks

    def update(self, pairs: PairMeans | None, current: float, dt: float) -> None:
        """Include the means of one tick.

        Parameters
        ----------
        pairs : PairMeans or None
            None: no voltages in this tick.
        current : float
            Mean current of the tick, A, for the charge; NaN counts as zero.
        dt : float, s
        """
        current = current if current == current else 0.0
        moved = current * dt / 3600.0
        q = self._charge + moved / 2.0
        self._charge += moved
        if self._last == self._last:
            mean, square = (current + self._last) / 2.0, (current**2 + self._last**2) / 2.0
            self._neighbours += (1.0, mean, current * self._last, square)
        self._last = current
        if pairs is None:
            return
        self._waiting.append((pairs, q, dt))
        if len(self._waiting) >= TOGETHER:
            self._sum_up()

    def _sum_up(self) -> None:
        if not self._waiting:
            return
        if self._segments[-1][:, 0, 0].max() >= SEGMENT_S:
            if len(self._segments) >= MOST:
                self._segments = [a + b for a, b in zip(self._segments[::2], self._segments[1::2], strict=True)]
            self._segments.append(np.zeros((self._cells, 4, 4)))
        pairs = [p for p, _, _ in self._waiting]
        i, i2, v, iv = (np.array([getattr(p, name) for p in pairs]) for name in ("I", "I2", "V", "IV"))
        there = np.isfinite(iv)
        i, i2, v, iv = (np.where(there, x, 0.0) for x in (i, i2, v, iv))
        w = np.where(there, np.array([dt for _, _, dt in self._waiting])[:, None], 0.0)
        q = np.array([q for _, q, _ in self._waiting])[:, None]
        s = self._segments[-1]
        upper = ((w, w * q, w * i, w * v), (w * q * q, w * q * i, w * q * v), (w * i2, w * iv), (w * v * v,))
        for row, values in enumerate(upper):
            for column, x in enumerate(values, start=row):
                s[:, row, column] += x.sum(axis=0)
        self._waiting = []

    def result(self, dt: float = 1.0) -> ElectricalResistance:
        """Solve for each cell.

        Parameters
        ----------
        dt : float, s
            Length of the ticks.
        """
        self._sum_up()
        segments = np.stack([a for a in self._segments if a[:, 0, 0].max() > 0.0] or self._segments)
        whole, count = segments.sum(axis=0), len(segments)
        value = _solved(whole) if count >= LEAST else np.full(self._cells, np.nan)
        if not np.isfinite(value).any():
            return ElectricalResistance(value, np.full(self._cells, np.nan), 0.0)
        without = np.log(np.stack([_solved(whole - one) for one in segments]))
        if np.isfinite(value).sum() > 1:
            without = without - np.nanmean(without, axis=1, keepdims=True)
        spread = np.square(without - without.mean(axis=0)).sum(axis=0)
        rel_sd = np.sqrt((count - 1) / count * spread)
        return ElectricalResistance(np.where(np.isfinite(rel_sd), value, np.nan), rel_sd, self._skew_share(dt))

    def _skew_share(self, dt: float) -> float:
        n, mean, product, square = self._neighbours
        if n < 2.0 or square / n - (mean / n) ** 2 < 1e-9:
            return 0.0
        return max(0.0, 1.0 - (product / n - (mean / n) ** 2) / (square / n - (mean / n) ** 2)) / dt


def _solved(sums: Floats) -> Floats:
    """R_el of each cell (n,) from its sums; NaN if the current varies too little."""
    out = np.full(len(sums), np.nan)
    for k, upper in enumerate(sums):
        s = upper + np.triu(upper, 1).T
        if s[0, 0] <= 0.0:
            continue
        ocv, rest = s[:2, :2], s[:2, 2:]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(ocv), 1e-12))
        taken = scale[:, None] * (
            np.linalg.pinv(scale[:, None] * ocv * scale, rcond=1e-12, hermitian=True) @ (scale[:, None] * rest)
        )
        left = s[2:, 2:] - rest.T @ taken  # of I and V without offset and charge slope
        if left[0, 0] >= LEAST_SWING_A**2 * s[0, 0] and left[0, 1] < 0.0:
            out[k] = -left[0, 1] / left[0, 0]
    return out
