r"""How wrong the cores may be: over all hypotheses that are left, within each of them, and for what none of them knows.

.. math::
    v = \sum_h w_h \left(J_h \Sigma_h J_h^T + (T_h - T)^2\right) + s^2 + (m \, (T - T_s))^2

with w_h the hypotheses' probabilities, the Laplace covariance Σ_h carried to the cores by their sensitivities, s the
discrepancy of the best one, and m the share of the difference core to surface that two nodes may get wrong.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.diagnose.hypotheses import Hypothesis
from bms_gateway.identify.coordinates import Measured
from bms_gateway.identify.map_fit import MapFit
from bms_gateway.identify.problem import Problem
from bms_gateway.thermal import Floats

NEAR = 5.0
"""Log-odds below the best from which a hypothesis is out: one in 150."""
MOST = 8
LUMPED = 0.05
"""m of a model against which nothing speaks: position of the core's thermocouple, conduction along the axis …"""
ALARMED = 0.35
"""… and of one whose numbers, heat or predictions are not plausible: two sd are two thirds of its R_c, as much as
one type of cell differs between two ways of cooling."""


@dataclass(frozen=True, slots=True)
class Cores:
    """Cores of one record.

    Attributes
    ----------
    mean, sd : ndarray (N + spans, n)
        °C and K at the instants of the record as given.
    """

    mean: Floats
    sd: Floats


def core_band(
    best: MapFit,
    size: float,
    hypotheses: Sequence[Hypothesis],
    records: Sequence[Measured],
    *,
    alarmed: bool,
    alone: Sequence[MapFit] = (),
) -> tuple[Cores, ...]:
    """Cores with their uncertainty.

    Parameters
    ----------
    best : MapFit
        The model that is shown.
    size : float, K
        Its discrepancy.
    hypotheses : sequence of Hypothesis
        Not refused, best first.
    records : sequence of Measured
        At whose instants the cores are wanted; those of the fits may be coarser.
    alarmed : bool
        Whether a witness speaks against the core.
    alone : sequence of MapFit
        Fits of each record by itself, where all together disagree with them.

    Returns
    -------
    tuple of Cores, one per record
    """
    near = [h for h in hypotheses if h.score > hypotheses[0].score - NEAR][:MOST]
    weight = np.exp(np.array([h.score for h in near]) - near[0].score)
    weight /= weight.sum()
    found = []
    n = best.problem.model.cells
    for r, (m, coarse) in enumerate(zip(records, best.problem.records, strict=True)):
        X = best.prediction.X[r]
        mean = X[:, 0 : 2 * n : 2]
        finest = core_variance(best, r)
        variance = np.zeros_like(mean)
        for h, w in zip(near, weight, strict=True):
            variance += w * (np.maximum(finest, core_variance(h.fit.map, r)) + (h.core(r) - mean) ** 2)
        gap = mean - X[:, 1 : 2 * n : 2]
        share = ALARMED if alarmed else LUMPED
        # a difference that has just changed sign is not known any better
        usual = np.sqrt(np.mean(gap**2, axis=0))
        if alone:
            own = alone[r].prediction.X[0][:, 0 : 2 * n : 2]
            variance = np.maximum(variance, core_variance(alone[r], 0)) + (own - mean) ** 2
        variance += size**2 + share**2 * (gap**2 + usual**2) / 2.0
        found.append(Cores(_at(mean, coarse, m), _at(np.sqrt(variance), coarse, m)))
    return tuple(found)


def core_variance(f: MapFit, r: int) -> Floats:
    """Laplace variance (N + spans, n) of the cores of one record, K²."""
    n = f.problem.model.cells
    m = f.problem.records[r]
    rows = len(f.prediction.X[r])
    cores = replace(
        m,
        channels=(*m.channels, *(("core", k + 1) for k in range(n))),  # the start still hangs on the surfaces' sensors
        channel=np.repeat(np.arange(n) + len(m.channels), rows),
        row=np.tile(np.arange(rows), n),
        share=np.zeros(n * rows),
        y=np.zeros(n * rows),
        used=np.ones(n * rows, np.bool_),
        sigma0=np.append(m.sigma0, np.ones(n)),
        step=np.append(m.step, np.zeros(n)),
    )
    records = [cores if i == r else other for i, other in enumerate(f.problem.records)]
    problem = Problem(f.problem.model, records, f.problem.beliefs)
    first = sum(len(other.y) for other in records[:r])
    J = np.concatenate(
        [
            problem.jacobian(f.theta, f.prediction, problem.coordinates, 2),
            problem.jacobian(f.theta, f.prediction, f.problem.nuisances, 0),
        ],
        axis=1,
    )[first : first + n * rows]
    covariance = np.linalg.inv(f.H)
    variance = np.einsum("ij,jk,ik->i", J, covariance, J)
    return np.asarray(np.maximum(variance, 0.0).reshape(n, rows).T)


def _at(x: Floats, coarse: Measured, fine: Measured) -> Floats:
    """Values at the instants of a record from those of its coarser form."""
    parts, a, b = [], 0, 0
    ratio = coarse.drive.dt / fine.drive.dt
    for c, f in zip(coarse.spans, fine.spans, strict=True):
        size = min(ratio, float(len(f)))
        at = np.arange(len(f) + 1) / size
        rows = x[a : a + len(c) + 1]
        parts.append(np.stack([np.interp(at, np.arange(len(rows)), col) for col in rows.T], axis=1))
        a, b = a + len(c) + 1, b + len(f) + 1
    return np.concatenate(parts)
