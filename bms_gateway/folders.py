"""Opens folders in which root writes beside other users, so that no link of theirs leads it to another place.

A path is looked up anew at each use, and whoever owns a folder on the way may put a link there in between. So root
walks down from the top with descriptors, and follows a link only where nobody else can change it.
"""

import errno
import os
from pathlib import Path
from stat import S_ISLNK, S_ISVTX
from typing import Final

_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
_OTHERS: Final = 0o022
MOST_LINKS: Final = 40  # as the kernel allows


def open_folder(path: Path) -> int:
    """Open a folder; give its descriptor, for the caller to close.

    Raises
    ------
    OSError
        It is missing, or may not be entered; for root also: a link on the way is one that another user can change.
    """
    if os.geteuid() != 0:
        return os.open(path, _FOLDER)
    at, left, links = os.open("/", _FOLDER), [*reversed(path.absolute().parts[1:])], 0
    try:
        while left:
            part = left.pop()
            try:
                inner = os.open(part, _FOLDER | os.O_NOFOLLOW, dir_fd=at)
            except OSError:
                to, links = link_in(at, part), links + 1
                if to is None or links > MOST_LINKS:
                    raise
                left.extend(reversed(to.parts[1:] if to.is_absolute() else to.parts))
                if not to.is_absolute():
                    continue
                inner = os.open("/", _FOLDER)
            os.close(at)
            at = inner
    except BaseException:
        os.close(at)
        raise
    return at


def link_in(at: int, name: str) -> Path | None:
    """Tell where a link in an open folder leads; None if it is no link.

    Raises
    ------
    OSError
        It is missing; for root also: another user can change it.
    """
    found = os.stat(name, dir_fd=at, follow_symlinks=False)
    if not S_ISLNK(found.st_mode):
        return None
    folder = os.fstat(at)
    guarded = not folder.st_mode & _OTHERS or (folder.st_mode & S_ISVTX and found.st_uid == 0)
    if os.geteuid() == 0 and not (folder.st_uid == 0 and guarded):
        raise OSError(errno.ELOOP, f"{name} is a link that another user can change")
    return Path(os.readlink(name, dir_fd=at))
