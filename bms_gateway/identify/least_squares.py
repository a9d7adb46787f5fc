"""Batch least squares over the filtered regression: the paper's off-line reference."""

from collections.abc import Sequence

import numpy as np

from bms_gateway.identify.regression import Filter, unscale
from bms_gateway.thermal import Floats


def rows(square: Floats, T_s: Floats, T_f: Floats, dt: float, columns: Sequence[int]) -> tuple[Floats, Floats]:
    """Left sides (K,) and regressors (K, c), scaled, for mean I² (K,) and temperatures (K + 1,).

    References
    ----------
    Lin et al., Eq 8 (filtered signals).
    """
    filtered = Filter(dt)
    filtered.start(float(T_s[0]), float(T_f[0]))
    steps = [filtered.step(q, s, f) for q, s, f in zip(square, T_s[1:], T_f[1:], strict=True)]
    return np.array([z for z, _ in steps]), np.array([phi for _, phi in steps])[:, list(columns)]


def solve(
    square: Floats,
    T_s: Floats,
    T_f: Floats,
    dt: float = 1.0,
    *,
    moving_inlet: bool = False,
    transient: bool = False,
) -> tuple[Floats, Floats]:
    """Fit the coefficients of one cell.

    Parameters
    ----------
    square : ndarray (K,)
        Mean I² of each step, A².
    T_s, T_f : ndarray (K + 1,)
        Surface and coolant, °C.
    dt : float
        s.
    moving_inlet : bool
        Keep s·T_f.
    transient : bool
        Keep the impulse response; its coefficient is T_s'(0).

    Returns
    -------
    theta : ndarray (c,)
        α, β, γ[, μ][, T_s'(0)] in SI.
    eigenvalues : ndarray (c,)
        Of the mean of φφᵀ in the scaling of `regression`, ascending (Eq 15).

    Notes
    -----
    Noise on T_s enters the regressors: estimates are biased from 0.05 K on (R_e −10 %), and on the fold from 0.1 K on.

    References
    ----------
    Lin et al., Eq 3 (with the transpose that the print misses) and Eq 4 (rows φᵀ/m).
    """
    columns = [0, 1, 2] + ([3] if moving_inlet else []) + ([4] if transient else [])
    z, Phi = rows(square, T_s, T_f, dt, columns)
    m = np.sqrt(1.0 + np.einsum("ij,ij->i", Phi, Phi))  # Eq 4: large regressors do not outweigh all others
    theta, *_ = np.linalg.lstsq(Phi / m[:, None], z / m, rcond=None)
    full = np.zeros(5)
    full[columns] = theta
    return unscale(full)[columns], np.asarray(np.linalg.eigvalsh(Phi.T @ Phi / len(z)), dtype=np.float64)
