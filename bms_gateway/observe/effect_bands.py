"""Standard deviations of the cells of a string with effects; `bands` has those of stacked strings without effects.

Beyond Lin et al., who give no bands.
"""

import numpy as np

from bms_gateway.observe.ahead import Unlike
from bms_gateway.observe.cell_scatter import of_centre, of_unlike
from bms_gateway.observe.consider import Belief
from bms_gateway.thermal import Floats, Share


def deviations(
    b: Belief, root: Floats, base: Floats, scattered: Floats, share: Share, lag: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the standard deviations of n cores, surfaces and centres, K.

    Parameters
    ----------
    b : Belief
        Its first 2n states are the temperatures, core and surface in turn.
    root : ndarray (p, p)
        Of the covariance of the uncertain numbers.
    base : ndarray (n,), °C
        Temperature over which the cells' own heat and resistances raise them.
    scattered : ndarray (4,)
        Variances by which cells differ (`cell_scatter.scatter`).
    share : Share
        φ.
    lag : ndarray (n,), K
        Difference core to surface after the delay of the profile within the roll.
    """
    N, phi = 2 * len(base), share.value
    T_c, T_s = b.z[0:N:2], b.z[1:N:2]
    spread = b.J[:N] @ root
    both = b.P[:N, :N] + spread @ spread.T
    core, surface = np.maximum(np.diag(both), 0.0).reshape(-1, 2).T
    apart = of_unlike(T_c, T_s, base, scattered)
    # a cell's own numbers act on core + φ gap as on a core of that temperature
    centre = of_centre(core, surface, np.diag(both[0::2, 1::2]), phi, share.sd)
    centre += of_unlike(T_c + phi * (T_c - T_s), T_s, base, scattered)[0::2] + (share.sd * lag) ** 2
    return np.sqrt(core + apart[0::2]), np.sqrt(surface + apart[1::2]), np.sqrt(centre)


def unlike_of(b: Belief, base: Floats, scattered: Floats, share: Share) -> Unlike:
    """Return the scatter of the cells, for a forecast; see `deviations`."""
    heat, cooling, inside, _ = (np.full((1, 1), x) for x in np.sqrt(scattered).tolist())
    N, phi = 2 * len(base), share.value
    T_c, T_s = b.z[0:N:2], b.z[1:N:2]
    apart = of_unlike(T_c, T_s, base, scattered)
    now = np.stack((apart[0::2], apart[1::2], of_unlike(T_c + phi * (T_c - T_s), T_s, base, scattered)[0::2]))
    return Unlike(
        heat, cooling, inside, np.full((1, 1), phi), np.full((1, 1), share.sd), np.zeros((1, 1)), now[:, None]
    )
