"""How honest a stated core temperature is: its distance from the true core, held against the band stated with it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf


def crps(mean: np.ndarray, sd: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score of Gaussians, K: how far a forecast lies from what came, band and all.

    Parameters
    ----------
    mean, sd, true : ndarray, of one shape
        K or °C. A band of 0 makes it the absolute error.

    Returns
    -------
    ndarray
        Integral of (F(x) - [x >= true])² over x, by its closed form (Gneiting and Raftery, 2007).
    """
    mean, sd, true = np.broadcast_arrays(*(np.asarray(x, float) for x in (mean, sd, true)))
    error = true - mean
    banded = sd > 0
    z = np.divide(error, sd, out=np.zeros_like(error), where=banded)
    density = np.exp(-z * z / 2) / np.sqrt(2 * np.pi)
    return np.where(banded, sd * (z * erf(z / np.sqrt(2)) + 2 * density - 1 / np.sqrt(np.pi)), np.abs(error))


@dataclass(frozen=True)
class Score:
    """One method on one case, over all its cells and instants.

    Attributes
    ----------
    known : float
        Share of the instants at which a core was stated; everything else is over these.
    rmse, bias, sd, crps : float
        K; bias is stated minus true, sd the median of the bands, crps the mean.
    inside, inside_worst : float
        Share within 2 sd, and that of the worst cell.
    error_sd : float
        The largest absolute error in stated sd.
    sd_ratio : float
        Root mean square of the stated bands over the root mean square error.
    told : float
        Share of the instants at which a flag or a doubt stood, for the string or the cell.
    untold : float
        Share outside 2 sd while nothing was told.
    """

    known: float
    rmse: float
    bias: float
    sd: float
    crps: float
    inside: float
    inside_worst: float
    error_sd: float
    sd_ratio: float
    told: float
    untold: float


def score(mean: np.ndarray, sd: np.ndarray, true: np.ndarray, told: np.ndarray | None = None) -> Score:
    """Score cores as stated (K, n) against the true ones.

    Parameters
    ----------
    mean, sd, true : ndarray (K, n)
        °C and K; NaN in `mean` where none was stated, `sd` 0 for a method that states no band.
    told : ndarray of bool (K, n), optional
        Where a flag or a doubt stood.

    Raises
    ------
    ValueError
        No core was stated at all.
    """
    known = np.isfinite(mean) & np.isfinite(sd)
    if not known.any():
        raise ValueError("no core was stated at any instant")
    doubted = np.zeros(known.shape, bool) if told is None else told
    error = np.where(known, mean - true, np.nan)
    within = np.where(known, np.abs(error) <= 2 * sd, np.nan)
    e, s = error[known], sd[known]
    rmse = _rms(e)
    return Score(
        known=float(known.mean()),
        rmse=rmse,
        bias=float(e.mean()),
        sd=float(np.median(s)),
        crps=float(crps(mean[known], s, true[known]).mean()),
        inside=float(np.nanmean(within)),
        inside_worst=float(np.nanmin([np.nanmean(w) for w in within.T if np.isfinite(w).any()])),
        error_sd=float(np.max(np.abs(e) / np.maximum(s, 1e-9))) if (s > 0).any() else float("inf"),
        sd_ratio=_rms(s) / rmse if rmse > 0 else float("inf"),
        told=float(doubted.mean()),
        untold=float(((np.abs(e) > 2 * s) & ~doubted[known]).mean()),
    )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
