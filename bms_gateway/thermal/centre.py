r"""Two temperatures of one jelly roll: its mean, which the heat balances use, and its hottest point.

A roll of length L and conductivity k that is heated uniformly by q has, in the steady state (H. S. Carslaw and J. C.
Jaeger, *Conduction of Heat in Solids*, 2nd ed., section 7.2, for the parabola that follows),

.. math::
    T_{centre} - T_{edge} = \frac{q}{4 \pi k L}, \qquad T_{mean} - T_{edge} = \frac{q}{8 \pi k L}

whatever its radius: the centre is as far above the mean as the mean is above the edge. Of the resistance R_c between
mean and surface a share φ lies within the roll, the rest is contact between roll and casing, so that

.. math:: T_{centre} = T_c + \varphi \, (T_c - T_s)

φ is between 0 (all of R_c is contact) and 1 (all of it is spread over the roll). A profile takes its time to follow:
its slowest mode, that of the first zero x_1 of J_1, has the time constant

.. math:: \tau = \frac{8}{x_1^2} \, \varphi R_c C_c

and so the difference in the formula is the one that goes through a lag of τ. While heat flows outward the hottest point
is the centre; where the surface is warmer than the roll, it is the surface.

Notes
-----
R_c is the model's own, from the mean of the roll to the measured surface, as its heat balance has it. Where a number
was taken from the centre to the surface, as by a thermocouple in the axis, it is that of this model times 1 + φ.
Against the fine cylinder (`tests/thermal/test_centre.py`), through steps of the load, pulses, cooling and jumps of the
coolant by 20 K, the formula with its own φ is within 2 % of the largest T_c - T_s up to φ = 0.5, within 6 % at 0.75 and
12 % at 0.95, where the quicker modes are felt too. Without the lag it is off by a third of it after such a jump.
"""

from math import inf

import numpy as np

from bms_gateway.thermal.parameters import Floats, Share, StringModel

CENTRE_SHARE = Share(0.5, 0.25)
"""φ where it is unknown: every possible value is within two sd. For a 32113 whose R_c was fitted to its measured core,
R_c is twice the 1/(8πkL) of its roll, which gives 0.5."""
CORE_PROBE = Share(0.0, 0.3)
"""Position of a thermocouple "in the core" where the model does not state it, from the mean (0) to the centre (1). Such
a thermocouple is pushed into the mandrel's hole or beside it, touches more than the axis, and its wires conduct heat
away. On three cells of two formats 0.3 ± 0.3 fitted best. With 0, a calibrated core would be the thermocouple's
reading; it would be colder than the true mean by no more than its band."""
FIRST_MODE = 8.0 / 3.8317059702075125**2
"""8/x_1², x_1 the first zero of the Bessel function J_1 (Abramowitz and Stegun, table 9.5)."""
INSTANT_S = 1e-6
RADIAL = "radial_gradient"
SURE_K = 3.0
"""Largest sd of a core that is compared with others by its value alone, K."""


def centre_share(model: StringModel) -> Share:
    """Tell φ of a model: what its file says, else what its effect of the roll has found, else the default."""
    if model.centre_share is not None:
        return model.centre_share
    found = next((e for e in model.effects if e.name == RADIAL and "phi" in e.values), None)
    return CENTRE_SHARE if found is None else Share(found.values["phi"], found.sd.get("phi", 0.0))


def core_probe(model: StringModel) -> Share:
    """Tell the position of a thermocouple in the core, from the mean (0) to the centre (1)."""
    return CORE_PROBE if model.core_probe is None else model.core_probe


def probe_lever(model: StringModel) -> Share:
    r"""Tell by which share of T_c - T_s a thermocouple in the core reads above the mean of the roll: p φ.

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
    """Tell which share of a change a profile has followed after a time, 0 to 1; 1 where the time constant is zero."""
    return np.asarray(-np.expm1(-elapsed_s / np.maximum(time_constant_s, INSTANT_S)), dtype=np.float64)


def lagged(gap: Floats, elapsed_s: Floats, time_constant_s: Floats) -> Floats:
    """Filter differences (K, n) between mean and surface by the lag of the profile.

    Parameters
    ----------
    gap : ndarray (K, n), K
        Steady before the first instant.
    elapsed_s : ndarray (K,), s
        Since the instant before; that of the first does not count.
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

    The latter is that of the centre, but where the surface is warmer than the core. There
    :math:`\sigma^2 = \sigma_s^2 + (\sigma_{centre}^2 - \sigma_s^2) e^{-\alpha^2/2}`, with α by how many standard
    deviations the centre is below the surface: more than the second moment of what the centre may be above it by all
    the same, and the centre's own where both are alike.

    Parameters
    ----------
    core, surface, lag, phi
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
    """Temperatures (n,) by which cells are compared: their points, less the sd of the core where it exceeds `SURE_K`.

    No vague guess is the hottest cell then, but a cell that burns is, however vague its core.
    """
    return np.where(np.greater(core_sd, SURE_K), np.subtract(points, core_sd), points)


def hottest_of(points: Floats, core_sd: Floats | float = 0.0) -> int | None:
    """Cell (from 0) with the hottest of points (n,), the first of equal ones; NaN is none, None where all are.

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
