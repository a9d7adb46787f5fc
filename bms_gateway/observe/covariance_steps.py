"""When the covariance takes a step, and when a step is one more of the same kind.

After a change every step is computed; later the covariance goes in strides (`strides`) that grow with the time since
the change, and with calm: a stride over which hardly anything has moved counts as twice that time. Between strides gain
and covariance stand still, and whoever knows how long need not look.

Beyond Lin et al., whose observer has one gain for ever.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import OFFSETS, Bools, Ints
from bms_gateway.thermal import Floats

EVERY = 256
"""Steps after a change that are all computed; before, strides would hardly be cheaper."""
SHARE = 64
"""Strides are powers of two, from this share of the time since the last change to twice as much."""
STILL, SETTLED = 0.01, 1024
"""Share that no variance has moved by over a stride, from which that stride counts twice, and the steps since a change
from which that is believed: the next stride then moves a band by a per cent, as growing strides alone would."""
LONGEST = 2**40
"""Steps that the time since a change may come to by counting twice."""
READ_WITHIN = 60.0
"""s for which a reading stands for its surface: thermocouples that take turns, and many fast time constants (9 s)."""
LAG_STEPS = 4
"""The covariance sees lags in quarters of a step: jitter of the bus then does not make another filter."""
LAG_HOLD = 0.2
"""A quarter is kept until the lag is further from it than this: more than half a quarter, so that it cannot flap."""


def due(held: Ints, since: Ints) -> Bools:
    """Whether the covariance takes this step: after a change at once, later when a stride is full.

    Parameters
    ----------
    held : ndarray of int (S,)
        Steps since the last change, this one included.
    since : ndarray of int (S,)
        Steps that the covariance has not made yet, this one not among them.
    """
    full = (since & (since - 1) == 0) & (SHARE * since >= held)
    return np.asarray((held <= EVERY) | full, dtype=np.bool_)


def steps_left(held: Ints, since: Ints) -> Ints:
    """Count the steps (S,) after which the next one is `due`, if nothing changes.

    Examples
    --------
    >>> steps_left(np.array([100, 256, 1000]), np.array([0, 0, 3])).tolist()
    [0, 8, 13]
    """
    least = np.maximum(np.maximum(since, (held - since + SHARE - 1) // (SHARE - 1)), 1)
    share, exponent = np.frexp(least.astype(np.float64))
    stride = np.ldexp(1.0, exponent - (share == 0.5)).astype(np.int64)
    return np.asarray(np.where(held < EVERY, 0, stride - since), dtype=np.int64)


def stilled(held: Ints, before: Floats, after: Floats) -> Ints:
    """Let strides over which no variance has moved count twice.

    Parameters
    ----------
    held : ndarray of int (S,)
    before, after : ndarray (S, M, M)
        Covariances at the beginning and the end of a stride.
    """
    old, new = np.einsum("sii->si", before), np.einsum("sii->si", after)
    still = (np.abs(new - old) <= STILL * old).all(axis=1) & (held >= SETTLED)
    return np.where(still, np.minimum(2 * held, LONGEST), held)


@dataclass(slots=True)
class Calm:
    """What the newest step was like, and how many more of its kind move no covariance.

    It holds nothing that the state does not tell: without it the same numbers are found the longer way.
    """

    held: Ints | None = None
    since: Ints | None = None
    there: bytes = b""
    known: bytes = b""
    w: Floats | None = None
    sd: Floats | None = None
    left: int = 0

    def goes_on(self, held: Ints, since: Ints, there: Bools, known: Bools, lag: Floats) -> bool:
        """Whether a step from the noted state, with these readings, is one more of the same."""
        return (
            self.left > 0
            and self.held is held
            and self.since is since
            and self.there == there.tobytes()
            and self.known == known.tobytes()
            and self.w is not None
            and (not lag.size or float(np.abs(lag - self.w).max()) <= LAG_HOLD)
        )

    def knew(self, held: Ints, known: Bools) -> bool:
        """Whether the noted step, if these are its counts, had the same inputs measured: none of them is back."""
        return self.held is held and self.known == known.tobytes()

    def passed(self, held: Ints, since: Ints) -> None:
        """Note one more of the same, which led to these counts."""
        self.held, self.since, self.left = held, since, self.left - 1

    def begin(self, held: Ints, since: Ints, there: Bools, known: Bools, pattern: Ints) -> None:
        """Note a step of another kind, which led to these counts and this pattern; `sd` is then to be set."""
        self.held, self.since, self.there, self.known = held, since, there.tobytes(), known.tobytes()
        self.w = np.where(there, pattern[:, :-OFFSETS], 0) / LAG_STEPS
        self.left = int(steps_left(held, since).min())
