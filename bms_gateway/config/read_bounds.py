"""Bounds on the processor time and memory that reading the user's files may take, whatever the files contain.

A few lines can cost a TOML or DBC parser minutes and gigabytes, and no check beforehand finds all such lines. So a
timer runs while a file is read. A file that exceeds a bound is refused like any other faulty file. The timer counts
processor time, so that a busy machine does not make a sound file wrong. The timer reads the memory use; the kernel does
not limit it, because the hardened unit forbids the system call for limits.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Final

from bms_gateway.errors import ConfigError

READ_S: Final = 5.0
READ_MIB: Final = 100
"""MiB by which the process may grow. It holds some 50 MiB before; the unit allows 256."""
LOOK_S: Final = 0.05
ONCE_MORE_S: Final = 1.0
"""Python drops an exception that the timer raises inside a destructor. The timer therefore raises it again."""
_STATM: Final = Path("/proc/self/statm")
_being_read: list[str] = []


class _BeyondError(BaseException):
    """Not an `Exception`, so that no parser catches it as an error of its own and goes on."""


@contextmanager
def bounded(
    where: str, *, seconds: float | None = None, mib: float = READ_MIB, doing: str = "reading it"
) -> Iterator[None]:
    """Bound the processor time and memory of the block.

    Inside another such block the outer bounds stay in force, and an error names the inner `where`. Outside the main
    thread Python handles no signals, so there is no bound.

    Parameters
    ----------
    where : str
        File with which the error line begins.
    seconds : float, optional
        Processor time of this thread, s; default `READ_S`.
    mib : float
        Resident memory beyond that at the beginning, MiB; on Linux only.
    doing : str
        What needs the time or memory, for the error line.

    Raises
    ------
    ConfigError
        One line: the file, and which bound.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _being_read.append(where)
    try:
        if len(_being_read) > 1:
            yield
        else:
            with _watched(READ_S if seconds is None else seconds, mib, doing):
                yield
    finally:
        _being_read.pop()


@contextmanager
def _watched(seconds: float, mib: float, doing: str) -> Iterator[None]:
    begun, held = time.thread_time(), _resident_mib()
    told_s, last, deaf = 0.0, _being_read[-1], False
    problem = ""

    def look(_: int, __: FrameType | None) -> None:
        nonlocal told_s, last, deaf, problem
        spent = time.thread_time() - begun
        if deaf or (told_s and spent < told_s + ONCE_MORE_S):
            return
        deaf = True  # the timer may come again within, where the interpreter first collects its garbage
        used = _resident_mib() - held
        deaf = False
        if spent > seconds:
            problem = f"{doing} takes over {seconds:g} s"
        elif used > mib:
            problem = f"{doing} takes over {mib:g} MiB"
        else:
            return
        told_s, last = spent, last if told_s else _being_read[-1]
        raise _BeyondError(problem)

    def end() -> None:
        nonlocal deaf
        deaf = True
        signal.setitimer(signal.ITIMER_PROF, *timer)
        # the default action of a signal that comes late would end the process, so it is never restored
        signal.signal(signal.SIGPROF, signal.SIG_IGN)
        if before not in (None, signal.SIG_DFL):
            signal.signal(signal.SIGPROF, before)

    before = signal.signal(signal.SIGPROF, look)
    timer = signal.setitimer(signal.ITIMER_PROF, LOOK_S, LOOK_S)
    try:
        try:
            yield
        finally:
            end()
    except _BeyondError:
        end()  # the timer may have fired just before the other one was set
    except MemoryError:
        raise ConfigError(f"{_being_read[-1]}: {doing} takes more memory than there is") from None
    if problem:  # also where a destructor dropped the exception and the work ended before the timer raised it again
        raise ConfigError(f"{last}: {problem}; leave out of it what the gateway does not need")


def _resident_mib() -> float:
    try:
        pages = int(_STATM.read_bytes().split()[1])
    except OSError:  # not Linux
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)
