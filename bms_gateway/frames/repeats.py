"""How often each channel repeats its value, and runs of equal samples that noise cannot produce (see `guard`)."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["DOUBTED", "FEWEST", "HARDLY", "LIVELY", "REMEMBERED", "WIDE", "Repeats"]

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
WIDE, WIDE_STEPS = 0.03, 1.5
"""A channel is noisy, too, if so large a share of its moves goes back against the move before by more than so many of
its finest steps. Noise of 0.4 of a step and more does so. Smaller noise does not, wherever between two steps the
temperature lies: at the border of two steps it moves one step to and fro, and in the middle it gives one value for
minutes."""
MOVES, MOVES_SEEN = 200, 40
"""Moves over which that share is averaged, and least number of them."""
LACKING = 20.7
"""Moves that such noise would have made in a run, above which the run is held back. No move where so many are expected
has a probability of `HARDLY`. They count for channels that repeat more than `LIVELY`, and whose frames may come more
often than the sensor is read."""


class Repeats:
    """Shares of repeated samples, and present runs, of m channels."""

    def __init__(self, m: int) -> None:
        self._compared, self._share, self._run = np.full(m, DOUBTED), np.ones(m), np.zeros(m, np.int64)
        self._wide, self._moves = np.zeros(m), np.zeros(m, np.int64)
        self._finest, self._rose = np.full(m, np.inf), np.zeros(m, np.bool_)

    def count(self, c: Index | slice, compared: Bools, step: NDArray[np.float64], around: Bools) -> None:
        """Count samples that repeat the one before, and their share; a run while others move counts when it ends.

        Parameters
        ----------
        c : ndarray of intp (k,) or slice
            Channels.
        compared : ndarray of bool (k,)
            Which of them have a usable sample, and had one before.
        step : ndarray (k,)
            Change since the sample before.
        around : ndarray of bool (k,)
            Whether their surroundings move.
        """
        same = compared & (step == 0.0)
        differs, again, run = compared ^ same, same & around, self._run[c]
        more = (compared ^ again) + run * differs
        self._compared[c] = count = np.minimum(self._compared[c] + more, REMEMBERED)
        share = self._share[c]
        self._share[c] = share + (more * (1.0 - share) - differs) / count
        size, rose, before, wide = np.abs(step), step > 0.0, self._rose[c], self._wide[c]
        self._moves[c] = moves = np.minimum(self._moves[c] + differs, MOVES)
        self._finest[c] = finest = np.where(differs, np.minimum(self._finest[c], size), self._finest[c])
        goes_back = differs & (rose ^ before) & (size > WIDE_STEPS * finest)
        self._wide[c] = wide + (goes_back - differs * wide) / np.maximum(moves, 1)
        self._rose[c] = np.where(differs, rose, before)
        self._run[c] = np.minimum((run + again) * ~differs, REMEMBERED - 1)

    @property
    def any_run(self) -> bool:
        """Whether any channel has a run that may be too long."""
        return bool(np.count_nonzero(self._run >= FEWEST))

    def lively(self, c: Index | slice = slice(None)) -> Bools:
        """Find channels whose own noise hardly ever gives the same value twice."""
        return self._share[c] <= LIVELY

    def noisy(self, c: Index | slice = slice(None)) -> Bools:
        """Find channels whose own noise moves them about, even if it often gives the same value twice."""
        moves_about = (self._wide[c] >= WIDE) & (self._moves[c] >= MOVES_SEEN)
        return np.asarray(self.lively(c) | moves_about, np.bool_)

    def freezes(self, c: Index | slice) -> Bools:
        """Find noisy channels whose run of equal samples noise cannot produce."""
        share, run = self._share[c], self._run[c]
        too_long = np.where(share <= LIVELY, share**run < HARDLY, run * (1.0 - share) > LACKING)
        return np.asarray(self.noisy(c) & (run >= FEWEST) & too_long, np.bool_)
