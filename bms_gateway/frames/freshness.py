"""Time for which the last value of a signal stays fresh, if multiplexed signals take turns in one message."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.rules import Rule

ROUNDS: Final = 3
"""Rounds that may pass without a value."""


class Turns:
    """Learns the period of each multiplexed signal from its samples; C channels.

    A DBC states the cycle of a message and its possible parts. Only the bus shows whether all parts come in each cycle,
    or one part per cycle. The period is the shorter of the last two times between samples, so that one lost sample does
    not lengthen it, and it is never longer than the DBC allows.

    Parameters
    ----------
    rules : sequence of Rule (C,)
    """

    def __init__(self, rules: Sequence[Rule]) -> None:
        self._stale_ns = np.array([r.stale_after_ns for r in rules], np.int64)
        self._longest_ns = np.array([r.round_ns for r in rules], np.int64)
        self._last_ns, self._before_ns = self._longest_ns.copy(), self._longest_ns.copy()
        self._any = bool(self._longest_ns.any())

    def take(self, channel: NDArray[np.intp], time_ns: NDArray[np.int64], received_ns: NDArray[np.int64]) -> None:
        """Include the samples of one interval.

        Parameters
        ----------
        channel, time_ns : ndarray (n,)
            In the order of the bus.
        received_ns : ndarray (C,)
            Time of each channel's previous sample, negative for none.
        """
        if not self._any:
            return
        count = np.bincount(channel, minlength=len(received_ns))
        newest = received_ns.copy()
        newest[channel] = time_ns
        came = (count > 0) & (received_ns >= 0)
        apart = (newest - received_ns) // np.maximum(count, 1)
        self._before_ns = np.where(came, self._last_ns, self._before_ns)
        self._last_ns = np.where(came, apart, self._last_ns)

    def stale_ns(self) -> NDArray[np.int64]:
        """Give the age at which each channel's last value is stale (C,)."""
        if not self._any:
            return self._stale_ns
        usual = np.minimum(np.minimum(self._last_ns, self._before_ns), self._longest_ns)
        return np.asarray(np.maximum(self._stale_ns, ROUNDS * usual), np.int64)
