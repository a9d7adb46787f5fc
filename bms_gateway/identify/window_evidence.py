r"""Evidence of the windows so far on the parameters common to the cells and on the differences of single cells.

Cells differ by the model's tolerances. A fit with equal cells would apply the two sensed cells to all twelve: it would
state half a per cent where one of them is off by two, with the same error in every window. So each window's evidence is
kept over (z, u) together: z are the lumped coordinates of the string's mean, u the differences of R_e, R_u and R_c of
each cell from that mean, with

.. math::
    \ln R_{k} = \ln \bar R + \sigma (u_k - \bar u), \qquad u \sim N(0, 1)

The u are constant from window to window and are integrated out only when the mean is computed.

For Lin et al., Eq 9, carried from window to window; not in the paper.
"""

from dataclasses import dataclass, replace

import numpy as np

from bms_gateway.thermal import Floats, StringModel, StringParameters
from bms_gateway.thermal.entropy import ENTROPIC_SD, ENTROPIC_SLOPE_SD

UNLIKE = ("R_e", "R_u", "R_c")
"""Parameters that differ from cell to cell."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """Information of all data so far on δ = (z − z0, u), without priors: ½ δᵀ info δ + gradᵀ δ.

    Attributes
    ----------
    z0 : ndarray (p,)
    info : ndarray (p + c, p + c)
    grad : ndarray (p + c,)
        u are the differences of single cells from the string's mean (`departures`), in sd.
    warmth : float
        At which the R_e in z is that of the cores (`thermal.warmth`).

    References
    ----------
    Not in the paper; in the coordinates of Lin et al., Eq 8.
    """

    z0: Floats
    info: Floats
    grad: Floats
    warmth: float = 0.0

    @classmethod
    def none(cls, p: int, c: int = 0) -> "Evidence":
        """Create evidence without data."""
        return cls(np.zeros(p), np.zeros((p + c, p + c)), np.zeros(p + c))

    def at_charge(self, moved: float, places: tuple[int, int]) -> "Evidence":
        """State the level of the entropic coefficient after a charge has moved.

        Parameters
        ----------
        moved : float
            Charge over the capacity.
        places : (int, int)
            Of the level's and the slope's coefficients in δ.
        """
        level, slope = places
        turn = np.eye(len(self.grad))
        turn[level, slope] = -moved * ENTROPIC_SLOPE_SD / ENTROPIC_SD
        return replace(self, info=turn.T @ self.info @ turn, grad=turn.T @ self.grad)

    def forget(self, directions: Floats, sd: Floats) -> "Evidence":
        """Marginalise a random step of `sd` (r,) along `directions` (p + c, r): exact, also where info is singular."""
        along = self.info @ directions
        gain = np.linalg.solve(np.diag(1.0 / sd**2) + directions.T @ along, along.T)
        info = self.info - along @ gain
        return replace(self, info=0.5 * (info + info.T), grad=self.grad - gain.T @ (directions.T @ self.grad))


def departures(model: StringModel) -> int:
    """Count the differences of single cells (c); a single cell equals its mean and has none."""
    return len(UNLIKE) * model.cells if model.cells > 1 else 0


def unlike(p: StringParameters, step: float) -> list[StringParameters]:
    """Strings with one logarithm of one cell increased by `step`: for all cells `UNLIKE[0]`, then the next symbol."""
    factors = np.exp(step * np.eye(p.cells))
    return [replace(p, **{s: getattr(p, s) * factor}) for s in UNLIKE for factor in factors]
