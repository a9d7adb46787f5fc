"""Growth of single cells, where their voltages or a commissioning run tell them apart.

What is common to the cells is followed window by window (`trend`); a fit of single cells tells how each departs from
the others. Temperature, charge and the current's scale are common to all and drop out of the departures.
"""

from collections.abc import Mapping, Sequence
from math import exp, sqrt
from typing import Any

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.health.ageing import Ageing
from bms_gateway.thermal import Floats

WALK = 0.003  # ln, from fit to fit: a cell leaves the others by a per cent in ten drives at most
FLOOR = 0.02  # ln: what a fit errs beyond its own sd
BASE_FITS = 3  # that make the baseline where no commissioning run has


class CellGrowth:
    """Departures of n cells from their mean, now against commissioning.

    Parameters
    ----------
    base : ndarray (n,), optional
        ln R_e of each cell over their mean as commissioned; the first fits make it where there is none.

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
        """Judge every cell, with what is common to them.

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
        """Make a new baseline of one cell (0-based) from the next fits: it was replaced."""
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
            It is of another string, or not finite.
        """
        n = len(self.ageing)
        arrays = [np.array(state[key], dtype=np.float64) for key in ("base", "base_var", "now", "var", "known")]
        if any(a.shape != (n,) or not np.isfinite(a).all() for a in arrays) or len(state["ageing"]) != n:
            raise StateError("health of the cells: the stored state is damaged or of another string; starting anew")
        self._base, self._base_var, self._now, self._var = arrays[:4]
        self._known = arrays[4].astype(np.int64)
        for ageing, stored in zip(self.ageing, state["ageing"], strict=True):
            ageing.restore(stored)
