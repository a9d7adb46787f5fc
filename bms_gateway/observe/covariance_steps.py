"""When the covariance makes a step, and when a step repeats the last one.

After a change every step is computed. Later the covariance advances in strides (`strides`). Strides grow with the time
since the change; a stride over which hardly anything has moved counts as twice that time. Gain and covariance are
constant within a stride, so a caller who knows its length need not check every step.

Beyond Lin et al., whose observer has one constant gain.
"""

from dataclasses import dataclass

import numpy as np

from bms_gateway.observe.model import OFFSETS, Bools, Ints
from bms_gateway.thermal import Floats

EVERY = 256
"""Steps after a change that are all computed: strides would hardly be cheaper there."""
SHARE = 64
"""Strides are powers of two, from this share of the time since the last change to twice this share."""
STILL, SETTLED = 0.01, 1024
"""A stride counts twice if no variance has moved by more than this share over it, and at least this many steps have
passed since a change. The next stride then moves a band by a per cent, as growing strides alone would."""
LONGEST = 2**40
"""Upper limit of the counted steps since a change."""
READ_WITHIN = 60.0
"""s for which a reading represents its surface: covers thermocouples that take turns, and many fast time constants (9
s)."""
LAG_STEPS = 4
"""The covariance sees lags in quarters of a step, so that jitter of the bus does not make another filter."""
LAG_HOLD = 0.2
"""A quarter is kept until the lag differs from it by more than this: more than half a quarter, so it cannot
oscillate."""


def due(held: Ints, since: Ints) -> Bools:
    """Whether the covariance makes this step: every step after a change, later when a stride is full.

    Parameters
    ----------
    held : ndarray of int (S,)
        Steps since the last change, including this one.
    since : ndarray of int (S,)
        Steps that the covariance has not made yet, without this one.
    """
    full = (since & (since - 1) == 0) & (SHARE * since >= held)
    return np.asarray((held <= EVERY) | full, dtype=np.bool_)


def steps_left(held: Ints, since: Ints) -> Ints:
    """Count the steps (S,) until a step is `due` again, if nothing changes.

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
    """Count strides twice over which no variance has moved.

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
    """Kind of the newest step, and how many more steps of this kind leave the covariance unchanged.

    It is only a shortcut: without it, the same numbers are found from the state.
    """

    held: Ints | None = None
    since: Ints | None = None
    there: bytes = b""
    known: bytes = b""
    w: Floats | None = None
    sd: Floats | None = None
    left: int = 0

    def goes_on(self, held: Ints, since: Ints, there: Bools, known: Bools, lag: Floats) -> bool:
        """Whether a step from the noted state, with these readings, is of the same kind."""
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
        """Whether the noted step has these counts and had the same inputs, so that no input is measured again."""
        return self.held is held and self.known == known.tobytes()

    def passed(self, held: Ints, since: Ints) -> None:
        """Note one more step of the same kind, which led to these counts."""
        self.held, self.since, self.left = held, since, self.left - 1

    def begin(self, held: Ints, since: Ints, there: Bools, known: Bools, pattern: Ints) -> None:
        """Note a step of another kind, which led to these counts and this pattern; the caller then sets `sd`."""
        self.held, self.since, self.there, self.known = held, since, there.tobytes(), known.tobytes()
        self.w = np.where(there, pattern[:, :-OFFSETS], 0) / LAG_STEPS
        self.left = int(steps_left(held, since).min())
