"""Bus time: the wall clock's numbers on a line that does not jump when the wall clock is set.

The kernel stamps frames with the wall clock, and a log of the same traffic has just these numbers; so bus time starts
as wall time and follows it, slewing included. When the wall clock is *set* (by hand, by GPS, from 1970 at the first
contact with a time server), the jump is taken out of all later stamps. The reference is CLOCK_BOOTTIME, which goes on
while the computer is suspended: a parked night stays a night.
"""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

STEP_NS = 10_000_000  # reading two clocks is off by far less; a smaller step does no harm to a thermal estimate
LATE_NS = 2_000_000_000  # an adapter may hold frames back; beyond it, its clock is wrong
SLEW = 1_000  # the kernel slews by at most 500 ppm; twice that, as a divisor
SPLIT_NS = 1_000_000  # two readings further apart had something between them and are taken again


def boot_ns() -> int:
    """Time since boot, suspension included."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class BusClock:
    """Maps wall-clock stamps to bus time.

    Parameters
    ----------
    wall, steady : callable
        The two clocks, ns.

    Attributes
    ----------
    offset_ns : int
        Added to a wall-clock stamp now.
    steps : int
        Wall-clock steps met.
    last_step_ns : int
        Size of the latest, positive when the clock was set forward.
    misdated : int
        Stamps that could not be true, and were replaced by the time of their arrival.

    Examples
    --------
    >>> wall, steady = [1_000_000_000_000], [0]
    >>> clock = BusClock(lambda: wall[0], lambda: steady[0])
    >>> wall[0] += 3_600_000_000_000 + 5; steady[0] += 5      # set forward by an hour
    >>> clock.now_ns(), clock.steps
    (1000000000005, 1)
    """

    def __init__(self, wall: Callable[[], int] = time.time_ns, steady: Callable[[], int] = boot_ns) -> None:
        self._wall, self._steady = wall, steady
        self.offset_ns = 0
        self.steps = 0
        self.last_step_ns = 0
        self.misdated = 0
        self._steady_at, wall_now = self._read()
        self._delta = wall_now - self._steady_at
        self._mapped_offset = 0
        self._mapped_at = wall_now

    def _read(self) -> tuple[int, int]:
        while True:
            before = self._steady()
            wall = self._wall()
            after = self._steady()
            if after - before <= SPLIT_NS:
                return before, wall

    def now_ns(self) -> int:
        """Bus time now; detects a step since the last call."""
        steady, wall = self._read()
        moved = wall - steady - self._delta
        if abs(moved) > STEP_NS + (steady - self._steady_at) // SLEW:
            self.offset_ns -= moved
            self.last_step_ns = moved
            self.steps += 1
        self._delta = wall - steady
        self._steady_at = steady
        return wall + self.offset_ns

    def to_bus(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        """Map the stamps of frames that arrived since the last call.

        Parameters
        ----------
        stamps : ndarray of int64 (N,)
            Wall clock, ns.

        Returns
        -------
        ndarray of int64 (N,)
            Bus time. After a step the frames stamped before it keep the old offset: it is the one that puts them
            between the last call and now. A stamp after now, or long before the last call, cannot be that of a frame
            that arrived between: it becomes that of its neighbour in the batch, or now.
        """
        now = self.now_ns()
        time_ns = stamps + self.offset_ns if self.offset_ns else stamps
        if self.offset_ns != self._mapped_offset:
            before = stamps + self._mapped_offset
            fits = (before >= self._mapped_at - STEP_NS) & (before <= now + STEP_NS)
            time_ns = np.where(fits, before, time_ns)
            self._mapped_offset = self.offset_ns
        wrong = (time_ns > now + STEP_NS) | (time_ns < self._mapped_at - LATE_NS)
        if wrong.any():
            self.misdated += int(np.count_nonzero(wrong))
            # that of the frame before it, or else of the one after it, or else now
            good = np.flatnonzero(~wrong)
            near = np.append(time_ns[good], now)[np.maximum(np.cumsum(~wrong) - 1, 0)]
            time_ns = np.where(wrong, near, time_ns)
        self._mapped_at = now
        return time_ns
