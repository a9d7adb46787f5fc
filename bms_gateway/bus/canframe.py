"""`struct can_frame` and `struct canfd_frame` of linux/can.h as numpy rows, and the classes of error frames."""

import sys
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.port import Counters
from bms_gateway.frames.batch import FrameBatch

RTR: Final = 0x4000_0000
ERR: Final = 0x2000_0000
CLASSIC_BYTES: Final = 16
FD_BYTES: Final = 72

ROW: Final = np.dtype([("can_id", "=u4"), ("length", "u1"), ("flags", "u1"), ("pad", "u1", 2), ("data", "u1", 64)])

BUS_OFF, RESTARTED = "bus-off", "restarted"
ERROR_CLASSES: Final = {  # linux/can/error.h
    0x001: "tx-timeout",
    0x002: "lost-arbitration",
    0x004: "controller",
    0x008: "protocol",
    0x010: "transceiver",
    0x020: "no-acknowledge",
    0x040: BUS_OFF,
    0x080: "bus-error",
    0x100: RESTARTED,
}
ERROR_MASK: Final = 0x1FF

_NO_DATA: Final = RTR | ERR
_COLUMN = np.arange(64, dtype=np.uint8)


def error_classes(can_id: int) -> list[str]:
    """Names of the classes of one error frame.

    Examples
    --------
    >>> error_classes(0x20000044)
    ['controller', 'bus-off']
    """
    return [name for bit, name in ERROR_CLASSES.items() if can_id & bit] or ["other"]


def to_batch(
    rows: NDArray[np.void], sizes: NDArray[np.uint32], time_ns: NDArray[np.int64], counters: Counters
) -> tuple[FrameBatch, list[str]]:
    """Turn frames as the kernel gives them into a batch.

    Parameters
    ----------
    rows : structured ndarray `ROW` (N,)
        Buffers; may be overwritten after the call.
    sizes : ndarray of uint32 (N,)
        Bytes received of each.
    time_ns : ndarray of int64 (N,)
        Stamps, of whatever clock.
    counters : Counters
        Remote, error and malformed frames are counted here.

    Returns
    -------
    FrameBatch
        Data frames only, 8 bytes wide unless a CAN FD frame is among them.
    list of str
        Classes of the error frames, in order.
    """
    errors: list[str] = []
    can_id, length = rows["can_id"].copy(), rows["length"].copy()
    columns = 8
    if not ((sizes == CLASSIC_BYTES).all() and length.max() <= 8 and int(np.bitwise_or.reduce(can_id)) & _NO_DATA == 0):
        whole = (sizes == CLASSIC_BYTES) & (length <= 8) | (sizes == FD_BYTES) & (length <= 64)
        special = can_id & _NO_DATA
        for failed in can_id[whole & (special & ERR != 0)].tolist():
            errors += error_classes(failed)
        counters.malformed += int(np.count_nonzero(~whole))
        counters.remote += int(np.count_nonzero(whole & (special == RTR)))
        keep = np.flatnonzero(whole & (special == 0))
        rows, can_id, length, time_ns = rows[keep], can_id[keep], length[keep], time_ns[keep]
        columns = 64 if (sizes[keep] == FD_BYTES).any() else 8
    data = rows["data"][:, :columns].copy()
    if len(length) and length.min() < columns:
        data *= _COLUMN[:columns] < length[:, None]  # senders may leave anything beyond the length
    for name in errors:
        counters.note_error(name)
    counters.received += len(can_id)
    return FrameBatch(time_ns, can_id, length, data), errors


def to_wire(frames: FrameBatch) -> list[bytes]:
    """Lay frames out as the kernel takes them.

    Returns
    -------
    list of bytes (N)
        16 bytes each, 72 where the payload is longer than 8 bytes.
    """
    rows = np.zeros(len(frames), ROW)
    rows["can_id"], rows["length"] = frames.can_id, frames.length
    rows["data"][:, : frames.data.shape[1]] = frames.data
    raw = rows.tobytes()
    return [
        raw[i * FD_BYTES : i * FD_BYTES + (CLASSIC_BYTES if n <= 8 else FD_BYTES)]
        for i, n in enumerate(frames.length.tolist())
    ]


def from_wire(wire: bytes) -> tuple[int, bytes]:
    """Give back identifier and payload of a frame laid out by `to_wire`."""
    return int.from_bytes(wire[:4], sys.byteorder), wire[8 : 8 + wire[4]]
