"""Arrays as JSON-able values and back, exact to the last bit."""

from typing import Any

import numpy as np

FARTHEST = 1e12
"""Above all numbers of a state, their squares and sums of such squares: these reach 2e7 after hours of driving."""


def plain(a: np.ndarray) -> Any:
    """Convert to lists of numbers; None for what is not finite."""
    if a.dtype.kind == "f" and not np.isfinite(a).all():
        blank = a.astype(object)
        blank[~np.isfinite(a)] = None
        return blank.tolist()
    return a.tolist()


def like(value: Any, model: np.ndarray) -> np.ndarray:
    """Make an array of the type and shape of `model`; None becomes NaN.

    Raises
    ------
    ValueError
        The numbers have another shape, or are larger than those of any vehicle.
    TypeError
        The values are not numbers.
    """
    a = np.array(value, dtype=np.float64 if model.dtype.kind == "f" else model.dtype)
    if a.shape == (0,) and not model.size:  # lists without a number do not show their depth
        a = a.reshape(model.shape)
    if a.shape != model.shape:
        raise ValueError(f"shape {a.shape} where {model.shape} is needed")
    if a.dtype.kind == "f" and (np.abs(a) > FARTHEST).any():
        raise ValueError(f"holds {np.nanmax(np.abs(a)):g}")
    return a
