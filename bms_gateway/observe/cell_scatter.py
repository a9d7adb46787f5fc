"""Uncertainty besides that of the filter: scatter of the cells, and the root of a covariance.

Beyond Lin et al., whose observer treats its parameters as exact.
"""

import numpy as np

from bms_gateway.observe.sensitivity import HEAT_AT, PARAMETERS, SYMBOLS
from bms_gateway.thermal import Floats, StringModel, StringParameters
from bms_gateway.thermal.entropy import PRIOR_SD


def scatter(model: StringModel) -> Floats:
    """Variances of the cells' R_e, R_u and R_c and of the thermocouples' offset; a single cell has no scatter."""
    keys = ("cell_R_e", "cell_R_u", "cell_R_c", "surface_offset_K")
    sd = np.array([model.tolerances.get(k, 0.0) for k in keys])
    if model.cells == 1:
        sd[:3] = 0.0
    return np.asarray(np.square(sd), dtype=np.float64)


def root(covariance: Floats) -> Floats:
    """Find F with F Fᵀ = covariance; by eigenvalues, because fixed parameters make it singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def apart_by(old: StringParameters, new: StringParameters, gain: float) -> tuple[Floats, dict[str, Floats]]:
    """Logarithmic change of a string's parameters, in common and per cell.

    Parameters
    ----------
    old, new : StringParameters
    gain : float
        New over old factor on measured heat.

    Returns
    -------
    moved : ndarray (p,)
        Of `PARAMETERS`, mean of the cells; 0 for reversible heat.
    apart : dict of str to ndarray (n,)
        By symbol, the change of each cell beyond that mean.
    """
    moved, apart = np.zeros(len(PARAMETERS)), {}
    moved[HEAT_AT] = np.log(gain)
    for j, name in enumerate(SYMBOLS):
        a, b = np.asarray(getattr(old, name)), np.asarray(getattr(new, name))
        if np.isfinite(a).all():
            ln = np.log(b / a)
            moved[j], apart[name] = float(np.mean(ln)), ln - np.mean(ln)
    return moved, apart


def own_rise(apart: dict[str, Floats], rise: Floats, over: Floats, gap: Floats) -> Floats:
    """Change of cores and surfaces (2n,), K, of cells whose parameters change by `apart` (`apart_by`).

    A cell's temperature rise is proportional to its own heat and resistances. `rise` and `over` are core and surface
    over their base, `gap` is core minus surface (n,).
    """
    moved = np.empty(2 * len(gap))
    moved[0::2] = apart["R_e"] * rise + apart["R_u"] * over + apart["R_c"] * gap
    moved[1::2] = (apart["R_e"] + apart["R_u"]) * over
    return moved


def as_tolerated(tolerated: Floats, cells: int) -> Floats:
    """Covariance (S, n, 3, 3) of each cell's ln R_e, ln R_u, ln R_c by variances (3, S): uncorrelated."""
    own = np.zeros((tolerated.shape[1], cells, 3, 3))
    at = np.arange(3)
    own[:, :, at, at] = tolerated.T[:, None]
    return own


def exchanged(covariance: Floats, at: list[int], block: Floats) -> Floats:
    """Replace the rows and columns `at` by `block` (p, p), uncorrelated with the rest; the rest is not changed."""
    out = covariance.copy()
    out[at, :] = 0.0
    out[:, at] = 0.0
    out[np.ix_(at, at)] = block
    return out


def prior_covariance(model: StringModel, heat_rel_sd: float) -> Floats:
    """Covariance of the logarithms of `PARAMETERS`, and of reversible heat, before any identification.

    Warmth counts as known: see `AdaptiveObserver.consider_warmth`.
    """
    sd = [model.priors[k].rel_sd if k in model.priors else 0.0 for k in SYMBOLS]
    return np.diag(np.square([*sd, heat_rel_sd, *PRIOR_SD, 0.0]))


def weights(tolerated: Floats, phi: Floats, phi_sd: Floats) -> Floats:
    r"""Weights (s, 3, 4) that turn squares of levers into the variances by the scatter of cells.

    They are for cores, surfaces and centres, by the squares of rise, over, gap and lag (`between_cells`), where cells
    differ by their models' tolerances alone. The centre is core + φ gap, with :math:`(rise + \varphi gap)^2 = (1 +
    \varphi) rise^2 - \varphi over^2 + \varphi (1 + \varphi) gap^2`, because rise = over + gap.

    Parameters
    ----------
    tolerated : ndarray (3, s)
        Variances of ln R_e, ln R_u, ln R_c.
    phi, phi_sd : ndarray (s,)
        Share of R_c within the roll.
    """
    heat, cooling, inside = tolerated
    none = np.zeros_like(heat)
    of_gap = heat * phi * (1.0 + phi) + inside * (1.0 + phi) ** 2 + phi_sd**2 * (heat + inside)
    of_each = [
        [heat, cooling, inside, none],
        [none, heat + cooling, none, none],
        [heat * (1.0 + phi), cooling - heat * phi, of_gap, phi_sd**2],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(of_each), 2, 0))


def between_cells(levers: Floats, own: Floats, phi: Floats, phi_sd: Floats) -> Floats:
    """Variance from the scatter of cells, in steady-state proportions, and from φ.

    Parameters
    ----------
    levers : ndarray (4 or more, s, n), K
        Temperatures on which a cell's R_e, R_u and R_c act: core over base (rise), surface over base (over), core minus
        surface (gap); and the gap after the delay of the profile within the roll (lag).
    own : ndarray (s, n, 3, 3)
        Covariance of each cell's ln R_e, ln R_u, ln R_c about what is common to the cells.
    phi, phi_sd : ndarray (s, 1)
        Share of R_c within the roll.

    Returns
    -------
    ndarray (3, s, n), K²
        Of cores, surfaces and centres.
    """
    rise, over, gap, lag = levers[:4]
    heat, cooling, of_film = own[:, :, 0, 0], own[:, :, 1, 1], own[:, :, 0, 1]

    def of(rise: Floats, gap: Floats) -> Floats:
        slopes = np.stack([rise, over, gap], axis=-1)
        return np.asarray(np.einsum("sni,snij,snj->sn", slopes, own, slopes))

    of_gap = heat + own[:, :, 2, 2] + 2.0 * own[:, :, 0, 2]
    by_share = phi_sd**2 * (lag**2 + of_gap * gap**2)
    surface = (heat + cooling + 2.0 * of_film) * over**2
    return np.stack([of(rise, gap), surface, of(rise + phi * gap, (1.0 + phi) * gap) + by_share])


def of_centre(core: Floats, surface: Floats, both: Floats, phi: Floats | float, phi_sd: Floats | float) -> Floats:
    """Variance of core + φ (core - surface), K², from those of core, surface and φ, and the covariance `both`."""
    gap = np.maximum(core + surface - 2.0 * both, 0.0)
    plain = (1.0 + phi) ** 2 * core + phi**2 * surface - 2.0 * phi * (1.0 + phi) * both
    return np.asarray(np.maximum(plain, 0.0) + phi_sd**2 * gap)


def of_unlike(T_c: Floats, T_s: Floats, base: Floats, scattered: Floats) -> Floats:
    """Variances (2n,), core and surface in turn, K², of n cells over a `base` (n,) from a model's tolerances."""
    heat, cooling, inside, offset = scattered
    surface = (T_s - base) ** 2
    var = np.empty(2 * len(T_c))
    var[0::2] = heat * (T_c - base) ** 2 + cooling * surface + inside * (T_c - T_s) ** 2 + offset
    var[1::2] = (heat + cooling) * surface + offset
    return var
