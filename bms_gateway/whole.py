"""Files that come to be as a whole or not at all."""

import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from typing import BinaryIO, Final, TextIO

from bms_gateway.folders import MOST_LINKS, link_in, open_folder

_FRESH: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@contextmanager
def whole(target: Path) -> Iterator[BinaryIO]:
    """Give a new file to write to; it takes the target's place when all went well.

    Parameters
    ----------
    target : Path
        A link is followed, but by root none that another user can change. What is no plain file, such as a pipe or
        ``/dev/null``, is written in place.

    Yields
    ------
    file
        Open for writing bytes.

    Raises
    ------
    OSError
        The target is a folder, or cannot be replaced. After any exception the old target is as it was.

    Examples
    --------
    >>> import tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> target = Path(folder.name) / "a.txt"
    >>> with whole(target) as file:
    ...     _ = file.write(b"all of it")
    >>> target.read_text()
    'all of it'
    >>> folder.cleanup()
    """
    at, name, linked = _place(target)
    try:
        try:
            plain = S_ISREG(os.stat(name, dir_fd=at).st_mode)
        except FileNotFoundError:
            plain = True
        with replaced(at, name) if plain else _in_place(at, name, linked) as file:
            yield file
    finally:
        os.close(at)


@contextmanager
def whole_text(target: Path) -> Iterator[TextIO]:
    """Give a file as `whole` does, open for writing text in UTF-8."""
    with whole(target) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="\n")
        try:
            yield text
        finally:
            text.detach()  # it would close the file


def _place(target: Path) -> tuple[int, str, bool]:
    """Give the open folder and the name of what is written, and whether it is a link to what is no plain file."""
    for _ in range(MOST_LINKS):
        at = open_folder(target.parent)
        try:
            try:
                to = link_in(at, target.name)
            except FileNotFoundError:
                to = None
            if to is None:
                return at, target.name, False
            if target.exists() and not target.is_file():  # such as /dev/stdout, whose link may lead to no path
                return at, target.name, True
        except BaseException:
            os.close(at)
            raise
        os.close(at)
        target = target.parent / to
    raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))


@contextmanager
def _in_place(at: int, name: str, linked: bool) -> Iterator[BinaryIO]:
    flags = os.O_WRONLY | os.O_CLOEXEC
    if not linked:
        flags |= os.O_NOFOLLOW
    handle = os.open(name, flags, dir_fd=at)
    with os.fdopen(handle, "wb") as file:
        if S_ISREG(os.fstat(handle).st_mode):
            raise OSError(errno.EBUSY, "somebody else replaces it")
        yield file


@contextmanager
def replaced(at: int, name: str, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Give a new file in an open folder; it takes the place of whatever has its name there when all went well.

    Until then it has a name that nobody could have made before. A plain file of ours gives it its mode.

    Raises
    ------
    OSError
    """
    fresh = f".{name[:40]}.{os.urandom(8).hex()}.tmp"
    handle = os.open(fresh, _FRESH, mode, dir_fd=at)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
            with suppress(FileNotFoundError):
                before = os.stat(name, dir_fd=at, follow_symlinks=False)
                if S_ISREG(before.st_mode) and before.st_uid == os.geteuid():
                    os.fchmod(handle, before.st_mode & 0o777)
        os.rename(fresh, name, src_dir_fd=at, dst_dir_fd=at)
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(fresh, dir_fd=at)
        raise
