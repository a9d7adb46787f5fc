"""Counters of the service for the metrics: plain numbers without time and lock, written by one thread."""

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Final

LATENESS_S: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 1.0, 5.0)
"""Bounds of the histogram of lateness: from the usual delay (settling, a drain) to that at which a watchdog acts."""


@dataclass(slots=True)
class Histogram:
    """Counts per interval between bounds, as Prometheus keeps them.

    Examples
    --------
    >>> h = Histogram((0.1, 1.0))
    >>> for x in (0.1, 0.5, 7.0):
    ...     h.note(x)
    >>> h.cumulative(), h.total
    ([1, 2, 3], 7.6)
    """

    bounds: tuple[float, ...]
    total: float = 0.0
    _counts: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._counts = [0] * (len(self.bounds) + 1)

    def note(self, value: float) -> None:
        """Count one value."""
        self._counts[bisect_left(self.bounds, value)] += 1
        self.total += value

    def cumulative(self) -> list[int]:
        """Count the values up to each bound, and all."""
        found, running = [], 0
        for count in self._counts:
            running += count
            found.append(running)
        return found


@dataclass(slots=True)
class Tally:
    """Counts since the start."""

    ticks: int = 0
    lateness: Histogram = field(default_factory=lambda: Histogram(LATENESS_S))
    """From the end of a tick in bus time to the moment at which its output leaves the engine, s."""
    wakes: int = 0
    """Number of ended pauses of the bus."""
    notices: dict[str, int] = field(default_factory=dict)
    """Notices by code."""
    jobs: int = 0
    jobs_late: int = 0
    """Results that came after their time."""
    jobs_failed: int = 0
    """Attempts without a result: hung and killed, crashed, or not started."""
    fit_problems: dict[int, str] = field(default_factory=dict)
    """Why the latest attempt failed, for each job that still waits for another one."""
    saves: int = 0
    saves_failed: int = 0
    save_problem: str = ""
    """Why the latest attempt to save the state failed; empty if it succeeded."""
    saved_s: float | None = None
    """Time of the newest snapshot on disk, by `time.monotonic`; that of the start if there is none since, and None
    without a stored state."""
    reloads: int = 0
    reloads_refused: int = 0
    failed_parts: dict[str, str] = field(default_factory=dict)
    """Parts of the service that have ended with an unexpected exception, each with the reason."""
    _told_ns: int = 0

    def told(self, end_ns: int, now_ns: int) -> None:
        """Count a tick with its lateness, once, for any number of its outputs.

        Parameters
        ----------
        end_ns : int
            End of the tick, one of whose outputs has just left the engine.
        now_ns : int
            Present bus time.
        """
        if end_ns > self._told_ns:
            self._told_ns = end_ns
            self.ticks += 1
            self.lateness.note(max(0, now_ns - end_ns) * 1e-9)
