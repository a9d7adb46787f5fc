r"""Prior of the cells of a string: they are similar but not equal, and their voltages give more information.

θ: logarithms of R_e, R_u, R_c, C_c of each cell and of C_s, R_cc, C_f of the string. A symbol's cells scatter about a
mean that is itself uncertain, so its covariance is σ² 11ᵀ + δ² I. Cell voltages give R_el of each cell from the energy
balance (`electrical`), and then

.. math::
    \ln R_{e,k} = \ln R_{el,k} + \ln\rho + \epsilon_k

where ρ is common to the cells (gain of the current sensor, reversible heat) and ε_k belongs to one cell: welds and
busbars inside the sense loop, and the time skew between its samples and those of the current.

Beyond Lin et al., whose last section leaves the parameters of single cells open.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from bms_gateway.thermal import Floats, StringModel, StringParameters

PER_CELL = ("R_e", "R_u", "R_c", "C_c")
"""Symbols with one value per cell; the others have one value per string."""
AGED_TOGETHER, AGED_APART = 0.05, 0.03
"""Relative change of R_e after a commissioning run: of all cells in common, and of each cell by itself."""
FOLLOWED = 0.01
"""The same for a cell whose change is measured by its voltage: joints cancel; temperature and charge do not fully."""
FOULED = 0.03
"""Relative change of R_u: filters clog."""
SPREAD: Mapping[str, float] = MappingProxyType({"R_e": 0.10, "R_u": 0.05, "R_c": 0.03, "C_c": 0.02})
"""Relative scatter of cells: aged cells of one make behind one fan."""


@dataclass(frozen=True, slots=True)
class CellSettings:
    """Settings of the per-cell method.

    Attributes
    ----------
    spread : mapping
        Relative scatter of each symbol of `PER_CELL` about the string's mean.
    offset_sd : float, K
        Constant offset of a surface sensor.
    ratio_sd : float
        Sd of ln ρ, heat per electrical resistance, about `ratio`. With the energy balance, it comes from the gains of
        the current sensor (which enters heat twice and R_el once) and of the voltage, and from reversible heat. Pulse
        resistances would differ by tens of per cent.
    ratio : float
        Median of ρ.
    joint_sd : float
        Sd of ε: 3 % if the joints inside the sense loops are unknown, 1 % if they are known.
    skew_s : float, s
        Largest error of the time stamps of a cell's voltage against the current.
    block_s : float, s
        Readings are averaged over this time; short against the cells' slow time constant.
    good_sd : float
        Relative sd up to which a cell's R_e is called identified: two sensors reach it with the noise of a drive, and
        it is well below the scatter between cells.
    """

    spread: Mapping[str, float] = field(default_factory=lambda: dict(SPREAD))
    offset_sd: float = 0.1
    ratio_sd: float = 0.03
    ratio: float = 1.0
    joint_sd: float = 0.03
    skew_s: float = 0.1
    block_s: float = 10.0
    good_sd: float = 0.07


@dataclass(frozen=True, slots=True)
class Layout:
    """Places of the numbers in θ.

    Attributes
    ----------
    cells : int
    names : tuple of (symbol, cell)
        Cell from 0, or −1 for a number of the string. Fixed numbers are not included.
    """

    cells: int
    names: tuple[tuple[str, int], ...]

    @classmethod
    def of(cls, model: StringModel) -> "Layout":
        """Collect the free numbers of a string; R_e is free even if the model fixes its mean."""
        more = (("R_cc",) if model.has_conduction else ()) + (("C_f",) if model.has_coolant_path else ())
        free = [s for s in (*PER_CELL, "C_s", *more) if s == "R_e" or not model.priors[s].fixed]
        cells = range(model.cells)
        return cls(model.cells, tuple((s, k) for s in free for k in (cells if s in PER_CELL else (-1,))))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names as in model files: `symbol:cell`, cells from 1, or `symbol`."""
        return tuple(s if k < 0 else f"{s}:{k + 1}" for s, k in self.names)

    def at(self, symbol: str) -> list[int]:
        """Return the places of a symbol."""
        return [i for i, (s, _) in enumerate(self.names) if s == symbol]

    def parameters(self, model: StringModel, theta: Floats) -> StringParameters:
        """Parameters of the string at θ; the ratios between the cells' C_s are kept."""
        values: dict[str, float | Floats] = {}
        for symbol in dict.fromkeys(s for s, _ in self.names):
            x = np.exp(theta[self.at(symbol)])
            median = np.asarray(model.priors[symbol].value, dtype=np.float64)
            values[symbol] = x if symbol in PER_CELL else x[0] * median / np.exp(np.mean(np.log(median)))
        return model.parameters(values)


