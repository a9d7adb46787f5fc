"""The jelly roll as a cylinder instead of one node: heat needs time from the axis to the casing."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

ZEROS = np.array(
    [
        3.8317059702075125,
        7.015586669815619,
        10.173468135062722,
        13.323691936314223,
        16.470630050877634,
        19.615858510468243,
        22.760084380592772,
        25.903672087618382,
        29.046828534916855,
    ]
)
"""Zeros of the Bessel function J₁: decay rates of an uneven heat in a cylinder (Abramowitz and Stegun, table 9.5)."""
GROUPS = np.array([0, 1, 2, 3, 5])
"""First mode of each state: three single modes, then two together, then four; faster modes are a resistance without
memory. With five single modes the error against the fine cylinder was four times larger."""
_EACH = 8.0 / ZEROS**2
SHARE = np.add.reduceat(_EACH, GROUPS)
"""Share of each state in the mean-to-edge resistance of a uniformly heated cylinder; of all modes it is 1."""
PACE = np.add.reduceat(_EACH**2, GROUPS) / SHARE
"""Time constant of each state in units of φ R_c C_c: the mean of its modes', weighted by their shares."""
MODES = len(GROUPS)
QUICKEST = 2.0
"""s: faster modes get this time constant and less weight, so that they delay heat as before; otherwise a small share of
R_c would make the balances stiff."""


class RadialGradient(Effect):
    r"""A share φ of R_c lies within the jelly roll, a solid cylinder that is heated uniformly.

    f is the flux into the casing, T_c the mean over the volume, and m_i the difference at the edge of the i-th group
    g_i of modes of a cylinder with an insulated edge (x_j: zeros of J_1):

    .. math::
        f &= \frac{T_c + \sum_i \theta_i m_i - T_s}{R_c (1 - \varphi \sum_i \theta_i s_i)}, \qquad
        s_i = \sum_{j \in g_i} 8/x_j^2 \\
        \tau_i \dot m_i &= -m_i - \varphi R_c s_i f, \qquad
        \theta_i \tau_i = \varphi R_c C_c \frac{1}{s_i} \sum_{j \in g_i} (8/x_j^2)^2

    where θ_i is 1 except for modes that are too fast.

    Notes
    -----
    The states are modes of the cylinder, not rings: they are uncoupled, and nine modes in five states are as near to
    the fine solution as nine states would be. In the steady state T_c − T_s = R_c q for every φ; with φ = 0 this is the
    two-node model.
    """

    name = "radial_gradient"
    title = "temperature gradient within the jelly roll"
    equation = "a share phi of R_c is spread over the jelly roll (uniformly heated cylinder, 9 radial modes)"
    signature = "the model's surface answers a step too slowly in the first seconds and too quickly later"
    needs = "current steps and rests, sampled at 1 Hz"
    node = "core"
    plausibility = -1.5
    confused_with = ("surface_joule", "thermocouple_lag", "polarization")
    one_sided = True
    states = MODES
    parameters = (EffectParameter("phi", "share of R_c within the roll", "1", 1.0, 0.0, 0.6, 0.0, 1.0, probe=0.3),)

    def rest(self, T_c: Floats, T_s: Floats, p: Values) -> Floats:
        """Return the profile of steady heating with this difference."""
        return -p["phi"] * SHARE * np.asarray(T_c - T_s)[..., None]

    def flux(self, z: Point, p: Values, at: Floats) -> None:
        """Let the edge of the roll, and not its mean, drive the casing."""
        m, rates = z.extra[z.key], np.empty_like(z.extra[z.key])
        spread = p["phi"] * z.R_c
        true = (spread * z.C_c)[..., None] * PACE
        tau = (true**4 + QUICKEST**4) ** 0.25
        felt = true / tau
        edge = np.einsum("...i,...i->...", felt, m)  # as a sum over the last axis, which is slow because it is short
        z.inner = (z.T_c + edge - z.T_s) / (z.R_c - spread * np.einsum("...i,i->...", felt, SHARE))
        for i, share in enumerate(SHARE):
            rates[..., i] = -(m[..., i] + spread * share * z.inner) / tau[..., i]
        z.extra_rates[z.key] = rates
