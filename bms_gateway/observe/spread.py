"""What is uncertain beside the filter: how unlike cells are, and the root of a covariance.

Beyond Lin et al., whose observer holds its parameters for exact.
"""

import numpy as np

from bms_gateway.thermal import Floats, StringModel


def scatter(model: StringModel) -> Floats:
    """Square what cells differ in R_e, R_u and R_c, and of the thermocouples' offset; one cell is its own mean."""
    keys = ("cell_R_e", "cell_R_u", "cell_R_c", "surface_offset_K")
    sd = np.array([model.tolerances.get(k, 0.0) for k in keys])
    if model.cells == 1:
        sd[:3] = 0.0
    return np.asarray(np.square(sd), dtype=np.float64)


def root(covariance: Floats) -> Floats:
    """Find F with F Fᵀ = covariance; by eigenvalues, because fixed parameters make it singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)
