r"""Model errors seen by a fit: how far data may move a number, and the factor on the noise if they move it farther.

A small residual does not prove a model. If data pull a parameter far from its prior, the model lacks something, and the
residual is less reliable than its size suggests. With information H of the data, prior information Λ and a posterior at
distance δ from the prior, data of weight w ≤ 1 lead to

.. math::
    \delta(w) = (w H + \Lambda)^{-1} \, w \, (H + \Lambda) \, \delta

The largest w with which every judged combination of numbers c stays within its limit, :math:`|c^T \delta(w)| \le l`,
gives the factor :math:`1 / \sqrt{w}` on the noise.

Beyond Lin et al., who assume a true model.
"""

from typing import Final

import numpy as np

from bms_gateway.thermal import Floats

SOUND_SD: Final = {"R_e": 2.0, "R_c": 2.0, "R_u": 2.0, "contact": 1.5, "roll": 3.0, "warmth": 3.0}
"""Prior sd by which the data may move a number. Resistances are what is to be found, and their priors are wide guesses.
Any share of R_c may lie in the roll, R_e of every cell falls as it warms, and thermocouples have offsets, which look
like contact. For capacities and the other carried effects, the prior is knowledge: data that move them farther indicate
a model error."""
SOUND_OTHER_SD: Final = 1.0
DOUBTED: Final = 3.0
"""Factor on the noise from which the cores of a string are not proven. Simulated cells without a missing effect stay at
1.0."""
HOPELESS: Final = 4.0
"""Factor on the noise from which a window teaches nothing: most of what the surfaces show is missing in the model."""
LEAST_WEIGHT: Final = 1e-4
HALVINGS: Final = 20


def hopeless(doubt: float) -> float:
    """How far a factor on the noise is from `DOUBTED` to `HOPELESS`, 0 to 1.

    A limit alone would let two almost equal windows teach much or nothing.
    """
    return min(max((doubt - DOUBTED) / (HOPELESS - DOUBTED), 0.0), 1.0)


def sound_sd(name: str) -> float:
    """Prior sd by which data may move the parameter or carried effect `name`."""
    return SOUND_SD.get(name, SOUND_OTHER_SD)


def noise_factor(info: Floats, known: Floats, off: Floats, judged: Floats, limit: Floats) -> float:
    """Factor on the noise with which all judged combinations of numbers stay within their limits.

    Parameters
    ----------
    info, known : ndarray (p, p)
        Information of the data at full weight, and of the prior.
    off : ndarray (p,)
        Posterior mean minus prior mean.
    judged : ndarray (c, p)
    limit : ndarray (c,)
        Positive.

    Returns
    -------
    float
        1 if all are within their limits already; at most ``LEAST_WEIGHT ** -0.5``.

    Examples
    --------
    Data as good as the prior moved a number by 2 prior sd; to move it by 4/3, they must be half as good:

    >>> one = np.eye(1)
    >>> round(noise_factor(one, one, np.array([2.0]), one, np.array([4 / 3])) ** 2, 3)
    2.0
    """
    if np.all(np.abs(judged @ off) <= limit):
        return 1.0
    pull = (info + known) @ off
    low, high = LEAST_WEIGHT, 1.0
    for _ in range(HALVINGS):
        weight = float(np.sqrt(low * high))
        inside = bool(np.all(np.abs(judged @ np.linalg.solve(weight * info + known, weight * pull)) <= limit))
        low, high = (weight, high) if inside else (low, weight)
    return float(low**-0.5)
