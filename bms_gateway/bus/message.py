"""Conversion between python-can's messages and batches."""

from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from bms_gateway.bus.candump import LATEST_S
from bms_gateway.frames.batch import EXTENDED, FrameBatch

LONGEST: Final = 64  # bytes of a CAN FD frame
MOST_ID: Final = 0x1FFF_FFFF  # of standard frames too: some writers leave out the mark of extended ones

if TYPE_CHECKING:
    import can


class Tally(Protocol):
    """Counter of frames that are not data frames."""

    remote: int

    def note_error(self) -> None:
        """Count an error frame."""
        ...

    def note_impossible(self) -> None:
        """Count a record that cannot be a frame."""
        ...


def to_batch(messages: "list[can.Message]", tally: Tally, shift_s: float = 0.0) -> FrameBatch:
    """Turn messages into a batch; remote and error frames are counted and left out.

    Parameters
    ----------
    messages : list of can.Message
    tally : Tally
        Counts the frames that are left out: remote frames, error frames, and frames that no bus can carry.
    shift_s : float
        Added to the stamps.

    Returns
    -------
    FrameBatch
        Stamps rounded to whole µs: a float of today's seconds holds no more.
    """
    kept = [m for m in messages if not (m.is_error_frame or m.is_remote_frame)]
    if len(kept) < len(messages):
        tally.remote += sum(m.is_remote_frame and not m.is_error_frame for m in messages)
        for _ in range(sum(m.is_error_frame for m in messages)):
            tally.note_error()
    possible = [m for m in kept if _is_possible(m, shift_s)]
    for _ in range(len(kept) - len(possible)):
        tally.note_impossible()
    kept = possible
    payloads = [bytes(m.data) for m in kept]
    width = 64 if any(len(p) > 8 for p in payloads) else 8
    data = np.frombuffer(b"".join(p.ljust(width, b"\0") for p in payloads), np.uint8).reshape(-1, width)
    stamp = np.array([m.timestamp for m in kept], np.float64) + shift_s
    return FrameBatch(
        np.rint(stamp * 1e6).astype(np.int64) * 1_000,
        np.array([m.arbitration_id | (EXTENDED if m.is_extended_id else 0) for m in kept], np.uint32),
        np.array([len(p) for p in payloads], np.uint8),
        data.copy(),
    )


def _is_possible(m: "can.Message", shift_s: float) -> bool:
    """Whether a bus can have carried this frame: from damaged files, readers also return impossible frames."""
    in_time = -LATEST_S < m.timestamp + shift_s < LATEST_S  # false for NaN
    return in_time and 0 <= m.arbitration_id <= MOST_ID and len(m.data) <= LONGEST


def to_message(can_id: int, payload: bytes) -> "can.Message":
    """Turn one frame into a message.

    Parameters
    ----------
    can_id : int
        With `EXTENDED` for 29-bit ones.
    payload : bytes
        Up to 8 bytes, up to 64 for CAN FD.
    """
    import can

    return can.Message(
        arbitration_id=can_id & 0x1FFF_FFFF,
        is_extended_id=bool(can_id & EXTENDED),
        data=payload,
        is_fd=len(payload) > 8,
    )
