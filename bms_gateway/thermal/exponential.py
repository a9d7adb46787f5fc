r"""The matrix exponential, by products only.

`scipy.linalg` has one too, but its import takes more time to READY and more memory than the whole estimator.
"""

from math import factorial

import numpy as np

from bms_gateway.thermal.parameters import Floats

LEAST_SIZE = 0.5
"""Greatest norm of the scaled matrix in the series, which is then squared repeatedly."""
GROUP = 4
"""Number of stored powers: 16 terms cost six products."""


def exponential(Z: Floats) -> Floats:
    r"""e^Z, by Taylor's series of a share of Z that is squared back.

    .. math:: e^Z = \Bigl(\sum_{k \le 16} \frac{(Z/2^s)^k}{k!}\Bigr)^{2^s}

    Parameters
    ----------
    Z : ndarray (…, M, M)
        One matrix or a stack of them.

    Returns
    -------
    ndarray (…, M, M)
        NaN if any of `Z` is not finite; infinite if it diverges.

    Notes
    -----
    With a 1-norm of ½ the omitted term is below 1e-19. Terms are summed in groups of powers (Paterson and Stockmeyer
    1973).

    References
    ----------
    N. J. Higham, Functions of Matrices, 2008, sections 4.2 and 10.3.

    Examples
    --------
    >>> bool(np.allclose(exponential(np.array([[0.0, 1.0], [0.0, 0.0]])), [[1.0, 1.0], [0.0, 1.0]]))
    True
    >>> float(exponential(np.array([[-40.0]]))[0, 0] / np.exp(-40.0) - 1.0) < 1e-13
    True
    """
    size = float(np.abs(Z).sum(axis=-2).max())
    if not np.isfinite(size):
        return np.full_like(Z, np.nan)
    doublings = max(0, int(np.ceil(np.log2(max(size, LEAST_SIZE) / LEAST_SIZE))))
    powers = [np.eye(Z.shape[-1]), Z / 2.0**doublings]
    while len(powers) <= GROUP:
        powers.append(powers[-1] @ powers[1])
    E = powers[GROUP] / factorial(GROUP * GROUP)
    for first in range(GROUP * (GROUP - 1), -1, -GROUP):
        E += sum(powers[k] / factorial(first + k) for k in range(GROUP))
        if first:
            E = powers[GROUP] @ E
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(doublings):
            E = E @ E
    return E
