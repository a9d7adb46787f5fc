"""Bus time: the time of the wall clock, without the jumps when the wall clock is set.

The kernel stamps frames with the wall clock, and a log of the same traffic contains these numbers. So bus time starts
as wall time and follows it, including slewing. When the wall clock is *set* (by hand, by GPS, from 1970 at the first
contact with a time server), the jump is subtracted from all later stamps. The reference is CLOCK_BOOTTIME, which
continues while the computer is suspended, so that a parked night stays a night.

A reader may be interrupted for any time at any point (a busy machine, a debugger, a suspended process). Frames that
wait in the kernel meanwhile have stamps of all that time. A stamp is therefore compared with the moment at which the
buffer was last known to be empty: the moment at which the drain that emptied it *began*, not that at which its frames
were mapped.
"""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

STEP_NS = 10_000_000  # the error of reading two clocks is far smaller; a smaller step does not harm a thermal estimate
LATE_NS = 2_000_000_000  # an adapter may hold frames back for this long; beyond it, its clock is wrong
SLEW = 1_000  # the kernel slews by at most 500 ppm; twice that, as a divisor
SPLIT_NS = 1_000_000  # if two readings are further apart, the process was interrupted between them; they are repeated


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
        Impossible stamps, which were replaced by the time of arrival.

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
        self._begun = self._empty = (wall_now, 0)  # bus time and offset then

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

    def begin(self) -> None:
        """Note that a drain begins: frames that were stamped before now wait in the buffer."""
        self._begun = self.now_ns(), self.offset_ns

    def to_bus(self, stamps: NDArray[np.int64], *, emptied: bool = True) -> NDArray[np.int64]:
        """Map the stamps of the frames that the drain has taken since `begin`, all at once.

        Parameters
        ----------
        stamps : ndarray of int64 (N,)
            Wall clock, ns, in the order of arrival.
        emptied : bool
            Whether the drain ended because nothing was left.

        Returns
        -------
        ndarray of int64 (N,)
            Bus time. After a step the frames stamped before it keep the old offset. A stamp after now, or long before
            the buffer was last empty, cannot be that of a frame that arrived between: it becomes that of its neighbour
            in the batch, or now.
        """
        now = self.now_ns()
        empty, offset = self._empty
        if self.offset_ns != offset:
            time_ns = stamps + np.where(np.arange(len(stamps)) < self._step(stamps, now), offset, self.offset_ns)
        else:
            time_ns = stamps + offset if offset else stamps
        wrong = (time_ns > now + STEP_NS) | (time_ns < empty - LATE_NS)
        if wrong.any():
            self.misdated += int(np.count_nonzero(wrong))
            # the stamp of the frame before it, otherwise of the frame after it, otherwise now
            good = np.flatnonzero(~wrong)
            near = np.append(time_ns[good], now)[np.maximum(np.cumsum(~wrong) - 1, 0)]
            time_ns = np.where(wrong, near, time_ns)
        if emptied:
            self._empty = self._begun
        return time_ns

    def _step(self, stamps: NDArray[np.int64], now: int) -> int:
        """Find the first frame that was stamped after the wall clock was set; N if none was.

        From the moment at which the buffer was empty until now, each stamp follows the one before it by the time that
        has passed. One stamp follows by this time and the step of the clock. It is the one whose distance from the
        stamp before it is closest to that step.
        """
        empty, offset = self._empty
        line = np.concatenate(([empty - offset], stamps, [now - self.offset_ns]))
        return int(np.abs(np.diff(line) - (offset - self.offset_ns)).argmin())
