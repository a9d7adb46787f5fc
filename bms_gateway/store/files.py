"""The disk operations of this room. Each is a single system call, and a power cut may interrupt between any two.

`os.open`, `os.write`, `os.fsync` and the renames of `pathlib` are called one by one on purpose: the crash tests replay
the list of these calls, and nothing buffers in between.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISREG

from bms_gateway.folders import link_in, open_folder

_APPEND = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
_FRESH = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
_READ = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK  # a pipe in place of a file must not block this process
_MODE = 0o640  # not readable by all users: the file shows where and how a vehicle is driven
_CHUNK = 1 << 20


def make_directory(directory: Path) -> None:
    """Make a directory and its parents; all of them are on the disk when this returns.

    Raises
    ------
    OSError
    """
    missing = [d for d in (directory, *directory.parents) if not d.exists()]
    for d in reversed(missing):
        d.mkdir(exist_ok=True)
        sync_directory(d.parent)


def write_fresh(path: Path, content: bytes) -> None:
    """Write a new file; its content, but not yet its name, is on the disk when this returns.

    Raises
    ------
    OSError
    """
    path.unlink(missing_ok=True)
    _write(os.open(path, _FRESH, _MODE), content)


def append(path: Path, content: bytes) -> None:
    """Append to a file, and create it if it is missing; the data are on the disk when this returns.

    Raises
    ------
    OSError
        A part may have been written: the reader must be able to detect this.
    """
    _write(os.open(path, _APPEND, _MODE), content)


def sync_directory(directory: Path) -> None:
    """Sync the names in a directory to the disk.

    Raises
    ------
    OSError
    """
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def reading(path: Path) -> Iterator[int | None]:
    """Open a file to read it; all reads come from this one file, even if another file takes its name meanwhile.

    Yields
    ------
    int or None
        Descriptor. None: the path is not a file.

    Raises
    ------
    OSError
        For root also: the path is a link, or goes through a link, that another user can change.
    """
    at = open_folder(path.parent)
    try:
        guarded = link_in(at, path.name) is not None
        handle = os.open(path.name, _READ | (0 if guarded or os.geteuid() else os.O_NOFOLLOW), dir_fd=at)
    finally:
        os.close(at)
    try:
        yield handle if S_ISREG(os.fstat(handle).st_mode) else None
    finally:
        os.close(handle)


def read_on(handle: int, most: int) -> bytes:
    """Read up to `most` further bytes; fewer only at the end of the file.

    Raises
    ------
    OSError
    """
    parts = []
    while most > 0 and (part := os.read(handle, min(most, _CHUNK))):
        parts.append(part)
        most -= len(part)
    return b"".join(parts)


def read_file(path: Path, most: int) -> bytes | None:
    """Read a file up to its first `most` bytes.

    Returns
    -------
    bytes or None
        None: the path is not a file.

    Raises
    ------
    OSError
    """
    with reading(path) as handle:
        return None if handle is None else read_on(handle, most)


def _write(handle: int, content: bytes) -> None:
    try:
        left = memoryview(content)
        while left:
            left = left[os.write(handle, left) :]
        os.fsync(handle)
    finally:
        os.close(handle)
