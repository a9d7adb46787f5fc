"""Divides the time of a log into intervals: of one length while there are frames, one interval for each silence.

So memory and time follow the number of frames. A parked night, or a clock that was set from 1970 while the log was
written, adds one interval.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.engine.stamps import AHEAD_NS
from bms_gateway.thermal import Floats

USUAL: Final = 10
"""A time without frames longer than `AHEAD_NS` and than so many usual gaps is a silence: of the bus, or by a clock that
was set."""
HELD: Final = 3
"""Number of intervals after the last frame of a run; in these a value may be held."""


def edges_of(time_ns: NDArray[np.int64], step_s: float, beyond_s: float) -> Floats:
    """Give the edges of the intervals, s from the first frame.

    Parameters
    ----------
    time_ns : ndarray of int64 (N,)
        Of all frames, not decreasing, N > 0.
    step_s : float
        The common length.
    beyond_s : float
        Time after the last frame that the edges must cover.

    Returns
    -------
    ndarray (K,)
        Increasing, K ≥ 2.

    Examples
    --------
    >>> edges_of(np.array([0, 1, 2, 3_600]) * 1_000_000_000, 1.0, 1.0).tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 3600.0, 3601.0]
    """
    seconds = (time_ns - time_ns[0]) * 1e-9
    taken = (seconds // step_s).astype(np.int64)
    taken = taken[np.diff(taken, prepend=-1) > 0]
    edges = np.unique(taken[:, None] + np.arange(HELD + 2))
    count = max(int(np.ceil((seconds[-1] + beyond_s) / step_s)), int(taken[-1]) + 2)
    return np.asarray(edges[edges < count] * step_s)


def silences(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give the silence before each frame, ns; 0 where there is none.

    Examples
    --------
    >>> silences(np.array([0, 1, 2, 3_600]) * 1_000_000_000).tolist()
    [0, 0, 0, 3598000000000]
    """
    gaps = np.diff(time_ns, prepend=time_ns[:1])
    usual = float(np.median(gaps[1:])) if len(gaps) > 1 else 0.0
    return np.where(gaps > max(AHEAD_NS, USUAL * usual), gaps, 0)


def seen_s(time_ns: NDArray[np.int64]) -> float:
    """Seconds from the first frame to the last without the silences."""
    return float(time_ns[-1] - time_ns[0] - silences(time_ns).sum()) * 1e-9 if len(time_ns) else 0.0


def silence_in(time_ns: NDArray[np.int64]) -> str | None:
    """Report number and length of the silences; None if there are none."""
    gaps = silences(time_ns)
    gaps = gaps[gaps > 0]
    if not len(gaps):
        return None
    longest = in_words(float(gaps.max()) * 1e-9)
    times = f"for {longest}" if len(gaps) == 1 else f"{len(gaps)} times, the longest for {longest}"
    return f"no frame {times}: the bus was silent or a clock was set, and this time says nothing of the signals"


def in_words(seconds: float) -> str:
    """Format a long time in a unit of suitable size.

    Examples
    --------
    >>> in_words(90.0), in_words(21_600.0), in_words(1.7e9)
    ('90 s', '6 h', '54 years')
    """
    for unit, name in ((365.25 * 86_400, "years"), (86_400.0, "days"), (3_600.0, "h"), (60.0, "min")):
        if seconds >= 2 * unit:
            return f"{seconds / unit:.3g} {name}" if unit < 1e6 else f"{seconds / unit:.0f} {name}"
    return f"{seconds:.3g} s"
