"""What is uncertain beside the filter: how unlike cells are, and the root of a covariance.

Beyond Lin et al., whose observer holds its parameters for exact.
"""

import numpy as np

from bms_gateway.observe.sensitivity import PARAMETERS
from bms_gateway.thermal import Floats, StringModel


def scatter(model: StringModel) -> Floats:
    """Square what cells differ in R_e, R_u and R_c, and of the thermocouples' offset; one cell is its own mean."""
    keys = ("cell_R_e", "cell_R_u", "cell_R_c", "surface_offset_K")
    sd = np.array([model.tolerances.get(k, 0.0) for k in keys])
    if model.cells == 1:
        sd[:3] = 0.0
    return np.asarray(np.square(sd), dtype=np.float64)


def root(covariance: Floats) -> Floats:
    """Find F with F Fᵀ = covariance; by eigenvalues, because fixed parameters make it singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def as_tolerated(tolerated: Floats, cells: int) -> Floats:
    """Covariance (S, n, 3, 3) of each cell's ln R_e, ln R_u, ln R_c by variances (3, S): uncorrelated."""
    own = np.zeros((tolerated.shape[1], cells, 3, 3))
    at = np.arange(3)
    own[:, :, at, at] = tolerated.T[:, None]
    return own


def prior_covariance(model: StringModel, heat_rel_sd: float) -> Floats:
    """Covariance of the logarithms of `PARAMETERS` before anything is identified."""
    sd = [model.priors[k].rel_sd if k in model.priors else 0.0 for k in PARAMETERS[:-1]]
    return np.diag(np.square([*sd, heat_rel_sd]))


def between_cells(levers: Floats, tolerated: Floats, own: Floats | None) -> tuple[Floats, Floats]:
    """Variance that cells add by being unlike, in the steady proportions.

    Parameters
    ----------
    levers : ndarray (3, s, n), K
        Temperatures that a cell's own R_e, R_u and R_c stand behind: of its core over its base (rise), of its surface
        over it (over), between core and surface (gap).
    tolerated : ndarray (3, s)
        Variances of ln R_e, ln R_u, ln R_c by the models' tolerances.
    own : ndarray (s, n, 3, 3) or None
        Covariance of each cell's ln R_e, ln R_u, ln R_c where it is known better.

    Returns
    -------
    ndarray (s, n), ndarray (s, n), K²
        Of cores and of surfaces.
    """
    squares = np.square(levers)
    if own is None:
        heat, cooling, _ = tolerated
        return np.einsum("ksn,ks->sn", squares, tolerated), squares[1] * (heat + cooling)[:, None]
    heat, cooling, inside = (own[:, :, a, a] for a in range(3))
    of_heat, of_gap, of_film = own[:, :, 0, 1], own[:, :, 0, 2], own[:, :, 1, 2]
    rise, over, gap = levers
    core = heat * squares[0] + cooling * squares[1] + inside * squares[2]
    core += 2.0 * (of_heat * rise * over + of_gap * rise * gap + of_film * over * gap)
    return core, (heat + cooling + 2.0 * of_heat) * squares[1]


def of_unlike(T_c: Floats, T_s: Floats, base: Floats, scattered: Floats) -> Floats:
    """Variance (2n,), cores and surfaces in turn, K², that n cells over a `base` (n,) add by a model's tolerances."""
    heat, cooling, inside, offset = scattered
    surface = (T_s - base) ** 2
    var = np.empty(2 * len(T_c))
    var[0::2] = heat * (T_c - base) ** 2 + cooling * surface + inside * (T_c - T_s) ** 2 + offset
    var[1::2] = (heat + cooling) * surface + offset
    return var
