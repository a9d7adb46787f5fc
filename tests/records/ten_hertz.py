"""What the tests of currents that are read ten times a second share."""

import numpy as np

CAPACITY_AH = 30.0


def means(x: np.ndarray) -> np.ndarray:
    """Means of each second."""
    return x.reshape(-1, 10).mean(axis=1)
