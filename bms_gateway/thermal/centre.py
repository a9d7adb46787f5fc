r"""Two temperatures of one jelly roll: its mean, which the heat balances use, and its hottest point.

A roll of length L and conductivity k that is heated uniformly by q has, in the steady state (H. S. Carslaw and J. C.
Jaeger, *Conduction of Heat in Solids*, 2nd ed., section 7.2, for the parabola that follows),

.. math::
    T_{centre} - T_{edge} = \frac{q}{4 \pi k L}, \qquad T_{mean} - T_{edge} = \frac{q}{8 \pi k L}

for any radius: the centre is as far above the mean as the mean is above the edge. A share φ of the resistance R_c
between mean and surface lies within the roll; the rest is contact between roll and casing, so that

.. math:: T_{centre} = T_c + \varphi \, (T_c - T_s)

φ is between 0 (all of R_c is contact) and 1 (all of it is within the roll). A profile follows with a delay: its slowest
mode, that of the first zero x_1 of J_1, has the time constant

.. math:: \tau = \frac{8}{x_1^2} \, \varphi R_c C_c

The difference in the formula is therefore filtered by a lag of τ. While heat flows outward the hottest point is the
centre; if the surface is warmer than the roll, it is the surface.

Notes
-----
R_c is that of the model's heat balance: from the mean of the roll to the measured surface. A resistance that was
measured from the centre to the surface, as by a thermocouple in the axis, equals it times 1 + φ. Compared with the fine
cylinder (`tests/thermal/test_centre.py`), through steps of the load, pulses, cooling and jumps of the coolant by 20 K,
the error of the formula with the right φ is 2 % of the largest T_c - T_s up to φ = 0.5, 6 % at 0.75 and 12 % at 0.95,
where faster modes matter too. Without the lag, the error is a third of it after such a jump.
"""

from math import inf

import numpy as np

from bms_gateway.thermal.parameters import Floats, Share, StringModel

CENTRE_SHARE = Share(0.5, 0.25)
"""φ if unknown: every possible value is within two sd. For a 32113 with R_c fitted to its measured core, R_c is twice
the 1/(8πkL) of its roll, which gives 0.5."""
CORE_PROBE = Share(0.0, 0.3)
"""Position of a thermocouple "in the core" from the mean (0) to the centre (1), if the model does not state it. Such a
thermocouple is pushed into the mandrel's hole or beside it, touches more than the axis, and its wires conduct heat
away. On three cells of two formats 0.3 ± 0.3 fitted best. With 0, a calibrated core would be the thermocouple's
reading; it would be colder than the true mean by no more than its band."""
FIRST_MODE = 8.0 / 3.8317059702075125**2
"""8/x_1², x_1 the first zero of the Bessel function J_1 (Abramowitz and Stegun, table 9.5)."""
INSTANT_S = 1e-6
RADIAL = "radial_gradient"
SURE_K = 3.0
"""Largest sd of a core that is compared with others by its value alone, K."""


def centre_share(model: StringModel) -> Share:
    """Return φ of a model: from its file, else from its effect of the roll, else the default."""
    if model.centre_share is not None:
        return model.centre_share
    found = next((e for e in model.effects if e.name == RADIAL and "phi" in e.values), None)
    return CENTRE_SHARE if found is None else Share(found.values["phi"], found.sd.get("phi", 0.0))


def core_probe(model: StringModel) -> Share:
    """Return the position of a thermocouple in the core, from the mean (0) to the centre (1)."""
    return CORE_PROBE if model.core_probe is None else model.core_probe


def probe_lever(model: StringModel) -> Share:
    r"""Return the share of T_c - T_s by which a thermocouple in the core reads above the mean of the roll: p φ.

    Its variance is that of a product of two independent numbers,
    :math:`p^2 \sigma_\varphi^2 + \varphi^2 \sigma_p^2 + \sigma_p^2 \sigma_\varphi^2`.
    """
    p, phi = core_probe(model), centre_share(model)
    variance = (p.value * phi.sd) ** 2 + (phi.value * p.sd) ** 2 + (p.sd * phi.sd) ** 2
    return Share(p.value * phi.value, float(np.sqrt(variance)))


def time_constant(phi: Floats | float, R_c: Floats, C_c: Floats) -> Floats:
    """Time constant, s, with which the profile of a roll follows the difference between its mean and its surface."""
    return np.asarray(FIRST_MODE * phi * R_c * C_c, dtype=np.float64)


