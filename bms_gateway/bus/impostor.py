"""Detects frames with identifiers of our node that another node sent.

A CAN frame has no address of its sender, and every node accepts every identifier. Only this node knows which frames it
sent, so only this node can notice a second gateway on the bus, or a node that imitates it. It cannot stop the other
node; the frames of the other node are refused, counted and reported.
"""

import logging
from collections.abc import Iterable

import numpy as np

from bms_gateway.bus.port import Counters
from bms_gateway.frames.batch import FrameBatch

log = logging.getLogger(__name__)


class Impostors:
    """Removes such frames from what a port receives; the port must not receive its own frames.

    Parameters
    ----------
    channel : str
        For the warning.
    own : iterable of int
        Identifiers of our node; none for one that only listens.
    counters : Counters
        `impostors` is counted here.
    """

    def __init__(self, channel: str, own: Iterable[int], counters: Counters) -> None:
        self._channel, self._counters = channel, counters
        self._own = np.array(sorted(set(own)), np.uint32)

    def refuse(self, frames: FrameBatch) -> FrameBatch:
        """Return the frames without those of impostors."""
        if not len(self._own) or not len(frames):
            return frames
        # this runs at every drain: a search takes a sixth of the time of numpy's `isin`
        at = self._own.searchsorted(frames.can_id)
        theirs = self._own.take(at, mode="clip") == frames.can_id
        if not theirs.any():
            return frames
        count = int(np.count_nonzero(theirs))
        self._counters.impostors += count
        log.warning(
            "%s: another sender uses identifiers of this node (0x%X, %d of them now, %d in all): refused; "
            "is a second gateway on the bus?",
            self._channel,
            int(frames.can_id[theirs][0]) & 0x1FFF_FFFF,
            count,
            self._counters.impostors,
            extra={"code": "impostor"},
        )
        keep = ~theirs
        return FrameBatch(frames.time_ns[keep], frames.can_id[keep], frames.length[keep], frames.data[keep])