@dataclass(frozen=True, slots=True)
class CellPrior:
    """Gaussian over θ.

    Attributes
    ----------
    mean : ndarray (p,)
    precision : ndarray (p, p)
    """

    mean: Floats
    precision: Floats

    def with_electrical(self, at: list[int], resistance: Floats, rel_sd: Floats, settings: CellSettings) -> "CellPrior":
        """Add the information of the cells' electrical resistances.

        Parameters
        ----------
        at : list of int
            Places of R_e in θ.
        resistance, rel_sd : ndarray (n,)
            Ω and relative error of the measurement; NaN for a cell without a voltage.
        settings : CellSettings
        """
        known = np.isfinite(resistance) & np.isfinite(rel_sd)
        if not known.any():
            return self
        rows = np.asarray(at)[known]
        cov = settings.ratio_sd**2 * np.ones((len(rows), len(rows)))
        cov += np.diag(settings.joint_sd**2 + rel_sd[known] ** 2)
        info = np.linalg.inv(cov)
        precision = self.precision.copy()
        precision[np.ix_(rows, rows)] += info
        moved = np.zeros(len(self.mean))
        moved[rows] = info @ (np.log(settings.ratio * resistance[known]) - self.mean[rows])
        return CellPrior(self.mean + np.linalg.solve(precision, moved), precision)


def cell_prior(model: StringModel, layout: Layout, settings: CellSettings) -> CellPrior:
    """Hierarchical prior of a string from its model file.

    Returns
    -------
    CellPrior
        Medians as in the file; a symbol's cells scatter about a common mean of the file's `rel_sd`.
    """
    p = len(layout.names)
    mean, cov = np.empty(p), np.zeros((p, p))
    for symbol in dict.fromkeys(s for s, _ in layout.names):
        at, prior = layout.at(symbol), model.priors[symbol]
        ln = np.log(np.broadcast_to(np.asarray(prior.value, dtype=np.float64), (model.cells,)))
        mean[at] = ln if symbol in PER_CELL else ln.mean()
        own = settings.spread.get(symbol, 0.0) if symbol in PER_CELL and model.cells > 1 else 0.0
        cov[np.ix_(at, at)] = prior.rel_sd**2 + own**2 * np.eye(len(at))
    return CellPrior(mean, np.asarray(np.linalg.inv(cov), dtype=np.float64))


@dataclass(frozen=True, slots=True)
class Baseline:
    """Result of a commissioning run: then all surfaces were sensed, later only two.

    Attributes
    ----------
    layout : Layout
    mean : ndarray (p,)
    cov : ndarray (p, p)
    resistance : ndarray (n,), Ω
        Electrical resistances of that run; NaN where there were none.
    """

    layout: Layout
    mean: Floats
    cov: Floats
    resistance: Floats

    def prior(self, resistance: Floats, rel_sd: Floats, settings: CellSettings) -> CellPrior:
        """Make the present prior: the cells may have aged, and their voltages show by how much.

        Parameters
        ----------
        resistance, rel_sd : ndarray (n,)
            Present electrical resistances; NaN where there are none.
        settings : CellSettings
        """
        at = np.asarray(self.layout.at("R_e"))
        followed = np.isfinite(resistance) & np.isfinite(self.resistance)
        mean, cov = self.mean.copy(), self.cov.copy()
        mean[at[followed]] += np.log(resistance[followed] / self.resistance[followed])
        alone = (~followed).astype(np.float64)
        own = np.where(followed, np.hypot(FOLLOWED, np.where(followed, rel_sd, 0.0)), AGED_APART)
        cov[np.ix_(at, at)] += AGED_TOGETHER**2 * np.outer(alone, alone) + np.diag(own**2)
        film = self.layout.at("R_u")
        cov[np.ix_(film, film)] += FOULED**2
        prior = CellPrior(mean, np.asarray(np.linalg.inv(cov), dtype=np.float64))
        return prior.with_electrical(at.tolist(), np.where(followed, np.nan, resistance), rel_sd, settings)
