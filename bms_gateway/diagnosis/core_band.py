r"""The core of a fitted model, and its possible error although the surface agrees.

.. math:: v = J \Sigma J^T + s^2 (1 + R_c/R_u)^2 + m^2 \, (T_c - T_s)^2

The posterior Σ of a fit, coordinates and nuisances together, gives the variance of the cores by their sensitivities J.
The residual of the fit is not white, so the evidence is tempered by the autocorrelation of the residual, as in the
search. A slow error s at the surface means an error s(1 + R_c/R_u) in the core. A share m of core minus surface may be
wrong in a model of two nodes, and no surface shows it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnosis.regimes import instants_of
from bms_gateway.diagnosis.residuals import structure
from bms_gateway.identify.coordinates import Channel, Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats, Share, film
from bms_gateway.thermal.centre import centre_share, hottest_point, lagged, time_constant
from bms_gateway.thermal.drive import Span

POINTS = 600
"""Instants per record at which a core is given with its sd: as many as a screen shows."""
LUMPED = 0.05
"""m of a model whose core is proven: position of the core's thermocouple, conduction along the axis …"""
UNPROVEN = 0.35
"""… and of one whose core is not proven: two sd are two thirds of its R_c, as much as one type of cell differs between
two ways of cooling."""
BAND_SD = 1.96
"""Half width of a 95 % band."""


@dataclass(frozen=True, slots=True)
class CoreBand:
    """Cores of one record.

    Attributes
    ----------
    record : int
    time_s : ndarray (K,), s since the record began
    T_c : ndarray (K, n), °C
    sd_K : ndarray (K, n)
        From the fit's posterior.
    remainder_K : ndarray (n,)
        Error of the core that the remaining structure at the surface may mean.
    lever_K : ndarray (K, n)
        Core minus surface, a share of which may be wrong in a model of two nodes. The core is not better known where
        this difference changes its sign, so half of its square is the record's mean.
    gap_K, lag_K : ndarray (K, n)
        Core minus surface; the same, with the lag of the profile within the roll.
    roll : Share
        φ of `thermal.centre`.
    share : float
        The share m.
    """

    record: int
    time_s: Floats
    T_c: Floats
    sd_K: Floats
    remainder_K: Floats
    lever_K: Floats
    gap_K: Floats
    lag_K: Floats
    roll: Share
    share: float = LUMPED

    @property
    def total_K(self) -> Floats:
        """Standard deviation (K, n) of all three parts together."""
        return np.asarray(np.sqrt(self.sd_K**2 + self.remainder_K**2 + (self.share * self.lever_K) ** 2))

    @property
    def T_centre(self) -> Floats:
        """Hottest point (K, n) of each cell, °C."""
        return hottest_point(self.T_c, self.T_c - self.gap_K, self.lag_K, self.roll.value)

    @property
    def centre_sd_K(self) -> Floats:
        """Standard deviation (K, n) of the hottest point; the surface is measured, only core minus it is uncertain."""
        return np.asarray(np.hypot((1.0 + self.roll.value) * self.total_K, self.roll.sd * self.lag_K))


def half_width_K(bands: Sequence[CoreBand]) -> Floats:
    """95 % half width (n,) of each cell's core, root mean square over all records, K, as reports state it."""
    return np.asarray(BAND_SD * typical_K([b.total_K for b in bands]))


def typical_K(x: Sequence[Floats]) -> Floats:
    """Root mean square (n,) over all instants of all records: a core's sd in one number."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(list(x)) ** 2, axis=0)))


def seen_at(m: Measured, channels: Sequence[Channel], row: np.ndarray) -> Measured:
    """Return a record with other readings: `channels` at each of the rows of its trajectory.

    Its own channels are kept without readings, because its start was taken from their thermocouples.
    """
    K, C, own = len(row), len(channels), len(m.channels)
    return replace(
        m,
        channels=(*m.channels, *channels),
        channel=own + np.repeat(np.arange(C), K),
        row=np.tile(row, C),
        share=np.zeros(K * C),
        y=np.zeros(K * C),
        used=np.ones(K * C, np.bool_),
        sigma0=np.concatenate([m.sigma0, np.full(C, 0.1)]),
        step=np.concatenate([m.step, np.zeros(C)]),
    )


def sensitivity(fit: MapFit, records: Sequence[Measured]) -> tuple[Floats, Floats]:
    """Compute the readings of other thermocouples, and their derivatives by all numbers of a fit.

    Parameters
    ----------
    fit : MapFit
    records : sequence of Measured
        The fit's own records, read elsewhere (`seen_at`).

    Returns
    -------
    y : ndarray (M,), °C
    J : ndarray (M, P + Q)
        Per unit of [θ, ν].
    """
    problem = Problem(fit.problem.model, records)
    nuisances = problem.nuisances = fit.problem.nuisances  # including the sensors' offsets, whose places differ here
    moved = problem.jacobian(fit.theta, fit.prediction, problem.coordinates, nu=fit.nu)
    scatter = moved[:, :0]
    if len(fit.nu):
        scatter = problem.jacobian(fit.theta, fit.prediction, nuisances, refinements=0, nu=fit.nu)
    y = problem.predict(fit.theta, fit.prediction.X, fit.nu).y
    return y, np.concatenate([moved, scatter], axis=1)


def tempered(fit: MapFit, inflation: float) -> Floats:
    """Covariance (P + Q, P + Q) of all numbers; the data's weight is divided by the inflation of their variance."""
    sd = np.concatenate([[c.sd for c in fit.problem.coordinates], fit.linear.sd])
    prior = np.diag(1.0 / sd**2)
    return np.asarray(np.linalg.inv((fit.H - prior) / inflation + prior), dtype=np.float64)


