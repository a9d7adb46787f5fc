"""Fits in a process of their own, so that a fit that is slow or hangs never delays a frame.

A thread with a fit would share the interpreter's lock with the loop that reads and sends. Each time the loop releases
it (a system call, a long array operation), it may wait a switch interval to get it back, and a tick has many of both:
frames came up to 70 ms late. A child process takes some tenths of a second longer to start and import, for which
nothing waits, and its memory is used only while it works. A job contains all its data, can be pickled, and gives the
same result everywhere.

A thread cannot be ended from outside; a process can. A child that has not ended after `DEADLINE_S` is killed. A fit
without a result (killed, no memory, no process) returns the value `NotDone`: the gateway reports it and tries again.
"""

import ctypes
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from bms_gateway.engine.events import Job
from bms_gateway.service.memory import first_to_go
from bms_gateway.service.signals import signal_name

if sys.version_info < (3, 11, 4):
    # These hold the interpreter's lock from vfork to exec: a program on a disk that hangs would stop the whole service.
    setattr(subprocess, "_USE_VFORK", False)  # noqa: B010 (the documented way; typed as if nobody might)

DEADLINE_S: Final = 60.0  # twice the time in which a result counts as in time; on a slow core a fit takes some seconds
REAP_S: Final = 1.0  # a killed process is gone within milliseconds, unless the kernel itself hangs
NICE: Final = 5  # the loop has priority; with a busy program beside it, a fit still ends long before it is due
CHILD: Final = (sys.executable, "-P", "-m", "bms_gateway.service.fit_process")  # independent of the working directory
PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True, slots=True)
class NotDone:
    """A job that failed, and the reason; another attempt may succeed."""

    why: str


class Aside:
    """Runs jobs in child processes, one at a time.

    Parameters
    ----------
    deadline_s : float
        A child that has not ended after this time is killed.
    child : sequence of str
        Program that does `work`.
    """

    def __init__(self, deadline_s: float = DEADLINE_S, child: Sequence[str] = CHILD) -> None:
        self._deadline_s, self._child = deadline_s, child
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: int | None = None  # that waits for the start of a child
        self._elder: frozenset[int] = frozenset()  # earlier children of this thread: not to be killed
        self._closed = False

    @property
    def process(self) -> int | None:
        """Identifier of the working child."""
        running = self._process
        return None if running is None else running.pid

    def run(self, job: Job) -> object:
        """Run a job and wait for its result; to be called in a thread, and again only after it has returned.

        Parameters
        ----------
        job : Job
            Must pickle, and so must its result.

        Returns
        -------
        object
            Result of ``job.run()``, or `NotDone`.
        """
        given, late = pickle.dumps(job), NotDone(f"it had not ended after {self._deadline_s:g} s and was killed")
        with self._lock:
            if self._closed:
                return NotDone("the service ends")
            self._thread = threading.get_native_id()
            self._elder = _children_of(self._thread)
        due = time.monotonic() + self._deadline_s
        try:
            process = self._start()
        except OSError as error:
            return NotDone(f"no process could be started for it: {error.strerror}")
        try:
            out, _ = process.communicate(given, timeout=max(due - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            return late
        finally:
            self._reap(process)
        if process.returncode < 0:
            return NotDone(f"its process was ended by {signal_name(-process.returncode)}")
        if process.returncode:
            return NotDone("it failed by a bug; the lines above, from its process, say which")
        result: object = pickle.loads(out)  # noqa: S301 (written by our own child)
        return result

    def close(self) -> None:
        """Kill the working child, and start none from now on."""
        with self._lock:
            self._closed = True
        self._kill()

    def _start(self) -> "subprocess.Popen[bytes]":
        """Start a child; if it hangs before it is the requested program, it is killed at the deadline too."""
        timer = threading.Timer(self._deadline_s, self._kill)
        timer.daemon = True  # the interpreter does not wait for it
        timer.start()
        try:
            # a separate group: an interrupt from the keyboard is for the service. Not a separate session: Linux may
            # share the processor between sessions, and then priorities count only within one.
            process = subprocess.Popen(  # noqa: S603 (our own module)
                self._child, stdin=subprocess.PIPE, stdout=subprocess.PIPE, process_group=0
            )
        finally:
            timer.cancel()
            with self._lock:
                self._thread = None
        with self._lock:
            self._process = process
            if self._closed:
                process.kill()
        return process

    def _kill(self) -> None:
        """Kill the child. While it is being started, only the kernel has its number, in a list for each thread."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
            elif self._thread is not None:
                for child in _children_of(self._thread) - self._elder:
                    with suppress(ProcessLookupError):  # it has ended since
                        os.kill(child, signal.SIGKILL)

    def _reap(self, process: "subprocess.Popen[bytes]") -> None:
        """Remove all remains of a child, however it ended."""
        if process.poll() is None:
            process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(REAP_S)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):  # what it has not read is discarded
                    pipe.close()
        with self._lock:
            self._process = None


def _children_of(thread: int) -> frozenset[int]:
    """List the processes that a thread of this process has started; empty if the kernel keeps no such list."""
    try:
        listed = Path(f"/proc/self/task/{thread}/children").read_text(encoding="ascii")
    except OSError:
        return frozenset()
    return frozenset(int(child) for child in listed.split())


def work(given: BinaryIO, out: BinaryIO) -> None:
    """Read a job, run it, write its result: the work of the child."""
    job: Job = pickle.load(given)  # noqa: S301 (written by our own parent)
    pickle.dump(job.run(), out)


if __name__ == "__main__":
    # if the service is killed, its fit ends too, even one that hangs
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    first_to_go()
    with suppress(PermissionError):  # the hardened unit forbids it, and has given the loop priority over its children
        os.nice(NICE)
    work(sys.stdin.buffer, sys.stdout.buffer)
