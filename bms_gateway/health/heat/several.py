r"""Several faults of one kind that began together: heat in two or more cells, two thermocouples that came loose.

Where two of three cells of a string heat, no single fault explains the readings as well as a fault of the third
thermocouple: that it reads too little. The evidence for a set A of faults needs the products of what they do to the
innovations (`fault_evidence`):

.. math::
    C_{ij} = \sum g_i^T S^{-1} g_j, \quad B = C_A + \operatorname{diag}(1/σ^2), \quad
    \ln E = \tfrac{1}{2} D_A^T B^{-1} D_A - \tfrac{1}{2} \ln \det(B \operatorname{diag}(σ^2)),

with the amplitudes :math:`B^{-1} D_A` and their covariance :math:`B^{-1}`. All pairs are compared, and the likeliest
grows by one fault at a time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bms_gateway.health.heat.layout import Bools, Ints
from bms_gateway.thermal import Floats


class Products:
    """Sums of :math:`g_i^T S^{-1} g_j` over pairs of faults of one kind, for each string and onset.

    Parameters
    ----------
    kinds : ndarray of int (H,)
        Kind of each fault; faults of one kind stand together.
    strings, onsets : int
    of : sequence of int
        Kinds whose pairs are wanted.
    """

    def __init__(self, kinds: Ints, strings: int, onsets: int, of: Sequence[int]) -> None:
        self.faults = {k: np.flatnonzero(kinds == k) for k in of}
        self._sums = {k: np.zeros((strings, onsets, len(p), len(p))) for k, p in self.faults.items()}

    def take(self, g: Floats, V: Floats) -> None:
        """Include a step: g and S⁻¹ g, (S, m, onsets, H)."""
        for k, p in self.faults.items():
            b = slice(int(p[0]), int(p[-1]) + 1)
            self._sums[k] += np.matmul(g[..., b].transpose(0, 2, 3, 1), V[..., b].transpose(0, 2, 1, 3))

    def begin(self, strings: Ints | int, onsets: Ints | slice) -> None:
        """Start again from zero."""
        for x in self._sums.values():
            x[strings, onsets] = 0.0

    def of(self, s: int, kind: int) -> Floats:
        """Return the sums (onsets, b, b) of string `s` for the b faults of a kind."""
        return np.asarray(self._sums[kind][s], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Likes:
    """All b faults of one kind in one string.

    Attributes
    ----------
    C : ndarray (onsets, b, b)
    D : ndarray (onsets, b)
    precision : ndarray (b,)
        1/σ² of the amplitudes before their evidence.
    limits : tuple of float, float
        Least and greatest possible amplitude.
    """

    C: Floats
    D: Floats
    precision: Floats
    limits: tuple[float, float]

    def weigh(self, sets: Ints, onset: Ints | int) -> tuple[Floats, Floats, Floats]:
        """Weigh sets (q, k) of faults, each since an onset.

        Returns
        -------
        ln : ndarray (q,)
            ln evidence over no fault; −inf if an amplitude is impossible.
        amplitude, var : ndarray (q, k), (q, k, k)
            Posterior.
        """
        k = np.arange(sets.shape[1])
        at = np.broadcast_to(np.asarray(onset), len(sets))[:, None]
        B = self.C[at[:, :, None], sets[:, :, None], sets[:, None, :]].copy()
        B[:, k, k] += self.precision[sets]
        var = np.asarray(np.linalg.inv(B), dtype=np.float64)
        D = self.D[at, sets]
        amplitude = np.matmul(var, D[:, :, None])[:, :, 0]
        spread = np.linalg.slogdet(B)[1] - np.log(self.precision[sets]).sum(axis=1)
        ln = 0.5 * (D * amplitude).sum(axis=1) - 0.5 * spread
        least, most = self.limits
        return np.where(((amplitude > least) & (amplitude < most)).all(axis=1), ln, -np.inf), amplitude, var

    def likeliest(self, apart: Bools, least: float, most: int) -> tuple[float, int, Ints] | None:
        """Find the likeliest set of at least two faults: its ln evidence, onset, and faults; None if there is none.

        Parameters
        ----------
        apart : ndarray of bool (b, b)
            Which two faults may be in one set.
        least : float
            ln by which a set must become likelier to grow beyond two.
        most : int
            Greatest number of faults in a set.
        """
        pairs = np.argwhere(np.triu(apart, 1))
        if not len(pairs) or most < 2:
            return None
        onsets = len(self.C)
        ln = self.weigh(np.tile(pairs, (onsets, 1)), np.repeat(np.arange(onsets), len(pairs)))[0]
        best = int(ln.argmax())
        top, onset, chosen = float(ln[best]), best // len(pairs), pairs[best % len(pairs)]
        while len(chosen) < most and (more := np.flatnonzero(apart[chosen].all(axis=0))).size:
            sets = np.concatenate((np.tile(chosen, (len(more), 1)), more[:, None]), axis=1)
            ln = self.weigh(sets, onset)[0]
            if float(ln.max()) < top + least:
                break
            top, chosen = float(ln.max()), sets[int(ln.argmax())]
        return (top, onset, chosen) if np.isfinite(top) else None
