"""A posterior about a place, to second order: used for the steps, the integrals and the evidence of every fit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bms_gateway.thermal import Floats

ROUNDING = 1e-12
"""Of a precision scaled to a unit diagonal: combinations with less information are lost in rounding."""


@dataclass(frozen=True)
class Quadratic:
    """Deviance (twice the negative log posterior) at a distance δ from a place, minus that there: δᵀ H δ − 2 pullᵀ δ.

    Attributes
    ----------
    H : ndarray (Z, Z)
        Precision: half of the deviance's Hessian.
    pull : ndarray (Z,)
        Half of the deviance's downward slope.

    Examples
    --------
    Two numbers, each known as 0 ± 1; only their sum was read, as 3 ± 1:

    >>> q = Quadratic(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([3.0, 3.0]))
    >>> np.allclose(q.step, [1.0, 1.0]), round(q.promise, 9), round(q.gained(q.step), 9)
    (True, 6.0, 6.0)
    >>> one = q.marginal(np.arange(1))
    >>> np.allclose((one.H[0, 0], one.step[0]), (1.5, 1.0))
    True
    """

    H: Floats
    pull: Floats

    @cached_property
    def _scaled(self) -> tuple[Floats, Floats]:
        """Scale (Z,), and the precision (Z, Z) scaled to a unit diagonal."""
        scale = 1.0 / np.sqrt(np.diag(self.H))
        unit = self.H * np.outer(scale, scale)
        unit[np.diag_indices_from(unit)] += ROUNDING
        return scale, unit

    def solved(self, b: Floats) -> Floats:
        """Solve H x = b, (Z,) or (Z, n).

        The scaling limits rounding errors if the numbers are of very different size.
        """
        scale, unit = self._scaled
        scale = scale.reshape(-1, *(1,) * (b.ndim - 1))
        return np.asarray(scale * np.linalg.solve(unit, scale * b), dtype=np.float64)

    @property
    def step(self) -> Floats:
        """Step (Z,) to the least deviance."""
        return self.solved(self.pull)

    @property
    def promise(self) -> float:
        """Deviance that this step gains; infinite if it cannot be predicted."""
        gain = float(self.pull @ self.step)
        return gain if np.isfinite(gain) else np.inf

    def gained(self, step: Floats) -> float:
        """Deviance that a step (Z,) gains."""
        return float(step @ (2.0 * self.pull - self.H @ step))

    def marginal(self, kept: NDArray[np.intp]) -> "Quadratic":
        """Posterior of the numbers at the places `kept` (K,), the others integrated out."""
        out = np.delete(np.arange(len(self.pull)), kept)
        rest, across = Quadratic(self.H[np.ix_(out, out)], self.pull[out]), self.H[np.ix_(out, kept)]
        return Quadratic(
            self.H[np.ix_(kept, kept)] - across.T @ rest.solved(across), self.pull[kept] - across.T @ rest.step
        )

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of H."""
        scale, unit = self._scaled
        return 2.0 * float(np.sum(np.log(np.diag(np.linalg.cholesky(unit)) / scale)))

    def integrated(self, deviance: float) -> float:
        """Twice the negative logarithm of the posterior's mass, up to a constant, from its deviance at the place."""
        return deviance - self.promise + self.log_det


def solved(H: Floats, b: Floats) -> Floats:
    """Solve H x = b for a precision (Z, Z) with numbers of very different size; b (Z, n)."""
    return Quadratic(H, np.zeros(len(H))).solved(b)
