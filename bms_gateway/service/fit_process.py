"""Fits in a process of their own, so that they never hold up a frame, and never hang anything but themselves.

In a thread a fit shares the interpreter's lock with the loop that reads and sends. Each time the loop gives it up (a
system call, a long array operation) it may wait a switch interval to have it back, and a tick makes many of both:
frames came up to 70 ms late. A child takes some tenths of a second longer to start and to import, which nobody waits
for, and its memory is there only while it works. A job is complete in itself and pickles, and gives the same result
wherever it runs.

And a thread cannot be ended from outside, a process can. One that has not ended after `DEADLINE_S` is killed. What came
of no fit (killed, no memory for it, no process to be had) is a value, `NotDone`: the gateway tells it and tries again.
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

DEADLINE_S: Final = 60.0  # twice what a result may take to count in time; on a slow core it takes some seconds
REAP_S: Final = 1.0  # what is killed is gone in milliseconds, unless the kernel itself hangs
NICE: Final = 5  # the loop goes first; and beside a busy program a fit still ends long before it is due
CHILD: Final = (sys.executable, "-P", "-m", "bms_gateway.service.fit_process")  # nothing from where it happens to run
PR_SET_PDEATHSIG: Final = 1


@dataclass(frozen=True, slots=True)
class NotDone:
    """A job that came to nothing, and why; another try may do better."""

    why: str


class Aside:
    """Runs jobs in child processes, one at a time.

    Parameters
    ----------
    deadline_s : float
        A child that has not ended after so long is killed.
    child : sequence of str
        Program that does `work`.
    """

    def __init__(self, deadline_s: float = DEADLINE_S, child: Sequence[str] = CHILD) -> None:
        self._deadline_s, self._child = deadline_s, child
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: int | None = None  # that waits for the start of a child
        self._elder: frozenset[int] = frozenset()  # children of this thread that it had before: not ours to kill
        self._closed = False

    @property
    def process(self) -> int | None:
        """Its identifier while one works."""
        running = self._process
        return None if running is None else running.pid

    def run(self, job: Job) -> object:
        """Run a job and wait for its result; to be called in a thread, and not again before it has returned.

        Parameters
        ----------
        job : Job
            Must pickle, and so must its result.

        Returns
        -------
        object
            As of ``job.run()``, or `NotDone`.
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
        """Kill what works, and start nothing any more."""
        with self._lock:
            self._closed = True
        self._kill()

    def _start(self) -> "subprocess.Popen[bytes]":
        """Start a child; one that hangs before it is the program that was asked for is killed at the deadline too."""
        timer = threading.Timer(self._deadline_s, self._kill)
        timer.daemon = True  # the interpreter does not wait for it
        timer.start()
        try:
            # a group of its own: an interrupt from the keyboard is for the service. No session of its own: Linux may
            # share the processor out by sessions, and then priorities count only within one.
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
        """Kill the child. While it is being started only the kernel has its number, in a list for each thread."""
        with self._lock:
            if self._process is not None:
                self._process.kill()
            elif self._thread is not None:
                for child in _children_of(self._thread) - self._elder:
                    with suppress(ProcessLookupError):  # it has ended since
                        os.kill(child, signal.SIGKILL)

    def _reap(self, process: "subprocess.Popen[bytes]") -> None:
        """Leave nothing of a child, however it went."""
        if process.poll() is None:
            process.kill()
            with suppress(subprocess.TimeoutExpired):
                process.wait(REAP_S)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):  # what it has not read goes with it
                    pipe.close()
        with self._lock:
            self._process = None


def _children_of(thread: int) -> frozenset[int]:
    """List the processes that a thread of this process has started; none where the kernel keeps no such list."""
    try:
        listed = Path(f"/proc/self/task/{thread}/children").read_text(encoding="ascii")
    except OSError:
        return frozenset()
    return frozenset(int(child) for child in listed.split())


def work(given: BinaryIO, out: BinaryIO) -> None:
    """Read a job, run it, write its result: what the child does."""
    job: Job = pickle.load(given)  # noqa: S301 (written by our own parent)
    pickle.dump(job.run(), out)


if __name__ == "__main__":
    # where the service is killed its fit goes too, even one that hangs
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    first_to_go()
    with suppress(PermissionError):  # the hardened unit forbids it, and has put the loop above its children instead
        os.nice(NICE)
    work(sys.stdin.buffer, sys.stdout.buffer)
