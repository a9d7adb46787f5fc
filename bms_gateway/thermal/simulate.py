"""Free-running simulation of a string."""

import numpy as np

from bms_gateway.thermal.discretize import DiscreteString
from bms_gateway.thermal.parameters import Floats


def simulate(d: DiscreteString, x0: Floats, q: Floats, T_f_in: Floats) -> Floats:
    """Run the string forward with no measurement.

    Parameters
    ----------
    d : DiscreteString
    x0 : ndarray (2n,)
        Start, °C.
    q : ndarray (K, n)
        Mean heat of each step, W.
    T_f_in : ndarray (K + 1,)
        Inlet at the K + 1 instants, °C.

    Returns
    -------
    ndarray (K + 1, 2n)
        States at the instants, the start first, °C.

    References
    ----------
    Lin et al., Eq 1 and 18; Fig 3, 7 and 8 are such runs.

    Examples
    --------
    >>> from bms_gateway.thermal.discretize import discretize
    >>> from bms_gateway.thermal.parameters import StringParameters
    >>> from bms_gateway.thermal.string import continuous
    >>> p = StringParameters.of(1, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79)
    >>> x = simulate(discretize(continuous(p), 60.0), np.full(2, 25.0), np.full((100, 1), 10.0), np.full(101, 25.0))
    >>> np.round(x[-1], 1)
    array([45.6, 32.9])
    """
    drive = q @ d.B_q.T + np.outer(T_f_in[:-1], d.B_f0) + np.outer(T_f_in[1:], d.B_f1)
    x = np.empty((len(drive) + 1, d.A.shape[0]))
    x[0] = x0
    for k, u in enumerate(drive):
        x[k + 1] = d.A @ x[k] + u
    return x
