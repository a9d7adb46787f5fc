r"""Coordinates in which the data are informative: what one cell's surface determines, and what it does not.

With ln of the physical values φ = (C_c, C_s, R_e, R_c, R_u) the surface obeys (Eq 7–8, kept exact)

.. math::
    s^2 T_s = \alpha I^2 + \beta (T_f - T_s) + \gamma s T_s + \mu s T_f

    \alpha = \frac{R_e}{C_c C_s R_c}, \quad \beta = \frac{1}{C_c C_s R_c R_u}, \quad
    -\gamma = \frac{C_c + C_s}{C_c C_s R_c} + \frac{1}{C_s R_u}, \quad \mu = \frac{1}{C_s R_u}

While the coolant temperature is constant, μ has no influence and R_c, R_u follow from γ by a quadratic with two
positive roots (Eq 9), R_u and R_u* = C_c R_c/(C_c + C_s). The likelihood is then a bent ridge in φ but nearly Gaussian
in (ln α, ln β, ln −γ, ln μ). So information of the data is kept in these coordinates and priors in φ. Data of strings
determine the conductance 1/R_cc, which may be zero, and not ln R_cc, which then diverges.
"""

import numpy as np

from bms_gateway.thermal import Floats

# Places of the physical values in φ; strings append ln R_cc where they conduct, ln C_f where the stream warms up.
C_C, C_S, R_E, R_C, R_U, R_CC = range(6)


def lumped(phi: Floats, conduction: bool = False) -> Floats:
    """Z = (ln α, ln β, ln −γ, ln μ, ln C_c, …) of φ = ln(C_c, C_s, R_e, R_c, R_u, …); one to one.

    Parameters
    ----------
    phi : ndarray (p,), p ≥ 5
    conduction : bool
        φ holds ln R_cc after the cell's five.

    Returns
    -------
    ndarray (p,)

    References
    ----------
    Lin et al., Eq 8: its coefficients by the cell's values.

    Examples
    --------
    >>> z = lumped(np.log([268, 18.8, 3.5e-3, 1.266, 0.79]))
    >>> np.round(np.exp(z[1:4]), 6)  # β is the product of the poles, −γ minus their sum
    array([0.000198, 0.112294, 0.067331])
    """
    C_c, C_s, R_e, R_c, R_u = phi[:5]
    inner = -C_c - C_s - R_c
    ln_gamma = np.logaddexp(np.logaddexp(-C_s - R_c, -C_c - R_c), -C_s - R_u)
    z = np.array(phi, dtype=np.float64)
    z[:5] = inner + R_e, inner - R_u, ln_gamma, -C_s - R_u, C_c
    if conduction:
        z[R_CC] = np.exp(-phi[R_CC])
    return z


def lumped_jacobian(phi: Floats, conduction: bool = False) -> Floats:
    """∂z/∂φ (p, p); regular everywhere, also at the fold.

    References
    ----------
    Lin et al., Eq 8, differentiated.
    """
    C_c, C_s, _, R_c, R_u = phi[:5]
    D = np.eye(len(phi))
    D[:5, :5] = 0.0
    D[0, [C_C, C_S, R_E, R_C]] = -1.0, -1.0, 1.0, -1.0
    D[1, [C_C, C_S, R_C, R_U]] = -1.0
    parts = np.exp(np.array([-C_s - R_c, -C_c - R_c, -C_s - R_u]))
    w = parts / parts.sum()  # shares of −γ
    D[2, [C_C, C_S, R_C, R_U]] = -w[1], -w[0] - w[2], -w[0] - w[1], -w[2]
    D[3, [C_S, R_U]] = -1.0
    D[4, C_C] = 1.0
    if conduction:
        D[R_CC, R_CC] = -np.exp(-phi[R_CC])
    return D


def alias(phi: Floats) -> Floats:
    """Find the other physical cell with the same surface for any current while the coolant temperature is constant.

    Heat capacities are kept; R_u and R_u* = C_c R_c/(C_c + C_s) are exchanged; R_c R_u and R_e R_u are kept.

    References
    ----------
    Lin et al., Eq 9: its other root.

    Examples
    --------
    >>> a = np.exp(alias(np.log([268, 18.8, 3.5e-3, 1.266, 0.79])))
    >>> np.round(a[2] * 1e3, 5), np.round(a[3:], 5)
    (np.float64(2.33725), array([0.84542, 1.18301]))
    """
    out = np.array(phi, dtype=np.float64)
    shift = fold_distance(phi)
    out[R_U] -= shift
    out[R_C] += shift
    out[R_E] += shift
    return out


def fold_distance(phi: Floats) -> float:
    """ln(R_u/R_u*): zero on the fold, positive for the larger root.

    References
    ----------
    Lin et al., Eq 9: where its roots meet.
    """
    C_c, C_s, _, R_c, R_u = phi[:5]
    return float(R_u - R_c - C_c + np.logaddexp(C_c, C_s))


def fold_gradient(phi: Floats) -> Floats:
    """∂ ln(R_u/R_u*)/∂φ (p,).

    References
    ----------
    Lin et al., Eq 9: where its roots meet.
    """
    share = 1.0 / (1.0 + np.exp(phi[C_C] - phi[C_S]))  # C_s/(C_c + C_s)
    g = np.zeros(len(phi))
    g[[C_C, C_S, R_C, R_U]] = -share, share, -1.0, 1.0
    return g
