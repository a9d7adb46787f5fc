r"""Information of surfaces on R_c of a cell whose size is not known.

A window finds R_c from how the surface follows the heat within a minute or two. In this time the profile of the roll,
the contact of a thermocouple and its lag have as much influence as R_c. The fit carries them with the spread that cells
of known size have (`carried`). If not even the capacity is known, the R_c that the surfaces show is the cell's R_c
times an unknown factor, the same in all windows:

.. math:: \ln R_c^{shown} = \ln R_c + \varepsilon, \qquad \varepsilon \sim N(0, s^2)

and ε is integrated out of the information of the data before the prior is added. So R_c stays nearer to its prior, and
its band is never narrower than s and the prior allow. The other numbers follow by their correlation with R_c.

Beyond Lin et al., whose cells are known.
"""

from typing import Final

import numpy as np

from bms_gateway.thermal import Floats

SIZE_UNKNOWN_SD: Final = 0.5
"""Of ln C_c: the capacity of a named or weighed cell is known far better than this."""


def shown_sd(capacity_sd: float) -> float:
    """Return s for the prior sd of ln C_c: positive if the size is unknown, 0 if it is known."""
    return capacity_sd if capacity_sd >= SIZE_UNKNOWN_SD else 0.0


def as_shown(mean: Floats, cov: Floats, known: Floats, known_sd: Floats, at: int, sd: float) -> tuple[Floats, Floats]:
    """Reduce the information of the data on number `at` in a posterior to that of an error `sd`.

    Parameters
    ----------
    mean, cov : ndarray (p,), (p, p)
        Posterior.
    known, known_sd : ndarray (p,)
        Prior; sd 0 for fixed numbers.
    at : int
    sd : float
        Positive.

    Returns
    -------
    mean, cov : ndarray (p,), (p, p)

    References
    ----------
    Not in the paper.

    Examples
    --------
    Data that show a number exactly, but with an error of 1, count as much as a prior of the same size:

    >>> one = np.ones(1)
    >>> mean, cov = as_shown(one, np.array([[1e-9]]), np.zeros(1), one, 0, 1.0)
    >>> round(float(mean[0]), 6), round(float(cov[0, 0]), 6)
    (0.5, 0.5)
    """
    free = np.flatnonzero((known_sd > 0.0) & (np.diag(cov) > 0.0))
    if at not in free:
        return mean, cov
    part = np.ix_(free, free)
    whole, before = np.linalg.inv(cov[part]), np.diag(known_sd[free] ** -2)
    # carried effects may leave more uncertainty than the prior of a number: nothing was learnt in that direction
    values, vectors = np.linalg.eigh(whole - before)
    info = (vectors * np.maximum(values, 0.0)) @ vectors.T
    pull = whole @ (mean - known)[free]
    shown = info[:, free == at][:, 0]
    gain = shown / (sd**-2 + shown[free == at][0])
    pull = pull - gain * pull[free == at][0]
    left = np.linalg.inv(info - np.outer(gain, shown) + before)
    mean, out = mean.copy(), np.zeros_like(cov)
    mean[free] = known[free] + left @ pull
    out[part] = 0.5 * (left + left.T)
    return mean, out
