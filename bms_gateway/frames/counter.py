"""Alive counters: which protected frames came in sequence."""

import numpy as np
from numpy.typing import NDArray

from bms_gateway.frames.decode import Samples
from bms_gateway.frames.e2e import COUNTER_STATES, MAX_DELTA
from bms_gateway.frames.quality import Quality
from bms_gateway.frames.signal_table import SignalTable

__all__ = ["CounterGuard"]


class CounterGuard:
    """Alive counters of protected messages: one per message and multiplexer value.

    A step of 1…`MAX_DELTA` is a frame in sequence, perhaps after lost frames. A step of 0 is a repetition, and a larger
    step is a wrong sequence. Both are rejected, and the sequence continues from there. A repetition (two paths to one
    bus, a sender that tries again) says nothing about the sensor, so it is not used to judge the sensor.

    Attributes
    ----------
    last : ndarray of int64 (K,)
        Last counter of each node, -1 before the first: the whole state.
    """

    def __init__(self, table: SignalTable) -> None:
        self.last = np.full(len(table.nodes.keys), -1, np.int64)
        # not where a multiplexer value has no layout: then the counter's place is not known
        self._followed = table.switches.of < 0

    def update(self, samples: Samples) -> NDArray[np.uint8]:
        """Return the quality of the samples of one batch: COUNTER where the frame was repeated or out of sequence.

        Batches must come in the order of the bus; how they were cut does not matter.
        """
        return self.follow(samples)[0]

    def follow(self, samples: Samples) -> tuple[NDArray[np.uint8], NDArray[np.intp]]:
        """Do the same as `update`, and also return the frames that only repeat the one before, ascending."""
        p = samples.protected
        whole = np.flatnonzero(p.crc_ok & self._followed[p.node])
        if not len(whole):
            return samples.flag, _NONE
        order = whole[np.argsort(p.node[whole], kind="stable")]
        node, counter = p.node[order], p.counter[order].astype(np.int64)
        fresh = np.ones(len(order), np.bool_)
        fresh[1:] = node[1:] != node[:-1]
        before = np.empty(len(order), np.int64)
        before[1:] = counter[:-1]
        before[fresh] = self.last[node[fresh]]
        ends = np.append(fresh[1:], True)
        self.last[node[ends]] = counter[ends]
        delta = (counter - before) % COUNTER_STATES
        wrong = (before >= 0) & ((delta == 0) | (delta > MAX_DELTA))
        if not wrong.any():
            return samples.flag, _NONE
        flag = samples.flag.copy()
        bad_frame = p.frame[order[wrong]]
        flag[np.isin(samples.frame, bad_frame) & (flag == Quality.GOOD)] = Quality.COUNTER
        return flag, np.sort(p.frame[order[wrong & (delta == 0)]])


_NONE = np.empty(0, np.intp)
