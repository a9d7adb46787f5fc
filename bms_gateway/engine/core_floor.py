r"""A physical lower limit of core temperatures, from the cell's surface, coolant, neighbours and start.

Losses warm a core; otherwise the core follows its surroundings. So it stays above the coldest of these:

.. math::
    T_c \ge \min(T_{s,j}, T_f, \mathrm{start}) - R_c \max(0, u_r |I| - I^2 R_e) - \epsilon

with the second term for reversible heat, which cools at one sign of the current: :math:`u_r = T \, dU/dT` is at most
0.15 V for lithium-ion cells (0.5 mV/K at 300 K). Earlier cold temperatures count too, until a cell has forgotten them
after `FOLLOWS_S`. After the first start of a string, its cores may be colder than everything that has been measured. An
estimate below the limit is an error of the model, of a sensor or of the state, and is not sent as good.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats, StringModel

REVERSIBLE_V: Final = 0.15
MARGIN_K: Final = 0.5
FOLLOWS_S: Final = 3600.0
"""Several slow time constants of a cell: after this time an earlier cold has no influence on a core."""


class Step(NamedTuple):
    """Estimates of one step of S strings of n cells, and their inputs.

    Attributes
    ----------
    core, core_sd, surface : ndarray (S, n), °C, K, °C
        NaN where not available.
    inlet : ndarray (S,), °C
        NaN if unknown; the other temperatures then decide.
    current, square : ndarray (S,), A, A²
        Means of I and I² over the step; NaN if unknown: no core is then found too cold.
    dt : float, s
    """

    core: Floats
    core_sd: Floats
    surface: Floats
    inlet: Floats
    current: Floats
    square: Floats
    dt: float


@dataclass(slots=True)
class Floor:
    """Follows the lowest temperature (S,), °C, that the cores of S strings of n cells can physically have.

    Attributes
    ----------
    R_c, R_e : ndarray (S, 1), K/W, Ω
        Largest R_c and smallest R_e within one sd of the model file.
    """

    R_c: Floats
    R_e: Floats
    _coldest: Floats = field(default_factory=lambda: np.empty(0))
    _cooled: Floats = field(default_factory=lambda: np.empty(0))

    @classmethod
    def of(cls, models: Sequence[StringModel]) -> "Floor":
        """Take the limits of the resistances from the models' priors."""
        prior = [(m.priors["R_c"], m.priors["R_e"]) for m in models]
        R_c = [float(np.max(c.value)) * (1.0 + c.rel_sd) for c, _ in prior]
        R_e = [float(np.min(e.value)) / (1.0 + e.rel_sd) for _, e in prior]
        return cls(np.array(R_c)[:, None], np.array(R_e)[:, None])

    def forget(self) -> None:
        """Start again, as after a gap."""
        self._coldest = np.empty(0)

    def below(self, step: Step) -> NDArray[np.bool_] | None:
        """Take in one step and return which cores are colder than physically possible.

        Returns
        -------
        ndarray of bool (S, n) or None
            None if no core is too cold, as nearly always.
        """
        core, core_sd, surface, inlet, current, square, dt = step
        now = np.fmin(np.fmin.reduce(surface, axis=1), inlet)
        cooled = np.maximum(0.0, REVERSIBLE_V * np.abs(current)[:, None] - square[:, None] * self.R_e)
        if not len(self._coldest):
            self._coldest, self._cooled = np.fmin(now, np.fmin.reduce(core - 2.0 * core_sd, axis=1)), cooled
        share = min(1.0, dt / FOLLOWS_S)
        self._coldest = np.fmin(self._coldest + (now - self._coldest) * share, now)
        self._cooled = np.fmax(self._cooled * (1.0 - share), cooled)
        found = core < self._coldest[:, None] - MARGIN_K - self.R_c * self._cooled
        if not found.any():
            return None
        found &= np.isfinite(current)[:, None]
        return found if found.any() else None
