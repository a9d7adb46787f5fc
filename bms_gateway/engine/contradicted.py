"""Cells whose core is not known because their own thermocouple has left what the model explains.

The observer widens the band of such a core at once, until it is not sent any more (`innovation_check`). The watch over
heat names the cause where it can: not in the first minutes after a start or a silence of the bus, and not where
several causes explain the readings alike. This rule speaks for the cells that remain.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

TOLD_S: Final = 180.0
"""Time for which such a core is unknown before it is told: the watch over heat names most causes within a minute, and
in normal life at its hardest a load that changes suddenly makes a core unknown for less than two."""


@dataclass(slots=True)
class Contradicted:
    """Follows S strings of n cells.

    Attributes
    ----------
    unknown_s : ndarray (S, n), s
        Time for which the core has not been known, although readings of its thermocouple are used.
    odd : ndarray of bool (S, n)
        Whether these readings have contradicted the model in that time.
    """

    unknown_s: Floats
    odd: NDArray[np.bool_]

    @classmethod
    def of(cls, strings: int, cells: int) -> "Contradicted":
        """Begin with cores that are known."""
        return cls(np.zeros((strings, cells)), np.zeros((strings, cells), np.bool_))

    def take(self, unknown: NDArray[np.bool_], own: Floats, dt: float) -> NDArray[np.bool_]:
        """Include a tick of `dt` seconds and return which cells (S, n) have been contradicted for `TOLD_S`.

        Parameters
        ----------
        unknown : ndarray of bool (S, n)
            Cells whose thermocouple is used and whose core is not known.
        own : ndarray (S, n), K/s
            `Surprise.own`, by cell; NaN for cells without a sensor.
        """
        self.unknown_s = np.where(unknown, self.unknown_s + dt, 0.0)
        self.odd = unknown & (self.odd | (own > 0.0))
        return np.asarray(self.odd & (self.unknown_s >= TOLD_S), np.bool_)
