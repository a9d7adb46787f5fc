r"""R_e at the temperature of its core in strings without effects: Arrhenius' law.

.. math::
    R_e \to R_e \exp(B \, (u - u_0)), \qquad u = 1000 \left(\frac{1}{T_c} - \frac{1}{298.15\,\mathrm{K}}\right)

with B in thousands of kelvin, which makes it of the same order as the logarithms of a string's other numbers. u_0 is
the warmth at which R_e is known: 0, that of 25 °C, for the number of a file, and later that at which it was identified.
B is 0 at first, with a standard deviation, and then what the windows find (`identify.carried`).

Beyond Lin et al., Eq 1, whose R_e is constant.
"""

from typing import Final

import numpy as np

from bms_gateway.thermal.entropy import KELVIN
from bms_gateway.thermal.parameters import Floats

WARMTH: Final = "warmth"
"""B as a number of a string, 1000 K."""
WARMTH_SD: Final = 1.5
"""Of B, 1000 K: that of the effect `resistance_temperature`, which a service without effects does not load, but about
0, because a file without the effect says that R_e is constant."""
LEAST_B: Final = -1.0
MOST_B: Final = 8.0
"""1000 K: limits of B in a fit, those of the effect. With a smaller B, cores that warm would run away."""
REFERENCE: Final = 298.15
"""K: reference of temperature-dependent numbers."""
COLDEST: Final = 100.0
"""K: lower limit for a trial of a fit; no cell is colder."""


def inverse(T: Floats) -> Floats:
    """1/T − 1/298.15 K of temperatures in °C, 1/K.

    Examples
    --------
    >>> round(float(inverse(np.array(45.0))), 6)
    -0.000211
    """
    return np.asarray(1.0 / np.maximum(T + KELVIN, COLDEST) - 1.0 / REFERENCE, dtype=np.float64)


def warmth(core: Floats) -> Floats:
    """Return u of cores at `core` (…), °C.

    Examples
    --------
    >>> warmth(np.array([25.0, 45.0])).round(3).tolist()
    [0.0, -0.211]
    """
    return np.asarray(1000.0 * inverse(core), dtype=np.float64)


def resistance_factor(B: float | Floats, core: Floats, u_0: float | Floats = 0.0) -> Floats:
    """R_e of cores at `core` (…), °C, over R_e at the warmth u_0; B in 1000 K.

    Examples
    --------
    >>> resistance_factor(2.5, np.array([25.0, 45.0])).round(3).tolist()
    [1.0, 0.59]
    """
    return np.asarray(np.exp(B * (warmth(core) - u_0)), dtype=np.float64)
