"""The ticks that the live page keeps, in order of time."""

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MOST_TICKS: Final = 20_000
"""Five and a half hours of seconds; 45 MiB with sixty cells."""


@dataclass(frozen=True, slots=True)
class Tick:
    """All cells of all strings at one tick, string after string.

    Attributes
    ----------
    time_ns : int
        End of the tick.
    cells : ndarray (7, N)
        Core, its sd, surface, hottest point, its sd, heat, its sd.
    read : ndarray (2, N)
        Last reading of each surface that was used, °C, NaN for none; its age at the tick, s.
    quality : ndarray (N,)
        `Quality` of each cell.
    past : ndarray (S, 10)
        `history.PAST` of each string.
    strings : tuple of dict
        Further numbers of each string.
    alerts : tuple of dict
    bus : dict
    """

    time_ns: int
    cells: NDArray[np.float32]
    read: NDArray[np.float32]
    quality: NDArray[np.uint8]
    past: NDArray[np.float32]
    strings: tuple[dict[str, Any], ...]
    alerts: tuple[dict[str, Any], ...]
    bus: dict[str, Any]


class KeptTicks:
    """At most `MOST_TICKS` ticks.

    Parameters
    ----------
    thinned : bool
        When there are too many ticks, every second one is kept; otherwise the newer half.

    Attributes
    ----------
    times_ns : list of int
        Ends of the ticks.
    """

    def __init__(self, *, thinned: bool) -> None:
        self._thinned = thinned
        self._ticks: list[Tick] = []
        self.times_ns: list[int] = []
        self._every, self._skipped = 1, 0

    def __len__(self) -> int:
        return len(self._ticks)

    def add(self, tick: Tick) -> None:
        """Keep the next tick, or skip it if only some are kept."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        self._skipped = 0
        self._ticks.append(tick)
        self.times_ns.append(tick.time_ns)
        if len(self._ticks) > MOST_TICKS:
            left = slice(None, None, 2) if self._thinned else slice(-MOST_TICKS // 2, None)
            self._every *= 2 if self._thinned else 1
            self._ticks, self.times_ns = self._ticks[left], self.times_ns[left]

    @property
    def first_ns(self) -> int:
        """End of the first tick; 0 without one."""
        return self.times_ns[0] if self.times_ns else 0

    @property
    def last_ns(self) -> int:
        """End of the newest tick; 0 without one."""
        return self.times_ns[-1] if self.times_ns else 0

    def at(self, time_ns: int) -> Tick:
        """Return the newest tick at or before a time, or the first one; there must be one."""
        return self._ticks[max(bisect_right(self.times_ns, time_ns) - 1, 0)]

    def back(self, time_ns: int, span_s: float) -> list[Tick]:
        """Return the ticks of the last `span_s` before a time; 0: all ticks before it. There may be none."""
        until = bisect_right(self.times_ns, time_ns)
        begin = bisect_left(self.times_ns, time_ns - int(span_s * 1e9)) if span_s > 0.0 else 0
        return self._ticks[begin:until]
