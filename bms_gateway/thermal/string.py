r"""A string of n cells along its coolant path as a linear system.

State (paper, Eq 18): x = [T_c1, T_s1, T_c2, T_s2, …], °C. Inputs: heat q_k [W] made in the core of cell k (I²R_e, or
any better value of the heat) and the coolant inlet T_f_in [°C]. For cell k with n_k neighbours

.. math::
    C_c \dot T_{c,k} &= q_k + (T_{s,k} - T_{c,k}) / R_c \\
    C_s \dot T_{s,k} &= C_f e_k (T_{f,k} - T_{s,k}) - (T_{s,k} - T_{c,k}) / R_c
                        + \sum_j (T_{s,j} - T_{s,k}) / R_{cc} \\
    T_{f,k} &= (1 - e_{k-1}) T_{f,k-1} + e_{k-1} T_{s,k-1}, \qquad T_{f,1} = T_{f,in}

with e = 1/(R_u C_f), the paper's bulk node (Eq 16), or e = 1 − exp(−1/(R_u C_f)), the exact exchange of a stream with a
wall of constant temperature (NTU). In both, the surface gives off what the stream takes up, C_f e per kelvin: 1/R_u for
the bulk node and for a stream that does not warm up. Corrections to the paper's print: end cells have one neighbour,
not two (Eq 16); R_s is R_u (Eq 17); entry (3,4) is 1/(R_c C_c) (Eq 18).
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.errors import ConfigError
from bms_gateway.thermal.parameters import Floats, StringParameters


@dataclass(frozen=True, slots=True)
class ContinuousString:
    """ẋ = A x + B_q q + B_f T_f_in.

    Attributes
    ----------
    A : ndarray (2n, 2n), 1/s
    B_q : ndarray (2n, n), K/J
    B_f : ndarray (2n,), 1/s
        Rows of A sum to −B_f: a string in equilibrium with its inlet stays there.

    References
    ----------
    Lin et al., Eq 18.
    """

    A: Floats
    B_q: Floats
    B_f: Floats


def exchange(p: StringParameters) -> Floats:
    """Share e_k of the gap surface − coolant that the stream takes up when it passes cell k.

    Returns
    -------
    ndarray (n,)
        0 if the stream does not warm up (C_f infinite).

    Raises
    ------
    ConfigError
        Bulk node with R_u C_f ≤ 1: the stream would leave hotter than the cell; the user needs "ntu" or a larger C_f.

    References
    ----------
    Lin et al., Eq 16 (bulk node).
    """
    ntu = 1.0 / (p.R_u * p.C_f)
    if p.coolant == "ntu":
        return -np.expm1(-ntu)
    if np.any(ntu >= 1.0):
        raise ConfigError(
            f'coolant node: R_u*C_f = {float(np.min(p.R_u * p.C_f)):.3g} must be above 1 for coolant = "bulk"; '
            'use coolant = "ntu" or a larger C_f'
        )
    return ntu


def film(p: StringParameters) -> Floats:
    """Conductance from each surface to the coolant at its cell, W/K: heat into the stream per kelvin, C_f e_k.

    Returns
    -------
    ndarray (n,)
        1/R_u for the bulk node and for a stream that does not warm up (C_f infinite); less for "ntu", because the
        stream warms along the cell.

    References
    ----------
    Lin et al., Eq 16 (bulk node); for "ntu" the heat balance of the stream.

    Examples
    --------
    >>> cell = {"C_c": 268, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.8, "C_f": 12.5}
    >>> np.round(film(StringParameters.of(1, **cell, coolant="bulk")), 4)
    array([1.25])
    >>> np.round(film(StringParameters.of(1, **cell, coolant="ntu")), 4)
    array([1.1895])
    """
    if p.coolant == "ntu" and np.isfinite(p.C_f):
        return np.asarray(p.C_f * exchange(p), dtype=np.float64)
    return np.asarray(1.0 / p.R_u, dtype=np.float64)


def coolant_path(p: StringParameters) -> tuple[Floats, Floats]:
    """Coolant temperature at each cell as T_f = M T_s + m T_f_in.

    Returns
    -------
    M : ndarray (n, n)
        Strictly lower triangular; rows of [M, m] sum to 1.
    m : ndarray (n,)

    References
    ----------
    Lin et al., Eq 16 and 17, combined.
    """
    n, e = p.cells, exchange(p)
    M, m = np.zeros((n, n)), np.ones(n)
    for k in range(1, n):
        M[k] = (1.0 - e[k - 1]) * M[k - 1]
        M[k, k - 1] += e[k - 1]
        m[k] = (1.0 - e[k - 1]) * m[k - 1]
    return M, m


def continuous(p: StringParameters) -> ContinuousString:
    """Build the linear system of a string.

    References
    ----------
    Lin et al., Eq 1 (one cell), Eq 16–18 (string), corrected as in this module's docstring.

    Examples
    --------
    >>> s = continuous(StringParameters.of(1, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79))
    >>> np.round(np.sort(np.linalg.eigvals(s.A)), 6)
    array([-0.110498, -0.001796])
    """
    n = p.cells
    core, surface = np.arange(0, 2 * n, 2), np.arange(1, 2 * n, 2)
    M, m = coolant_path(p)
    A = np.zeros((2 * n, 2 * n))
    A[core, core] = -1.0 / (p.R_c * p.C_c)
    A[core, surface] = 1.0 / (p.R_c * p.C_c)
    A[surface, core] = 1.0 / (p.R_c * p.C_s)
    to_coolant = film(p)
    G = np.diag(-1.0 / p.R_c - to_coolant) + M * to_coolant[:, None]
    k = np.arange(n - 1)
    G[k, k] -= 1.0 / p.R_cc
    G[k + 1, k + 1] -= 1.0 / p.R_cc
    G[k, k + 1] += 1.0 / p.R_cc
    G[k + 1, k] += 1.0 / p.R_cc
    A[np.ix_(surface, surface)] = G / p.C_s[:, None]
    B_q = np.zeros((2 * n, n))
    B_q[core, np.arange(n)] = 1.0 / p.C_c
    B_f = np.zeros(2 * n)
    B_f[surface] = m * to_coolant / p.C_s
    return ContinuousString(A, B_q, B_f)


def steady_state(p: StringParameters, q: Floats, T_f_in: float) -> Floats:
    """Temperatures at which the string rests under constant heat.

    Parameters
    ----------
    p : StringParameters
    q : ndarray (n,)
        Heat per cell, W.
    T_f_in : float
        Inlet, °C.

    Returns
    -------
    ndarray (2n,)
        [T_c1, T_s1, …], °C.

    References
    ----------
    Lin et al., Eq 1 and 18 at rest; Fig 7 is near it.

    Examples
    --------
    >>> p = StringParameters.of(1, C_c=268, C_s=18.8, R_e=3.5e-3, R_c=1.266, R_u=0.79)
    >>> np.round(steady_state(p, np.array([10.0]), 25.0), 2)  # 10 W over R_c + R_u and over R_u
    array([45.56, 32.9 ])
    """
    s = continuous(p)
    rise = np.asarray(np.linalg.solve(s.A, -(s.B_q @ q)), dtype=np.float64)
    return rise + T_f_in
