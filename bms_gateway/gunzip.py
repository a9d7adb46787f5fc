"""Gzip data as a readable file, for logs and tables: unpacked in pieces of the requested size, up to a limit.

A few kilobytes of gzip data can unpack to gigabytes. Measurements do not: each row or frame has a time of its own, so
they unpack to 5 to 30 times their size. Data far beyond that are refused before they cost time or memory.
"""

import io
import zlib
from typing import Any, BinaryIO, Final

from bms_gateway.errors import DataError

MOST_TIMES: Final = 256
FREE: Final = 64 << 20  # bytes that anything may unpack to
PACKED: Final = 1 << 16
DAMAGED: Final = "the gzip data end too early or are damaged"


class Gunzip(io.RawIOBase):
    """Unpacked bytes of gzip data, one or several files of it end to end.

    Parameters
    ----------
    file : binary file
    name : str
        What error lines call it.

    Raises
    ------
    EOFError
        While reading: the data are damaged or end too early. All that stands before the damage was given.
    DataError
        While reading: they unpack to more than `FREE` bytes and `MOST_TIMES` their size.

    Examples
    --------
    >>> import gzip
    >>> Gunzip(io.BytesIO(gzip.compress(b"time_s")), "a.csv.gz").read(4)
    b'time'
    """

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file, self._name = file, name
        self._unpack = zlib.decompressobj(wbits=31)
        self._begun = False
        self._packed = b""
        self._taken = self._given = 0

    def readable(self) -> bool:
        """Say yes, as the base class asks."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer as far as one step of unpacking goes; 0 at the end."""
        while self._packed or self._more():
            try:
                piece = self._unpack.decompress(self._packed, len(buffer))
            except zlib.error:
                raise EOFError(DAMAGED) from None
            self._begun, self._packed = True, self._unpack.unconsumed_tail
            if self._unpack.eof:  # files joined end to end are valid gzip, and so are zeros behind them
                self._packed = self._unpack.unused_data.lstrip(b"\0")
                self._unpack, self._begun = zlib.decompressobj(wbits=31), False
            if piece:
                return self._give(buffer, piece)
        if self._begun:
            raise EOFError(DAMAGED)
        return 0

    def _more(self) -> bool:
        """Read the next packed bytes; whether there are any."""
        while part := self._file.read(PACKED):
            self._taken += len(part)
            self._packed = part if self._begun else part.lstrip(b"\0")
            if self._packed:
                return True
        return False

    def _give(self, buffer: Any, piece: bytes) -> int:
        self._given += len(piece)
        if self._given > max(FREE, MOST_TIMES * self._taken):
            raise DataError(f"{self._name}: unpacks to over {MOST_TIMES} times its size, as no measurements do")
        buffer[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        """Close the file too."""
        self._file.close()
        super().close()
