"""The residual of a fit: its size, its structured part, and the residual of held-out readings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.likelihood import expected_squares, generalised
from bms_gateway.identify.map_fit import MapFit, stacked
from bms_gateway.thermal import Floats

LAGS = range(3, 9)
"""Lags in samples: beyond the filter of a thermocouple, short against a cell's slow time constant."""
LONGEST = 400
"""Number of lags over which the inflation of a sum's variance is computed."""
REGIME = {"soc": 0.01, "T_in": 0.5, "flow": 0.03}
"""Distance of a held-out reading beyond the trained range above which it counts as extrapolation."""
COARSE = 3.0
"""Size of a step in standard deviations of the noise above which the noise is hardly known."""
LEAST_Z = 6.0
"""Structure below this value counts as zero."""
ENOUGH = 50
"""Least number of readings inside the trained range; with fewer, all held-out readings count."""

LEAST_STRUCTURE = 0.18
"""Structured error, in units of the sensors' noise, above which something is unexplained …"""
COARSE_STRUCTURE = 0.6
"""… and the same if the resolution is so coarse that rounding itself leaves structure."""
CHANCE = 1.5
"""Factor on the possible error by coarse rows, because the error of one record is a single random sample."""
HELD_RATIO = 1.2
"""Held-out residual over the noise above which the model fails on held-out readings."""
COARSE_SDS = 2.0
"""Margin in standard deviations of a held-out residual if coarse steps leave the information to a few readings."""


@dataclass(frozen=True, slots=True)
class Structure:
    """Structure of a residual of unit variance: its part that is not white.

    Attributes
    ----------
    power : float
        Autocovariance at lags 3–8, in units of the sensors' variance: the structured error squared.
    z : float
        The power over its standard deviation for a white residual.
    inflation : float
        Variance of a sum over the residual, over that of white noise of the same size; it tempers the evidence.
    """

    power: float
    z: float
    inflation: float

    @property
    def size(self) -> float:
        """Structured error in units of the sensors' noise."""
        return float(np.sqrt(max(self.power, 0.0)))


def structure(fit: MapFit) -> Structure:
    """Find the structure in a fit's residual, on the readings used.

    If the noise is hardly known, its variance is taken from the residual, as long as this is white.
    """
    found = structure_of(_series(fit))
    return replace(found, inflation=found.inflation * usual_scale(fit, found.z) ** 2)


def noise_hardly_known(fit: MapFit) -> bool:
    """Whether the steps of the sensors are so far above the noise that its size is hardly known."""
    return any(bool(np.any(m.step > COARSE * m.sigma0)) for m in fit.problem.records)


def usual_scale(fit: MapFit, z: float) -> float:
    """Return the factor on the noise from the white residual of trained readings if steps are coarse; otherwise 1."""
    if z > LEAST_Z or not noise_hardly_known(fit):
        return 1.0
    return max(1.0, scale(fit, stacked(fit.problem)[4]))


def structure_of(series: Sequence[Floats]) -> Structure:
    """Find the structure in some residuals of unit variance, each in order of time and longer than the lags."""
    covariance = np.zeros(LONGEST)
    count = np.zeros(LONGEST)
    variance = float(np.mean(np.concatenate(series) ** 2))
    for r in series:
        size = len(r)
        spectrum = np.abs(np.fft.rfft(r, 2 * size)) ** 2
        lags = np.fft.irfft(spectrum)[: min(LONGEST, size)]
        covariance[: len(lags)] += lags
        count[: len(lags)] += size - np.arange(len(lags))
    short = np.array(LAGS)
    pairs = float(count[short].sum())
    power = float(covariance[short].sum()) / max(pairs, 1.0)
    rho = covariance[1:] / np.maximum(count[1:], 1.0) / variance
    weak = np.flatnonzero(rho < 2.0 / np.sqrt(count[0]))
    inflation = 1.0 + 2.0 * float(rho[: weak[0] if len(weak) else None].sum())
    return Structure(power, power * np.sqrt(pairs) / variance, inflation)


def rmse(fit: MapFit, rows: np.ndarray) -> float:
    """Root mean square of reading minus model over some readings, K."""
    y = stacked(fit.problem)[0]
    return float(np.sqrt(np.mean((y - fit.y)[rows] ** 2))) if rows.any() else float("nan")


