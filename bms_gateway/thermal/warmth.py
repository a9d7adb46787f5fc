r"""R_e at the temperature of its core, before anything is known of how it changes: Arrhenius' law.

.. math::
    R_e \to R_e \exp(B \, (u - u_0)), \qquad u = 1000 \left(\frac{1}{T_c} - \frac{1}{298.15\,\mathrm{K}}\right)

with B in thousands of kelvin, which makes it of the same order as the logarithms of a string's other numbers. u_0 is
the warmth at which R_e is known: 0, that of 25 °C, for the number of a file, and later that at which it was identified.

Beyond Lin et al., Eq 1, whose R_e is constant.
"""

from typing import Final

import numpy as np

from bms_gateway.thermal.effects.laws import inverse
from bms_gateway.thermal.effects.resistance_temperature import ResistanceTemperature
from bms_gateway.thermal.parameters import Floats

WARMTH: Final = "warmth"
"""B as a number of a string, 1000 K."""
_SCALE = 1000.0
WARMTH_SD: Final = ResistanceTemperature.parameters[0].sd / _SCALE
"""Of B, 1000 K: the sd of the effect, but about 0, because a file without the effect says that R_e is constant."""


def warmth(core: Floats) -> Floats:
    """Return u of cores at `core` (…), °C.

    Examples
    --------
    >>> warmth(np.array([25.0, 45.0])).round(3).tolist()
    [0.0, -0.211]
    """
    return np.asarray(_SCALE * inverse(core), dtype=np.float64)
