"""Results of a fit of single cells, for people: one line per cell, and the combinations that the data determine.

Beyond Lin et al., whose last section leaves the parameters of single cells open.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.identify.contract import IDENTIFIED, Estimate, not_identifiable
from bms_gateway.identify.doubt import HOPELESS
from bms_gateway.identify.resistance_by_cell import CellFit
from bms_gateway.thermal import KINDS, Floats

TOLD = 1.0
"""A combination counts as determined if the surfaces give it more exactly than the scatter between cells does."""
NOTICEABLE = 0.2
"""Share of the largest weight below which a cell is omitted from the text."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One direction of the cells' ln R_e.

    Attributes
    ----------
    weights : ndarray (n,)
        The positive ones sum to 1, or the negative ones to −1 where they weigh more.
    information : float
        λ: squared ratio of the scatter of the cells to the error of the combination from the surfaces alone.
    prior_sd, sd : float
        Of the weighted sum of ln R_e, before (voltages included) and after.
    """

    weights: Floats
    information: float
    prior_sd: float
    sd: float

    @property
    def determined(self) -> bool:
        """Whether the record adds to what was known."""
        return self.information > TOLD

    def text(self) -> str:
        """Describe the combination in words."""
        w = self.weights
        at = [k for k in np.argsort(-np.abs(w), kind="stable").tolist() if abs(w[k]) >= NOTICEABLE * np.abs(w).max()]
        at.sort()
        plus, minus = ([k for k in at if np.sign(w[k]) == sign] for sign in (1.0, -1.0))
        figures = f"± {100 * self.sd:.1f} % (before: {100 * self.prior_sd:.0f} %)"
        what = f"R_e of {_cells(plus, w)}" + (f" against {_cells(minus, w)}" if minus else "")
        return f"{what}: {figures}" if self.determined else f"{what}: not determined, {figures}"


def _cells(at: list[int], w: Floats) -> str:
    size = np.abs(w[at])
    if len(at) == 1:
        return f"cell {at[0] + 1}"
    if size.max() < 1.25 * size.min():
        return "cells " + " and ".join([", ".join(str(k + 1) for k in at[:-1]), str(at[-1] + 1)]) + " together"
    share = size / size.sum()
    return "cells " + ", ".join(f"{k + 1} ({100 * s:.0f} %)" for k, s in zip(at, share, strict=True)) + " together"


def combinations(fit: CellFit, settings: CellSettings | None = None) -> tuple[Combination, ...]:
    """Directions of ln R_e, ordered by the information of the surfaces: scaled Fisher matrix, nuisances marginalised.

    Parameters
    ----------
    fit : CellFit
    settings : CellSettings, optional
        The unit of the Fisher matrix is the scatter between cells, `spread["R_e"]`.

    Returns
    -------
    tuple of Combination
        One per cell, the best determined first; their weights are orthogonal.
    """
    scale = (settings or CellSettings()).spread["R_e"]
    at = fit.layout.at("R_e")
    prior = np.linalg.inv(fit.prior.precision)[np.ix_(at, at)]
    fisher = np.linalg.inv(fit.R_e_cov) - np.linalg.inv(prior)
    values, vectors = np.linalg.eigh(scale**2 * (fisher + fisher.T) / 2.0)
    found = []
    for value, w in zip(values[::-1], vectors.T[::-1], strict=True):
        w = w * (1.0 if w[np.argmax(np.abs(w))] > 0.0 else -1.0)
        w = w / max(float(w[w > 0.0].sum()), float(-w[w < 0.0].sum()))
        sd = [float(np.sqrt(w @ cov @ w)) for cov in (prior, fit.R_e_cov)]
        found.append(Combination(w, max(0.0, float(value)), sd[0], sd[1]))
    return tuple(found)


def sentence(fit: CellFit, settings: CellSettings | None = None) -> str:
    """Say what the surfaces alone determine of the cells' R_e."""
    if fit.doubt > HOPELESS:
        return (
            "nothing is learnt of single cells: the model does not explain the surfaces with cells near what was known "
            "of them; an effect is missing, or a thermocouple errs"
        )
    found = [c.text() for c in combinations(fit, settings) if c.determined]
    if not found:
        return "the surfaces determine no combination of the cells' R_e"
    return "the surfaces determine " + "; ".join(found)


def cell_estimates(
    fit: CellFit, settings: CellSettings | None = None, voltages: Floats | None = None
) -> tuple[Estimate, ...]:
    """R_e of each cell with its status.

    Parameters
    ----------
    fit : CellFit
    settings : CellSettings, optional
    voltages : ndarray (n,), optional
        Electrical resistance used; NaN for a cell without one.

    Returns
    -------
    tuple of Estimate
        Named `R_e_1` … `R_e_n`.
    """
    settings = settings or CellSettings()
    out = []
    for k, (R, sd) in enumerate(zip(fit.R_e, fit.rel_sd, strict=True)):
        status = IDENTIFIED
        if sd > settings.good_sd:
            status = not_identifiable(_why(fit, k, voltages))
        out.append(Estimate(f"R_e_{k + 1}", float(R), float(R * sd), KINDS["R_e"].unit, status))
    return tuple(out)


def _why(fit: CellFit, k: int, voltages: Floats | None) -> str:
    if voltages is not None and np.isfinite(voltages[k]):
        return "the level common to the cells is not known; move the coolant inlet or sense more surfaces"
    if k in fit.sensed:
        return "its surface says too little; drive longer, with more current or a moving inlet"
    return "its surface is not sensed and its voltage is not on the bus; only sums with other cells are determined"