def noise_floor(fit: MapFit, rows: np.ndarray) -> float:
    """Root mean square error, K, of a perfect model on some readings."""
    sigma = stacked(fit.problem)[1]
    return float(np.sqrt(np.mean(sigma[rows] ** 2))) if rows.any() else float("nan")


def log_density(fit: MapFit, rows: np.ndarray) -> float:
    """Log-likelihood of some readings, up to a constant."""
    y, _, sigma0, step, _ = stacked(fit.problem)
    return -0.5 * float(np.sum(generalised(y - fit.y, sigma0, step)[1][rows]))


def scale(fit: MapFit, rows: np.ndarray, sds: float = 0.0) -> float:
    """Root mean square of the generalised residual over that of a right model, for which it is 1.

    Parameters
    ----------
    fit : MapFit
    rows : ndarray of bool (M,)
    sds : float
        This number of standard deviations of its square is subtracted: with steps far above the noise, only the few
        readings near the edge of their level carry information, and the mean square depends on them.
    """
    if not rows.any():
        return float("nan")
    y, _, sigma0, step, _ = stacked(fit.problem)
    mean, variance = expected_squares((y - fit.y)[rows], sigma0[rows], step[rows])
    chance = sds * float(np.sqrt(np.sum(variance)))
    return float(np.sqrt(max(np.sum(fit.r[rows] ** 2) - chance, 0.0) / np.sum(mean)))


def within(fit: MapFit) -> np.ndarray:
    """Held-out readings (M,) whose inputs are within the trained range; all held-out ones if few are."""
    parts = []
    for m in fit.problem.records:
        interval = interval_of(m)
        inside = ~m.used
        for name, margin in REGIME.items():
            x = getattr(m.drive, name)[interval]
            trained = x[m.used]
            inside &= (x >= trained.min() - margin) & (x <= trained.max() + margin)
        parts.append(inside if inside.sum() >= ENOUGH else ~m.used)
    return np.concatenate(parts)


def structured(fit: MapFit, open_in_sd: float = 0.0) -> bool:
    """Whether a fit leaves structure in the trained readings.

    Parameters
    ----------
    fit : MapFit
    open_in_sd : float
        Error of the readings that may have another cause, in units of their noise.
    """
    found = structure(fit)
    return found.z > LEAST_Z and found.size > float(np.hypot(least_structure(fit), open_in_sd))


def least_structure(fit: MapFit) -> float:
    """Structured error, in units of the noise, above which a fit leaves more than the steps of its sensors."""
    return COARSE_STRUCTURE if noise_hardly_known(fit) else LEAST_STRUCTURE


def unexplained(fit: MapFit, left_open: float = 0.0) -> tuple[bool, bool]:
    """Whether a fit leaves structure in the readings, and whether it fails on held-out readings.

    Parameters
    ----------
    fit : MapFit
    left_open : float, K
        Error of the readings that the unknown current between its rows may cause.
    """
    held = within(fit)
    open_in_sd = CHANCE * left_open / float(np.sqrt(np.mean(stacked(fit.problem)[1][held] ** 2)))
    seen = scale(fit, held, COARSE_SDS if noise_hardly_known(fit) else 0.0)
    fails_held = seen > float(np.hypot(HELD_RATIO * usual_scale(fit, structure(fit).z), open_in_sd))
    return structured(fit, open_in_sd), fails_held


def interval_of(m: Measured) -> np.ndarray:
    """Interval (M,) in which each reading lies."""
    return np.asarray(np.minimum(m.row - _span(m), m.drive.N - 1))


def _span(m: Measured) -> np.ndarray:
    """Span (M,) in which each reading lies: a span has one row more than intervals."""
    return np.searchsorted(np.cumsum([len(s) + 1 for s in m.spans]), m.row, side="right")


def _series(fit: MapFit) -> list[Floats]:
    """Residual of each record and channel at the readings used, in order of time."""
    found = []
    first = 0
    for m in fit.problem.records:
        r = fit.r[first : first + len(m.y)]
        first += len(m.y)
        found += [r[m.used & (m.channel == j)] for j in range(len(m.channels))]
    return [r for r in found if len(r) > max(LAGS)]
