"""Groups of channels that move together: whether the peers of a channel move, and how long it stood meanwhile."""

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.anchor import LONGEST_STEP_S

__all__ = ["Peers"]

Index = NDArray[np.intp]
Bools = NDArray[np.bool_]


class Peers:
    """Peers of m channels.

    Parameters
    ----------
    group : ndarray of intp (m,)
        Number of each channel's group, from 0.

    Attributes
    ----------
    alone : ndarray of bool (m,)
        Which channels have no peer.
    noisy : ndarray of bool (m,)
        Whether half of each channel's peers were noisy lately.
    around : ndarray of bool (m,)
        Whether the surroundings of each channel move.
    clock : ndarray (m,)
        Active time, s, in which the surroundings of each channel moved.
    """

    def __init__(self, group: Index) -> None:
        m = len(group)
        self._group, self._moving = group, np.zeros(m, np.bool_)
        self._count = np.bincount(group, minlength=1)[group] - 1
        self.alone = self._count == 0
        self.noisy, self.around, self.clock = np.zeros(m, np.bool_), np.zeros(m, np.bool_), np.zeros(m)
        self._end_ns = -1

    def others(self, of: Bools) -> NDArray[np.float64]:
        """Count how many peers of each channel are among `of`."""
        return np.asarray(np.bincount(self._group, of, 1)[self._group] - of)

    def of_any(self, of: Bools) -> Bools:
        """Find channels with any channel of their group, or themselves, among `of`."""
        return np.asarray(np.bincount(self._group, of, 1)[self._group] > 0)

    def advance(self, t1_ns: int, active: Bools, updated: Bools, changed: Bools, noisy: Bools) -> None:
        """Count active time for channels whose peers move: among resting peers, standing still proves nothing.

        Parameters
        ----------
        t1_ns : int
            End of the interval.
        active : ndarray of bool
            Whether enough current flowed.
        updated, changed, noisy : ndarray of bool (m,)
            Which channels had a sample, and a new value, in the interval; which are noisy.
        """
        start, self._end_ns = self._end_ns, t1_ns
        others = self.others(updated)
        self._moving = np.where(others > 0, 2 * self.others(changed) >= others, self._moving)
        self.noisy = (self._count > 0) & (2 * self.others(noisy) >= self._count)
        self.around = np.where(self.alone, active, self._moving)
        if start >= 0:
            step = min(max((t1_ns - start) * 1e-9, 0.0), LONGEST_STEP_S)
            self.clock += (active & self.around) * step
