"""The jelly roll is no single node: heat takes its time from the axis to the casing."""

import numpy as np

from bms_gateway.thermal.effects.base import Effect, EffectParameter, Values
from bms_gateway.thermal.parameters import Floats
from bms_gateway.thermal.point import Point

MODES = 5
ZEROS = np.array([3.8317059702075125, 7.015586669815619, 10.173468135062722, 13.323691936314223, 16.470630050877634])
"""Of the Bessel function J₁: decay rates of heat spread unevenly over a cylinder (Abramowitz and Stegun, table 9.5)."""
SHARE = 8.0 / ZEROS[:MODES] ** 2
"""Share of each mode in the mean-to-edge resistance of a uniformly heated cylinder. All that there are
sum to 1: what is left to the faster ones is a resistance without memory."""
QUICKEST = 2.0
"""s: modes faster than this are slowed to it, else a small share of R_c would make the balances stiff."""


class RadialGradient(Effect):
    r"""A share φ of R_c lies within the jelly roll, a solid cylinder that is heated uniformly.

    With f the flux into the casing, T_c the mean over the volume and m_i the departure at the edge that belongs to the
    i-th mode of a cylinder with an insulated edge (x_i: zeros of J_1)

    .. math::
        f &= \frac{T_c + \sum_i m_i - T_s}{R_c (1 - \varphi \sum_i s_i)}, \qquad s_i = 8/x_i^2 \\
        \tau_i \dot m_i &= -m_i - \varphi R_c s_i f, \qquad \tau_i = \varphi R_c C_c s_i

    Notes
    -----
    The modes of the cylinder itself, not rings: they are uncoupled, and five are as near to the fine solution as eight
    rings of equal volume. In the steady state T_c − T_s = R_c q for every φ; at φ = 0 this is the two-node model.
    """

    name = "radial_gradient"
    title = "temperature gradient within the jelly roll"
    equation = "a share phi of R_c is spread over the jelly roll (uniformly heated cylinder, 5 radial modes)"
    signature = "the model's surface answers a step too slowly in the first seconds and too quickly later"
    needs = "current steps and rests, sampled at 1 Hz"
    node = "core"
    plausibility = -1.5
    confused_with = ("surface_joule", "thermocouple_lag", "polarization")
    one_sided = True
    states = MODES
    parameters = (EffectParameter("phi", "share of R_c within the roll", "1", 1.0, 0.0, 0.6, 0.0, 1.0, probe=0.3),)

    def rest(self, T_c: Floats, T_s: Floats, p: Values) -> Floats:
        """Give the profile of a steady heating that holds this difference."""
        return -p["phi"] * SHARE * np.asarray(T_c - T_s)[..., None]

    def flux(self, z: Point, p: Values, at: Floats) -> None:
        """Let the edge of the roll, not its mean, drive the casing."""
        phi, m, rates = p["phi"], z.extra[z.key], np.empty_like(z.extra[z.key])
        edge = np.einsum("...i->...", m)  # as sum(axis=-1), which is slow over so few
        z.inner = (z.T_c + edge - z.T_s) / (z.R_c * (1.0 - phi * SHARE.sum()))
        for i, share in enumerate(SHARE):
            spread = phi * share * z.R_c
            tau = ((spread * z.C_c) ** 4 + QUICKEST**4) ** 0.25
            rates[..., i] = -(m[..., i] + spread * z.inner) / tau
        z.extra_rates[z.key] = rates