def posterior(fit: MapFit) -> Floats:
    """Covariance (P + Q, P + Q) of coordinates and nuisances; a coloured residual lowers the weight of the data."""
    if fit.noise is not None or fit.tempered:
        return np.asarray(np.linalg.inv(fit.H), dtype=np.float64)
    return tempered(fit, max(1.0, structure(fit).inflation))


def core_bands(
    fit: MapFit,
    structured_K: Sequence[float] = (),
    *,
    share: float = LUMPED,
) -> tuple[CoreBand, ...]:
    """Return the cores of each record of a fit.

    Parameters
    ----------
    fit : MapFit
    structured_K : sequence of float, one per cell
        Slow error of the surface; 0 by default.
    share : float
        Share of core minus surface that may be wrong.
    """
    n = fit.problem.model.cells
    channels: list[Channel] = [("core", k) for k in range(1, n + 1)]
    records, times, levers, gaps = [], [], [], []
    roll = centre_share(fit.problem.model)
    for m, X in zip(fit.problem.records, fit.prediction.X, strict=True):
        row = _thinned(m.spans)
        records.append(seen_at(m, channels, row))
        times.append(instants_of(m)[row])
        gap = X[:, 0 : 2 * n : 2] - X[:, 1 : 2 * n : 2]
        gaps.append(gap[row])
        levers.append(np.sqrt((gap[row] ** 2 + np.mean(gap**2, axis=0)) / 2.0))
    y, J = sensitivity(fit, records)
    variance = np.einsum("mp,pq,mq->m", J, posterior(fit), J, optimize=True)
    left = np.asarray(structured_K) if len(structured_K) else np.zeros(n)
    bands, first = [], 0
    for r, (t, lever, gap) in enumerate(zip(times, levers, gaps, strict=True)):
        K = len(t)
        part = slice(first, first + n * K)
        first += n * K
        p = fit.problem.numbers(r, fit.theta, fit.nu)[0].string
        lag = lagged(gap, np.diff(t, prepend=t[0]), time_constant(roll.value, p.R_c, p.C_c))
        bands.append(
            CoreBand(
                r,
                t,
                y[part].reshape(n, K).T.copy(),
                np.sqrt(variance[part]).reshape(n, K).T.copy(),
                left * (1.0 + p.R_c * film(p)),
                lever,
                gap,
                lag,
                roll,
                share,
            )
        )
    return tuple(bands)


def core_moved(before: MapFit, after: MapFit) -> tuple[float, float]:
    r"""Return the change of the cores by effects, and the uncertainty of the cores with the effects.

    With s the standard deviation of a core and d its change, the change is towards the truth with a probability of
    :math:`\Phi(|d|/2s)`: a change within the band's half width says little about it.

    Parameters
    ----------
    before, after : MapFit
        Of the same records, without and with the effects.

    Returns
    -------
    float, float
        Root mean square over all cores and instants of the move, and of the 95 % half width, K.
    """
    n = after.problem.model.cells
    moves = [
        a[:, 0 : 2 * n : 2] - b[:, 0 : 2 * n : 2] for a, b in zip(after.prediction.X, before.prediction.X, strict=True)
    ]
    sd = np.concatenate([b.sd_K for b in core_bands(after)])
    return float(np.sqrt(np.mean(np.concatenate(moves) ** 2))), float(1.96 * np.sqrt(np.mean(sd**2)))


def at_times(band: CoreBand, cell: int, t: Floats, lever: Share | None = None) -> tuple[Floats, Floats]:
    """Core of one cell (from 1) and its sd at other times; with `lever`, the reading of a thermocouple in it."""
    T_c, sd, gap = (np.interp(t, band.time_s, x[:, cell - 1]) for x in (band.T_c, band.total_K, band.gap_K))
    return (T_c, sd) if lever is None else (T_c + lever.value * gap, np.hypot(sd, lever.sd * gap))


def at_every_step(band: CoreBand, fit: MapFit) -> CoreBand:
    """Return a band of a fit at all rows of its trajectory: a stretch of a long record has few of `POINTS` instants.

    The cores are those of the trajectory. Their sd in units of the lever, with which it grows and shrinks, is
    interpolated: 10 h in steps of 10 s are within 1 % (rms) and 12 % of the sd at each row.
    """
    t, X, n = instants_of(fit.problem.records[band.record]), fit.prediction.X[band.record], band.T_c.shape[1]
    T_c = X[:, 0 : 2 * n : 2]
    gap = T_c - X[:, 1 : 2 * n : 2]
    lever = np.sqrt((gap**2 + np.mean(gap**2, axis=0)) / 2.0)

    def between(x: Floats) -> Floats:
        return np.stack([np.interp(t, band.time_s, x[:, k]) for k in range(n)], axis=1)

    flat = lever == 0.0  # a cell without any heat
    share = band.sd_K / np.where(band.lever_K == 0.0, 1.0, band.lever_K)
    sd = between(share) * np.where(flat, 1.0, lever)
    return replace(band, time_s=t, T_c=T_c, sd_K=sd, lever_K=lever, gap_K=gap, lag_K=between(band.lag_K))


def _thinned(spans: Sequence[Span]) -> np.ndarray:
    """Choose rows of a trajectory, few enough for a plot, with both ends of each span."""
    rows = sum(len(s) + 1 for s in spans)
    every = max(rows // POINTS, 1)
    found, first = [], 0
    for s in spans:
        found.append(first + np.unique(np.append(np.arange(0, len(s) + 1, every), len(s))))
        first += len(s) + 1
    return np.concatenate(found)
