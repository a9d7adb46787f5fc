"""Statistics over known values: NaN is unknown."""

import numpy as np

from bms_gateway.thermal import Floats


def correlation(a: Floats, b: Floats) -> float:
    """Correlation of two series where both are known; 0 if one of them is constant or too short."""
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < 5 or np.std(a) == 0.0 or np.std(b) == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def mean_of_known(y: Floats) -> Floats:
    """Mean of each column over its known values; NaN without any."""
    known = np.isfinite(y)
    count = known.sum(axis=0)
    return np.asarray(np.where(known, y, 0.0).sum(axis=0) / np.where(count > 0, count, np.nan))


def median_of_known(y: Floats) -> Floats:
    """Median of each column over its known values; NaN without any."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in y.T])
