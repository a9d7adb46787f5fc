"""Reads many datagrams in one system call, and parses them with numpy.

`recvmmsg` fills rows of preallocated buffers; the time stamp and the drop counter lie at fixed places of the ancillary
data, so that reading them is a column of an array and no Python runs per frame.
"""

import ctypes
import errno
import os
import socket
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bms_gateway.bus.canframe import ROW

SO_TIMESTAMPNS: Final = 35  # asm-generic/socket.h; Python does not name them
SO_RXQ_OVFL: Final = 40
DEPTH: Final = 1_024  # frames per call: more than twice what a full bus brings between drains; 200 KiB


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _Header(ctypes.Structure):
    """`struct msghdr`."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_size", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_size", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    """`struct mmsghdr`."""

    _fields_ = (("header", _Header), ("received", ctypes.c_uint32))


_TOLD = np.dtype(  # the fields of `_Message` that the kernel writes
    {
        "names": ["control_size", "received"],
        "formats": [np.uintp, np.uint32],
        "offsets": [_Header.control_size.offset, _Message.received.offset],
        "itemsize": ctypes.sizeof(_Message),
    }
)
_CONTROL = np.dtype(  # the kernel puts the stamp first, then, once something was lost, the counter
    [
        ("stamp_size", np.uintp),
        ("stamp_level", "=i4"),
        ("stamp_type", "=i4"),
        ("seconds", np.dtype(ctypes.c_long)),
        ("nanoseconds", np.dtype(ctypes.c_long)),
        ("drops_size", np.uintp),
        ("drops_level", "=i4"),
        ("drops_type", "=i4"),
        ("drops", "=u4"),
        ("end", "u1", ctypes.sizeof(ctypes.c_long) - 4 or 4),
    ]
)
_STAMP_SIZE = int(
    np.dtype([(n, _CONTROL[n]) for n in ("stamp_size", "stamp_level", "stamp_type", "seconds", "nanoseconds")]).itemsize
)

# PyDLL: the call never waits, so it keeps the interpreter's lock. Given up, the lock comes back from a thread that
# calculates only after a switch interval (5 ms), as often as the call is made.
_LIBC = ctypes.PyDLL(None, use_errno=True)
recvmmsg = _LIBC.recvmmsg
recvmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
recvmmsg.restype = ctypes.c_int


@dataclass(frozen=True, slots=True)
class Received:
    """Datagrams of one call; the next call overwrites `rows` and `sizes`.

    Attributes
    ----------
    rows : structured ndarray `ROW` (N,)
    sizes : ndarray of uint32 (N,)
    wall_ns : ndarray of int64 (N,)
        Kernel's stamps cut to whole µs (as candump writes them), ns; 0 where there was none.
    drops : int or None
        Frames lost since the socket was opened, modulo 2³²; None if not told.
    """

    rows: NDArray[np.void]
    sizes: NDArray[np.uint32]
    wall_ns: NDArray[np.int64]
    drops: int | None


class Receiver:
    """Reads a datagram socket in bulk.

    Parameters
    ----------
    sock : socket.socket
        Stamps are switched on here, the drop counter where the kernel has it.
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
        self._sock = sock
        self._rows = np.zeros(DEPTH, ROW)
        self._control = np.zeros(DEPTH, _CONTROL)
        self._vectors = (_Vector * DEPTH)()
        self._messages = (_Message * DEPTH)()
        for i in range(DEPTH):
            self._vectors[i] = _Vector(self._rows.ctypes.data + i * ROW.itemsize, ROW.itemsize)
            message = self._messages[i].header
            message.vectors = ctypes.addressof(self._vectors) + i * ctypes.sizeof(_Vector)
            message.vector_count = 1
            message.control = self._control.ctypes.data + i * _CONTROL.itemsize
        headers = np.frombuffer(memoryview(self._messages).cast("B"), _TOLD)
        self._told, self._sizes = headers["control_size"], headers["received"]
        self._seconds, self._nanoseconds = self._control["seconds"], self._control["nanoseconds"]
        self._told[:] = _CONTROL.itemsize

    def take(self) -> Received | None:
        """Read up to `DEPTH` datagrams without waiting.

        Returns
        -------
        Received or None
            None if no datagram waits.

        Raises
        ------
        OSError
            From the socket: the interface is down or gone.
        """
        while (n := recvmmsg(self._sock.fileno(), self._messages, DEPTH, socket.MSG_DONTWAIT, None)) < 0:
            code = ctypes.get_errno()
            if code == errno.EAGAIN:
                return None
            if code != errno.EINTR:
                raise OSError(code, os.strerror(code))
        if n == 0:
            return None
        wall_ns = self._nanoseconds[:n] // 1_000
        wall_ns += self._seconds[:n] * 1_000_000
        wall_ns *= 1_000
        told = self._told[:n]
        drops = None
        if (told != _STAMP_SIZE).any():
            wall_ns[told < _STAMP_SIZE] = 0
            drops = int(self._control["drops"][n - 1]) if told[-1] > _STAMP_SIZE else None
        told[:] = _CONTROL.itemsize
        return Received(self._rows[:n], self._sizes[:n], wall_ns, drops)
