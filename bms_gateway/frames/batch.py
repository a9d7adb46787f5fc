"""A batch of CAN frames as numpy arrays: the form in which every source delivers frames and the engine sends them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

EXTENDED = 0x8000_0000
"""Set in `can_id` for 29-bit identifiers, as CAN_EFF_FLAG in linux/can.h."""


@dataclass(frozen=True, slots=True)
class FrameBatch:
    """N data frames in the order of the bus. Remote and error frames are not included: the room `bus` counts them.

    Attributes
    ----------
    time_ns : ndarray of int64 (N,)
        Bus time, ns.
    can_id : ndarray of uint32 (N,)
        Identifier, with `EXTENDED` for 29-bit ones.
    length : ndarray of uint8 (N,)
        Data bytes, 0…8 (64 for CAN FD).
    data : ndarray of uint8 (N, W)
        Payload, zero beyond `length`; W is 8, or 64 where the source carries CAN FD.
    """

    time_ns: NDArray[np.int64]
    can_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.time_ns)

    def __getitem__(self, part: slice) -> "FrameBatch":
        return FrameBatch(self.time_ns[part], self.can_id[part], self.length[part], self.data[part])

    @classmethod
    def empty(cls) -> "FrameBatch":
        """No frames."""
        return cls(np.empty(0, np.int64), np.empty(0, np.uint32), np.empty(0, np.uint8), np.empty((0, 8), np.uint8))

    @classmethod
    def concat(cls, parts: Sequence["FrameBatch"]) -> "FrameBatch":
        """Join batches in order; classic frames are padded where CAN FD frames are among them."""
        kept = [p for p in parts if len(p)]
        if not kept:
            return cls.empty()
        if len(kept) == 1:
            return kept[0]
        width = max(p.data.shape[1] for p in kept)
        data = np.zeros((sum(len(p) for p in kept), width), np.uint8)
        at = 0
        for p in kept:
            data[at : at + len(p), : p.data.shape[1]] = p.data
            at += len(p)
        return cls(
            np.concatenate([p.time_ns for p in kept]),
            np.concatenate([p.can_id for p in kept]),
            np.concatenate([p.length for p in kept]),
            data,
        )
