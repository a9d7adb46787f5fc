"""A folder that holds all of a new setup or nothing of it, whenever the program is stopped."""

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
"""Names of what a setup writes, and of what has not got its name yet."""
_STOPS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def taken_back(folder: Path) -> Iterator[None]:
    """Let a folder be as it was before, with the files of an older setup, unless what is within comes to its end.

    Parameters
    ----------
    folder : Path
        It may be missing; the folders that are made for it are taken back too.
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
    """List what has names of ours in a folder, with the plain files open for reading."""
    found: dict[str, BinaryIO | None] = {}
    for name in _names(folder):
        found[name] = None
        with suppress(OSError):  # what cannot be read is not written either, or stays where it is
            handle = os.open(folder / name, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
            file = stack.enter_context(os.fdopen(handle, "rb"))
            if S_ISREG(os.fstat(handle).st_mode):
                found[name] = file
    return found


def _names(folder: Path) -> list[str]:
    try:
        return [p.name for p in folder.iterdir() if _OURS.fullmatch(p.name)]
    except OSError:  # missing, or closed to this user, who then writes nothing there
        return []


def _restore(folder: Path, before: dict[str, BinaryIO | None]) -> None:
    """Take away what is new, and put back what was replaced."""
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
    """Whether a file was not replaced: whoever writes here gives a name to another file."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except OSError:
        return False


@contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Raise an interrupt again at the end where what is within has swallowed it, as some libraries do when loaded."""
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
    """Keep signals that ask for the end until this is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _STOPS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
