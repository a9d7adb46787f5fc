"""Growth of R_e of single cells, where cell voltages or a commissioning run show how the cells differ.

`trend` follows the part of R_e that is common to all cells, window by window. A fit of single cells gives the
difference of each cell from the mean. Temperature, charge and the current's scale act on all cells alike and therefore
do not change these differences.
"""

from collections.abc import Mapping, Sequence
from math import exp, sqrt
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.health.ageing import Ageing
from bms_gateway.thermal import Floats

WALK = 0.003  # ln, random step between two fits: a cell departs from the others by at most 1 % in ten drives
FLOOR = 0.02  # ln: error of a fit beyond its own sd
BASE_FITS = 3  # number of fits whose mean is the baseline, where there was no commissioning run


class CellGrowth:
    """Differences of n cells from their mean: now, and at commissioning.

    Parameters
    ----------
    base : ndarray (n,), optional
        ln(R_e of a cell over the mean) at commissioning. Without it, the mean of the first fits is the baseline.

    Attributes
    ----------
    ageing : list of Ageing
        One per cell.
    """

    def __init__(self, cells: int, base: Floats | None = None) -> None:
        self.ageing = [Ageing() for _ in range(cells)]
        self._base = np.zeros(cells) if base is None else base.copy()
        self._base_var = np.zeros(cells)
        self._known = np.full(cells, 0 if base is None else BASE_FITS)
        self._now, self._var = self._base.copy(), np.zeros(cells)

    def fitted(self, ln_R_e: Floats, sd: Floats) -> None:
        """Take a fit's ln R_e (n,) and their sd."""
        z = ln_R_e - ln_R_e.mean()
        R = sd**2 + FLOOR**2
        fresh = self._known < BASE_FITS
        weight = 1.0 / (self._known + 1.0)
        self._base = np.where(fresh, self._base + weight * (z - self._base), self._base)
        self._base_var = np.where(fresh, R * weight, self._base_var)
        P = self._var + WALK**2
        gain = P / (P + R)
        self._now = np.where(fresh, self._base, self._now + gain * (z - self._now))
        self._var = np.where(fresh, self._base_var, (1.0 - gain) * P)
        self._known = np.minimum(self._known + 1, BASE_FITS)

    def update(self, growth: float, sd: float) -> list[int]:
        """Judge every cell by its own difference and the growth that is common to all cells.

        Returns
        -------
        list of int
            0-based cells whose level changed.
        """
        changed = []
        for k, ageing in enumerate(self.ageing):
            if self._known[k] < BASE_FITS:
                continue
            own = exp(float(self._now[k] - self._base[k]))
            total = (1.0 + growth) * own - 1.0
            if ageing.update(total, own * sqrt(sd**2 + float(self._var[k] + self._base_var[k]))):
                changed.append(k)
        return changed

    def reset(self, cell: int) -> None:
        """Find a new baseline of one cell (0-based) from the next fits: the cell was replaced."""
        self._known[cell], self._base[cell], self._now[cell] = 0, 0.0, 0.0
        self._base_var[cell] = self._var[cell] = 0.0
        self.ageing[cell] = Ageing()

    def snapshot(self) -> dict[str, Any]:
        """State as plain values."""
        arrays = {"base": self._base, "base_var": self._base_var, "now": self._now, "var": self._var}
        return {
            **{key: a.tolist() for key, a in arrays.items()},
            "known": self._known.tolist(),
            "ageing": [a.snapshot() for a in self.ageing],
        }

    def restore(self, state: Mapping[str, Sequence[Any]]) -> None:
        """Take up a stored state.

        Raises
        ------
        StateError
            The state belongs to another string, or has values that are not finite.
        """
        n = len(self.ageing)
        arrays = [np.array(state[key], dtype=np.float64) for key in ("base", "base_var", "now", "var", "known")]
        if any(a.shape != (n,) or not np.isfinite(a).all() for a in arrays) or len(state["ageing"]) != n:
            raise StateError("health of the cells: the stored state is damaged or of another string; starting anew")
        self._base, self._base_var, self._now, self._var = arrays[:4]
        self._known = arrays[4].astype(np.int64)
        for ageing, stored in zip(self.ageing, state["ageing"], strict=True):
            ageing.restore(stored)
