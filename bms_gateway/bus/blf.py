"""Reads Vector's BLF with python-can's reader, with bounds on the memory that a damaged or hostile file can take.

A container of a few kilobytes may unpack to gigabytes, and the header of one object may claim the length of all
containers that follow. Here both are damaged records.

Frames may lie across the end of a container. After a damaged container, python-can would join the rest of the container
before it to the next one, which makes frames that nobody sent. Here reading goes on with the first object that begins
after the damage.
"""

import zlib
from collections.abc import Generator, Iterator
from typing import BinaryIO, Final

import can
from can.io import blf

MOST: Final = 16 << 20  # bytes of one container or object; writers make containers of 128 KiB


class BoundedBlf(blf.BLFReader):
    """python-can's reader with containers and objects of up to `MOST` bytes."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(Bounded(file))  # type: ignore[arg-type]
        self._follows = True

    def __iter__(self) -> Generator[can.Message, None, None]:
        """Messages of the remaining containers."""
        while head := self.file.read(blf.OBJ_HEADER_BASE_STRUCT.size):
            signature, _, _, size, kind = blf.OBJ_HEADER_BASE_STRUCT.unpack(head)
            if signature != b"LOBJ":
                raise blf.BLFParseError("not an object of a BLF")
            packed = self.file.read(size - blf.OBJ_HEADER_BASE_STRUCT.size)
            self.file.read(size % 4)  # padding
            if kind == blf.LOG_CONTAINER:
                follows, self._follows = self._follows, False
                data = unpacked(packed)
                if not follows:
                    self._tail = b""
                    data = data[_first(data) :]
                yield from self._parse_container(data)
                self._follows = True

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        yield from super()._parse_container(data)
        if len(self._tail) > MOST:
            raise blf.BLFParseError(f"an object of over {MOST >> 20} MiB")


class Bounded:
    """A file whose reads are limited, whatever a header claims."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """Read bytes, at most `MOST`."""
        if not 0 <= size <= MOST:
            raise blf.BLFParseError(f"a record of {size >> 20} MiB")
        return self._file.read(size)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _first(data: bytes) -> int:
    """Offset of the first object that begins in a container."""
    at = data.find(b"LOBJ")
    return len(data) if at < 0 else at


def unpacked(packed: bytes) -> bytes:
    """Unpack a container, to at most `MOST` bytes."""
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(packed)
    data = packed[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return data
    if method != blf.ZLIB_DEFLATE:
        raise blf.BLFParseError(f"a container packed by method {method}")
    unpack = zlib.decompressobj()
    data = unpack.decompress(data, MOST)
    if unpack.unconsumed_tail:
        raise blf.BLFParseError(f"a container of over {MOST >> 20} MiB")
    return data