def followed(elapsed_s: Floats | float, time_constant_s: Floats) -> Floats:
    """Share of a change that a profile has followed after a time, 0 to 1; 1 if the time constant is zero."""
    return np.asarray(-np.expm1(-elapsed_s / np.maximum(time_constant_s, INSTANT_S)), dtype=np.float64)


def lagged(gap: Floats, elapsed_s: Floats, time_constant_s: Floats) -> Floats:
    """Filter differences (K, n) between mean and surface by the lag of the profile.

    Parameters
    ----------
    gap : ndarray (K, n), K
        Steady before the first instant.
    elapsed_s : ndarray (K,), s
        Since the instant before; the first value is not used.
    time_constant_s : ndarray (n,), s

    Returns
    -------
    ndarray (K, n)
    """
    steps, which = np.unique(elapsed_s, return_inverse=True)
    share = followed(steps[:, None], time_constant_s)[which]
    out, now = np.empty_like(gap), gap[0]
    for i in range(len(gap)):
        now = out[i] = now + share[i] * (gap[i] - now)
    return out


def hottest_point(core: Floats, surface: Floats, lag: Floats, phi: Floats | float) -> Floats:
    """Temperature of the hottest point, °C: never below core or surface, NaN where either is.

    Parameters
    ----------
    core, surface : ndarray, °C
        Mean of the roll, casing.
    lag : ndarray, K
        Their difference after the lag of the profile; in the steady state the difference itself.
    phi : float or ndarray
        Share of R_c within the roll.

    Examples
    --------
    >>> core, surface = np.array([40.0, 20.0]), np.array([30.0, 25.0])
    >>> hottest_point(core, surface, core - surface, 0.5)
    array([45., 25.])
    """
    return np.maximum(np.maximum(lag, 0.0) * phi + core, surface)


def hottest(
    core: Floats, surface: Floats, lag: Floats, phi: Floats | float, centre_sd: Floats, surface_sd: Floats
) -> tuple[Floats, Floats]:
    r"""Temperature of the hottest point, °C, and its standard deviation, K.

    The sd is that of the centre if the core is warmer than the surface. If the surface is warmer, it is :math:`\sigma^2
    = \sigma_s^2 + (\sigma_{centre}^2 - \sigma_s^2) e^{-\alpha^2/2}`, with α the distance of the centre below the
    surface in standard deviations. This is above the second moment of the centre's possible excess over the surface,
    and equals the centre's sd if both temperatures are equal.

    Parameters
    ----------
    As for `hottest_point`.
        As `hottest_point` takes them.
    centre_sd : ndarray, K
        Of core + φ lag.
    surface_sd : ndarray, K
    """
    point = hottest_point(core, surface, lag, phi)
    outside = core < surface
    if not outside.any():
        return point, centre_sd
    below = np.minimum(core + phi * np.maximum(lag, 0.0) - surface, 0.0)
    of_centre, of_surface = np.square(centre_sd), np.square(surface_sd)
    share = np.exp(-np.square(below) / np.maximum(of_centre + of_surface, 1e-12) / 2.0)
    return point, np.where(outside, np.sqrt(share * of_centre + (1.0 - share) * of_surface), centre_sd)


def compared(points: Floats | float, core_sd: Floats | float) -> Floats:
    """Temperatures (n,) for the comparison of cells: their points, minus the sd of the core if it exceeds `SURE_K`.

    An uncertain guess is then not the hottest cell, but a burning cell is, even with an uncertain core.
    """
    return np.where(np.greater(core_sd, SURE_K), np.subtract(points, core_sd), points)


def hottest_of(points: Floats, core_sd: Floats | float = 0.0) -> int | None:
    """Cell (from 0) with the hottest of points (n,), the first of equal ones; NaN is skipped, None if all are NaN.

    Parameters
    ----------
    points : ndarray (n,), °C
        Cores, or hottest points.
    core_sd : ndarray (n,), K
        Of the cores, for `compared`.

    Examples
    --------
    >>> hottest_of(np.array([np.nan, 31.0, 32.5])), hottest_of(np.array([np.nan]))
    (2, None)
    >>> hottest_of(np.array([31.0, 40.0]), np.array([0.5, 10.0]))
    0
    """
    ranks = compared(points, core_sd)
    least = np.where(np.isnan(ranks), -inf, ranks)
    k = int(least.argmax())
    return None if least[k] == -inf else k
