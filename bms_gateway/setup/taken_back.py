"""Keeps a folder consistent: it holds all files of a new setup or none, whenever the program is stopped."""

import os
import re
import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from stat import S_ISREG
from types import FrameType
from typing import BinaryIO, Final

from bms_gateway.folders import open_folder
from bms_gateway.whole import whole

_NAMES: Final = r"(gateway\.toml(\.bak\d*)?|string_\d+\.toml|vehicle\.dbc|guessed\.dbc|cores\.png)"
_OURS: Final = re.compile(rf"{_NAMES}|\.{_NAMES}\.[0-9a-f]{{16}}\.tmp")
"""Names of files that a setup writes, and of its temporary files."""
_STOPS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def taken_back(folder: Path) -> Iterator[None]:
    """Restore a folder, with the files of an older setup, unless the block inside ends without an exception.

    Parameters
    ----------
    folder : Path
        It may be missing; folders that were created for it are removed too.
    """
    made = [p for p in (folder, *folder.parents) if not os.path.lexists(p)]
    with ExitStack() as stack:
        before = _files(folder, stack)
        try:
            with _interrupts_kept():
                yield
        except BaseException:
            with _undisturbed():
                _restore(folder, before)
                for p in made:
                    with suppress(OSError):  # somebody else has put something there
                        p.rmdir()
            raise


def _files(folder: Path, stack: ExitStack) -> dict[str, BinaryIO | None]:
    """List the entries of a folder that have our names, with the plain files open for reading."""
    found: dict[str, BinaryIO | None] = {}
    for name in _names(folder):
        found[name] = None
        with suppress(OSError):  # a file that cannot be read is either not written or left in place
            handle = os.open(folder / name, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
            file = stack.enter_context(os.fdopen(handle, "rb"))
            if S_ISREG(os.fstat(handle).st_mode):
                found[name] = file
    return found


def _names(folder: Path) -> list[str]:
    try:
        return [p.name for p in folder.iterdir() if _OURS.fullmatch(p.name)]
    except OSError:  # missing, or not accessible to this user, who then writes nothing there
        return []


def _restore(folder: Path, before: dict[str, BinaryIO | None]) -> None:
    """Remove new files, and restore replaced ones."""
    new = [name for name in _names(folder) if name not in before]
    if new:
        at = open_folder(folder)
        try:
            for name in new:
                with suppress(FileNotFoundError):
                    os.unlink(name, dir_fd=at)
        finally:
            os.close(at)
    for name, file in before.items():
        if file is not None and not _same(folder / name, file):
            with whole(folder / name) as again:
                again.write(file.read())


def _same(path: Path, file: BinaryIO) -> bool:
    """Whether a file was not replaced: each write renames another file to its name."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except OSError:
        return False


@contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Raise an interrupt again if the block has swallowed it, as some libraries do while they load."""
    seen: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        seen.append(number)
        raise KeyboardInterrupt

    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not heeded or threading.current_thread() is not threading.main_thread():
        yield  # the caller handles the signals
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if seen:
        raise KeyboardInterrupt


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Delay signals that ask for the end until the block is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
