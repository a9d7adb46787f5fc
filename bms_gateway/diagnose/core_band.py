"""The core that a fitted model states, and how wrong it could be though the surface looks fine.

The posterior of a fit, coordinates and nuisances together, is carried to the cores by their sensitivities. What the
fit leaves over is not white: its evidence is tempered by the autocorrelation of its residual, as the search does, and
a slow error s at the surface stands for s(1 + R_c/R_u) in the core.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnose.regimes import instants_of
from bms_gateway.diagnose.residuals import structure
from bms_gateway.identify.coordinates import Channel, Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats
from bms_gateway.thermal.trajectory import Span

POINTS = 600
"""Instants per record at which a core is stated with its sd: as many as a screen shows."""


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
        What the structure left at the surface may mean in the core.
    """

    record: int
    time_s: Floats
    T_c: Floats
    sd_K: Floats
    remainder_K: Floats

    @property
    def total_K(self) -> Floats:
        """Standard deviation (K, n) with the remainder."""
        return np.asarray(np.hypot(self.sd_K, self.remainder_K))


def seen_at(m: Measured, channels: Sequence[Channel], row: np.ndarray, share: Floats | None = None) -> Measured:
    """Give a record that is read elsewhere: `channels` at each of the rows of its trajectory.

    Its own channels stay, without readings: where it starts was taken from their thermocouples.
    """
    K, C, own = len(row), len(channels), len(m.channels)
    share = np.zeros(K) if share is None else share
    return replace(
        m,
        channels=(*m.channels, *channels),
        channel=own + np.repeat(np.arange(C), K),
        row=np.tile(row, C),
        share=np.tile(share, C),
        y=np.zeros(K * C),
        used=np.ones(K * C, np.bool_),
        sigma0=np.concatenate([m.sigma0, np.full(C, 0.1)]),
        step=np.concatenate([m.step, np.zeros(C)]),
    )


def sensitivity(fit: MapFit, records: Sequence[Measured]) -> tuple[Floats, Floats]:
    """Tell what other thermocouples would read, and how it depends on all numbers of a fit.

    Parameters
    ----------
    fit : MapFit
    records : sequence of Measured
        The fit's own, read elsewhere (`seen_at`).

    Returns
    -------
    y : ndarray (M,), °C
    J : ndarray (M, P + Q)
        Per unit of [θ, ν].
    """
    problem = Problem(fit.problem.model, records)
    nuisances = problem.nuisances = fit.problem.nuisances  # offsets of sensors too, which are read elsewhere here
    moved = problem.jacobian(fit.theta, fit.prediction, problem.coordinates, nu=fit.nu)
    scatter = moved[:, :0]
    if len(fit.nu):
        scatter = problem.jacobian(fit.theta, fit.prediction, nuisances, refinements=0, nu=fit.nu)
    y = problem.predict(fit.theta, fit.prediction.X, fit.nu).y
    return y, np.concatenate([moved, scatter], axis=1)


def tempered(fit: MapFit, inflation: float) -> Floats:
    """Covariance (P + Q, P + Q) of all numbers, the data's weight divided by the inflation of their variance."""
    sd = np.concatenate([[c.sd for c in fit.problem.coordinates], fit.linear.sd])
    prior = np.diag(1.0 / sd**2)
    return np.asarray(np.linalg.inv((fit.H - prior) / inflation + prior), dtype=np.float64)


def core_bands(fit: MapFit, structured_K: Sequence[float] = ()) -> tuple[CoreBand, ...]:
    """State the cores of each record of a fit.

    Parameters
    ----------
    fit : MapFit
    structured_K : sequence of float, one per cell
        Structured error of the nearest sensor; 0 where left out.
    """
    n = fit.problem.model.cells
    channels: list[Channel] = [("core", k) for k in range(1, n + 1)]
    records, times = [], []
    for m in fit.problem.records:
        row = _thinned(m.spans)
        records.append(seen_at(m, channels, row))
        times.append(instants_of(m)[row])
    y, J = sensitivity(fit, records)
    variance = np.einsum("mp,pq,mq->m", J, tempered(fit, structure(fit).inflation), J, optimize=True)
    left = np.asarray(structured_K) if len(structured_K) else np.zeros(n)
    bands, first = [], 0
    for r, t in enumerate(times):
        K = len(t)
        part = slice(first, first + n * K)
        first += n * K
        p = fit.problem.numbers(r, fit.theta, fit.nu)[0].string
        bands.append(
            CoreBand(
                r,
                t,
                y[part].reshape(n, K).T.copy(),
                np.sqrt(variance[part]).reshape(n, K).T.copy(),
                left * (1.0 + p.R_c / p.R_u),
            )
        )
    return tuple(bands)


def core_moved(before: MapFit, after: MapFit) -> tuple[float, float]:
    r"""Tell how far effects move the cores, and how well these are known with them.

    With s the standard deviation of a core and d the way that it moved, the move is one towards the truth with a
    probability of :math:`\Phi(|d|/2s)`: a move within the band's half width says little about it.

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


def at_times(band: CoreBand, cell: int, t: Floats) -> tuple[Floats, Floats]:
    """Core of one cell (from 1) and its sd at other times."""
    return (
        np.interp(t, band.time_s, band.T_c[:, cell - 1]),
        np.interp(t, band.time_s, band.total_K[:, cell - 1]),
    )


def _thinned(spans: Sequence[Span]) -> np.ndarray:
    """Rows of a trajectory, few enough to be shown, with both ends of each span."""
    rows = sum(len(s) + 1 for s in spans)
    every = max(rows // POINTS, 1)
    found, first = [], 0
    for s in spans:
        found.append(first + np.unique(np.append(np.arange(0, len(s) + 1, every), len(s))))
        first += len(s) + 1
    return np.concatenate(found)
