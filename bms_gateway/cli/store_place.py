"""Checks, without creating anything, whether the state of the service can be kept in the directory of a config."""

import os
from pathlib import Path
from typing import Final

from bms_gateway.errors import ConfigError, clipped

__all__ = ["store_problem"]

MOST_SHOWN: Final = 200
ROOM: Final = 64
"""Number of bytes of a path that the names of the store's files need."""
NAME_MAX: Final = 255
PATH_MAX: Final = 4096
_OF_THE_KERNEL: Final = ("/proc", "/sys", "/dev")
"""Folders whose files are not on a disk."""
_LIKE_A_DISK: Final = Path("/dev/shm")  # noqa: S108 (named, not written to)


def store_problem(store: Path | None, where: str) -> str | None:
    """Check whether a directory exists or can be made; the service creates a missing one.

    Parameters
    ----------
    store : Path or None
        None: nothing is stored.
    where : str
        File and key, for the error line.

    Returns
    -------
    str or None
        Why this user cannot keep a state there; the service may run as another one.

    Raises
    ------
    ConfigError
        No user can keep a state there.
    """
    if store is None:
        return None
    there = store.absolute()
    shown = clipped(str(there), MOST_SHOWN)
    _refuse_long(there, shown, where)
    while True:
        try:
            there.lstat()
        except (FileNotFoundError, NotADirectoryError):
            there = there.parent
        except PermissionError as e:
            return f"{shown} cannot be looked at: {e.strerror}"
        except OSError as e:  # links that lead to each other, a name too long for this file system
            raise ConfigError(f"{where}: {shown} cannot be made: {e.strerror}; name another directory") from None
        else:
            break
    if not there.is_dir():
        raise ConfigError(f"{where}: {clipped(str(there), MOST_SHOWN)} is no directory; name one, or one to be made")
    real = there.resolve()
    if any(real.is_relative_to(place) for place in _OF_THE_KERNEL) and not real.is_relative_to(_LIKE_A_DISK):
        raise ConfigError(f"{where}: {shown}: no disk keeps what lies in {real}; name a directory of a disk")
    return None if os.access(there, os.W_OK | os.X_OK) else f"{there} cannot be written by this user"


def _refuse_long(there: Path, shown: str, where: str) -> None:
    """Refuse names that no file system takes; nothing else checks the name of a folder that does not exist yet."""
    longest = max(there.parts, key=lambda part: len(os.fsencode(part)))
    if (size := len(os.fsencode(longest))) > NAME_MAX:
        raise ConfigError(f"{where}: {shown} cannot be made: a name of {size} bytes; at most {NAME_MAX} are possible")
    if (size := len(os.fsencode(there))) > PATH_MAX - ROOM:
        raise ConfigError(
            f"{where}: {shown} cannot be made: a path of {size} bytes; at most {PATH_MAX - ROOM} are possible"
        )
