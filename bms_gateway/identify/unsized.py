r"""What surfaces tell of R_c in a cell whose size nobody knows.

A window finds R_c by how the surface follows the heat within a minute or two. In this time the profile of the roll, the
contact of a thermocouple and its lag do as much as R_c does. The fit carries them with the spread that cells of known
size have (`carried`). Where not even the capacity is known, the R_c that the surfaces show is taken for that of the
cell times an unknown factor, the same in all windows:

.. math:: \ln R_c^{shown} = \ln R_c + \varepsilon, \qquad \varepsilon \sim N(0, s^2)

and ε is integrated out of what the data say before the prior is added. So R_c stays nearer to what was known of it, and
its band is never narrower than s and the prior allow. The other numbers follow by what they have in common with it.

Beyond Lin et al., whose cells are known.
"""

from typing import Final

import numpy as np

from bms_gateway.thermal import Floats

SIZE_UNKNOWN_SD: Final = 0.5
"""Of ln C_c: the capacity of a cell that was named, or weighed, is known far better than this."""


def shown_sd(capacity_sd: float) -> float:
    """Tell s by the prior sd of ln C_c: as much as the size is open, and 0 where it is known."""
    return capacity_sd if capacity_sd >= SIZE_UNKNOWN_SD else 0.0


def as_shown(mean: Floats, cov: Floats, known: Floats, known_sd: Floats, at: int, sd: float) -> tuple[Floats, Floats]:
    """Take out of a posterior what its data say of number `at` more exactly than by `sd`.

    Parameters
    ----------
    mean, cov : ndarray (p,), (p, p)
        Posterior.
    known, known_sd : ndarray (p,)
        What was known before any data; 0 for what is fixed.
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
    Data that show a number exactly, by an error of 1, say as much of it as a prior of the same size:

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
    # carried effects may leave more open than the prior of a number does: nothing was learnt in that direction
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
