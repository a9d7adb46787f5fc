"""Requests of a person to the service: small files in its state directory.

A request is written as a whole. The service carries it out while it runs or at its next start, and removes it once the
resulting state has been saved.

Root writes requests into a directory of the service's user, who may create any file there at any moment. So no path is
used: the directory is opened once, the file is created in it only if the name is free, never through a link, and its
mode is set by its descriptor.
"""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from bms_gateway.errors import StateError
from bms_gateway.folders import open_folder

PATTERN = "baseline.*.request"
ACKNOWLEDGED = "acknowledged.*.request"
MAX_BYTES = 10_000
MODE = 0o644  # the service runs as another user than the person at the keyboard
_FRESH = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


@dataclass(frozen=True, slots=True)
class BaselineReset:
    """A new baseline of R_e for a string or one of its cells (from 1), because parts were replaced.

    `time_ns` is the wall clock at the time of the request. It identifies the request, which is carried out only once.
    """

    string: str
    cell: int | None
    reason: str
    time_ns: int


@dataclass(frozen=True, slots=True)
class Acknowledgement:
    """A person has looked at the alarms of a string, or of all strings (None), so these alarms may end.

    `time_ns` is the wall clock when it was given, and its name.
    """

    string: str | None
    reason: str
    time_ns: int


Wish = BaselineReset | Acknowledgement


def one_line(reason: str, most: int = 200) -> str:
    r"""Turn the text of a person into one line of printable characters, for a journal or a terminal.

    Examples
    --------
    >>> one_line(" new\n module\x1b[31m ")
    'new module [31m'
    """
    return " ".join("".join(c if c.isprintable() else " " for c in reason).split())[:most]


def ask(directory: Path, wish: Wish) -> Path:
    """Write a request into the service's directory; the file is complete or does not exist.

    Raises
    ------
    StateError
        The directory is missing or not writable.
    """
    name = _pattern(wish).replace("*", str(wish.time_ns))
    try:
        at = open_folder(directory)
        try:
            _write(at, name, json.dumps(asdict(wish)).encode())
        finally:
            os.close(at)
    except OSError as e:
        raise StateError(f"{directory}: the request cannot be written: {e.strerror}") from None
    return directory / name


def _write(at: int, name: str, content: bytes) -> None:
    """Write a file into an open directory; the file is complete or does not exist."""
    fresh = f".{name}.{os.urandom(8).hex()}"  # a name that no other process can have created in advance
    handle = os.open(fresh, _FRESH, MODE, dir_fd=at)
    try:
        with os.fdopen(handle, "wb") as f:
            os.fchmod(handle, MODE)  # whatever the umask
            f.write(content)
            f.flush()
            os.fsync(handle)
        os.rename(fresh, name, src_dir_fd=at, dst_dir_fd=at)
    except OSError:
        with suppress(FileNotFoundError):
            os.unlink(fresh, dir_fd=at)
        raise
    os.fsync(at)


def _pattern(wish: Wish) -> str:
    return PATTERN if isinstance(wish, BaselineReset) else ACKNOWLEDGED


def asked(directory: Path) -> Iterator[tuple[Path, Wish | OSError | None]]:
    """Give the waiting requests, the oldest of each kind first.

    None stands for a file that is not a request, an `OSError` for a file that cannot be read now.
    """
    for kind in (BaselineReset, Acknowledgement):
        yield from _of_kind(directory, kind)


def _of_kind(directory: Path, kind: type[Wish]) -> Iterator[tuple[Path, Wish | OSError | None]]:
    for path in sorted(directory.glob(PATTERN if kind is BaselineReset else ACKNOWLEDGED)):
        try:
            if not path.is_file():  # a pipe would never end
                yield path, None
                continue
            with path.open("rb") as f:
                raw = f.read(MAX_BYTES)
        except FileNotFoundError:  # removed meanwhile
            continue
        except OSError as error:
            yield path, error
            continue
        try:
            wish = kind(**json.loads(raw))
        except (ValueError, TypeError, RecursionError):
            yield path, None
            continue
        sound: bool = type(wish.time_ns) is int and type(wish.reason) is str
        if isinstance(wish, BaselineReset):
            sound &= isinstance(wish.string, str)
            sound &= wish.cell is None or (type(wish.cell) is int and wish.cell >= 1)
        else:
            sound &= wish.string is None or isinstance(wish.string, str)
        yield path, replace(wish, reason=one_line(wish.reason)) if sound else None
