r"""The jelly roll as a cylinder: a share of R_c lies within it, and heat needs time from the axis to the edge.

A uniformly heated cylinder with an insulated edge relaxes by modes j with the shares s_j = 8/x_j², where x_j are the
zeros of the Bessel function J_1. Two states represent the slow modes; the fast ones, which end within a second or two,
are a resistance s_0 in series with that to the casing. With φ the share of R_c within the roll, f the flux into the
casing, T_c the mean over the volume and m_i the difference at the edge by state i

.. math::
    f &= \frac{T_c + \sum_i m_i - T_s}{R_c (1 - \varphi + \varphi s_0)} \\
    \tau_i \dot m_i &= -m_i - \varphi R_c s_i f, \qquad \tau_i = \varphi R_c C_c p_i

In the steady state T_c − T_s = R_c f for every φ.

Beyond Lin et al., Eq 1, whose core is one node.
"""

import numpy as np

from bms_gateway.thermal.parameters import Floats, StringParameters
from bms_gateway.thermal.string import ContinuousString

SHARE = np.array([0.620511, 0.272445])
"""s_i: share of each state in the resistance from mean to edge of a uniformly heated cylinder."""
FAST = 1.0 - float(SHARE.sum())
"""s_0: share of all modes that are too fast for a state."""
PACE = np.array([0.509876, 0.062213])
"""p_i: time constant of each state in units of φ R_c C_c.

These numbers minimise the difference between s_0 + Σ s_i/(1 + jω p_i) and Σ s_j/(1 + jω s_j) over all modes j, at 80
frequencies ω from 0.3 to 60 with equal ratios, under Σ s_i p_i = 1/3 as for all modes: the roll then stores as much
heat under steady heating. The difference is 0.029 at most. A third state instead of s_0 halves it, but doubles the time
of the fit of a window of twelve cells, for changes within two seconds that readings of a bus do not show."""
STATES = len(SHARE)


def with_roll(s: ContinuousString, p: StringParameters, share: float) -> ContinuousString:
    """Distribute a share of R_c over the jelly roll of each cell.

    Parameters
    ----------
    s : ContinuousString
        Of the string `p` of n cells with one node for each core.
    p : StringParameters
    share : float
        φ, below 1.

    Returns
    -------
    ContinuousString
        Of (2 + `STATES`) n states: those of `s`, then the differences at the edge, K, cell by cell. `s` itself if φ is
        0.
    """
    if share == 0.0:
        return s
    n, g = p.cells, STATES
    N, cells = 2 * n, np.arange(n)
    core, casing = 2 * cells, 2 * cells + 1
    A = np.zeros((N + g * n, N + g * n))
    A[:N, :N] = s.A
    contact = p.R_c * (1.0 - share + share * FAST)
    more = 1.0 / contact - 1.0 / p.R_c  # additional flux per difference T_c − T_s
    A[core, core] -= more / p.C_c
    A[core, casing] += more / p.C_c
    A[casing, core] += more / p.C_s
    A[casing, casing] -= more / p.C_s
    at = N + g * cells[:, None] + np.arange(g)  # (n, g)
    tau = (share * p.R_c * p.C_c)[:, None] * PACE
    felt = (share * p.R_c / contact)[:, None] * SHARE / tau
    A[core[:, None], at] = -(1.0 / (contact * p.C_c))[:, None]
    A[casing[:, None], at] = (1.0 / (contact * p.C_s))[:, None]
    A[at, core[:, None]] = -felt
    A[at, casing[:, None]] = felt
    A[at[:, :, None], at[:, None, :]] = -felt[:, :, None]
    A[at, at] -= 1.0 / tau
    return ContinuousString(A, np.vstack((s.B_q, np.zeros((g * n, n)))), np.concatenate((s.B_f, np.zeros(g * n))))


def resting(n: int, share: float) -> Floats:
    """Return the map from 2 n cores and casings to all states of `with_roll`, with the profile of steady heating."""
    g, N = STATES if share > 0.0 else 0, 2 * n
    out = np.zeros((N + g * n, N))
    out[:N] = np.eye(N)
    for i, s in enumerate(SHARE[:g]):
        at = N + g * np.arange(n) + i
        out[at, 2 * np.arange(n)] = -share * s
        out[at, 2 * np.arange(n) + 1] = share * s
    return out
