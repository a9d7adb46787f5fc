"""How often each channel repeats its value, and runs of equal samples that noise cannot produce (see `guard`)."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["DOUBTED", "FEWEST", "HARDLY", "LIVELY", "REMEMBERED", "Repeats"]

Index = NDArray[np.intp]
Bools = NDArray[np.bool_]
LIVELY = 0.2
"""Greatest share of samples equal to the one before at which a channel counts as noisy. If a channel and half of its
peers were noisy lately, standing still for `SETTLED` times `stuck_after_s` is more than noise can do."""
REMEMBERED, DOUBTED = 600, 5
"""Samples over which that share is averaged, so that noise which has ended is forgotten; and the number of repetitions
with which a channel begins, so that at least 20 samples are needed to show noise. A run of equal samples while others
move enters the share only when it ends."""
HARDLY = 1e-9
"""Probability of a run of equal samples, by that share, below which the run is held back: after 6 to 12 samples. With
noise of 0.02 to 0.1 K, steps of 0.01 K and one sample a second, a good sensor loses less than one sample in 10,000
hours."""
FEWEST = 5
"""Least repetitions of such a run: a share below 0.015 cannot be seen within some minutes."""


class Repeats:
    """Shares of repeated samples, and present runs, of m channels."""

    def __init__(self, m: int) -> None:
        self._compared, self._share, self._run = np.full(m, DOUBTED), np.ones(m), np.zeros(m, np.int64)

    def count(self, c: Index | slice, compared: Bools, same: Bools, around: Bools) -> None:
        """Count samples that repeat the one before, and their share; a run while others move counts when it ends."""
        differs, again, run = compared ^ same, same & around, self._run[c]
        more = (compared ^ again) + run * differs
        self._compared[c] = count = np.minimum(self._compared[c] + more, REMEMBERED)
        share = self._share[c]
        self._share[c] = share + (more * (1.0 - share) - differs) / count
        self._run[c] = np.minimum((run + again) * ~differs, REMEMBERED - 1)

    @property
    def any_run(self) -> bool:
        """Whether any channel has a run that may be too long."""
        return bool(np.count_nonzero(self._run >= FEWEST))

    def lively(self, c: Index | slice = slice(None)) -> Bools:
        """Find channels whose own noise hardly ever gives the same value twice."""
        return self._share[c] <= LIVELY

    def freezes(self, c: Index | slice) -> Bools:
        """Find lively channels whose run of equal samples noise cannot produce."""
        share, run = self._share[c], self._run[c]
        return np.asarray((share <= LIVELY) & (run >= FEWEST) & (share**run < HARDLY), np.bool_)
