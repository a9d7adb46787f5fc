"""Persistent excitation: whether a window of data determines all coefficients."""

import numpy as np

from bms_gateway.thermal import Floats


def excitation(Phi: Floats, length: int) -> Floats:
    """Extreme eigenvalues of the mean of φφᵀ over windows.

    Parameters
    ----------
    Phi : ndarray (K, c)
        Scaled regressors.
    length : int
        Steps per window.

    Returns
    -------
    ndarray (K // length, 2)
        Smallest and largest eigenvalue of each window. They depend on the scaling (`regression.SCALE`), so only windows
        with the same scaling can be compared.

    References
    ----------
    Lin et al., Eq 15 (its α₀ and α₁ are printed the wrong way round).

    Examples
    --------
    >>> excitation(np.eye(2)[[0, 1, 0, 0]], 2)
    array([[0.5, 0.5],
           [0. , 1. ]])
    """
    windows = len(Phi) // length
    out = np.empty((windows, 2))
    for w in range(windows):
        part = Phi[w * length : (w + 1) * length]
        out[w] = np.linalg.eigvalsh(part.T @ part / length)[[0, -1]]
    return out
