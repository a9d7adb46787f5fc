"""Fits in a process of their own, so that they never hold up a frame.

In a thread a fit shares the interpreter's lock with the loop that reads and sends. Each time the loop gives it up (a
system call, a long array operation) it may wait a switch interval to have it back, and a tick makes many of both:
frames came up to 70 ms late. A child takes some tenths of a second longer to start and to import, which nobody waits
for, and its memory is there only while it works. A job is complete in itself and pickles, and gives the same result
wherever it runs.
"""

import logging
import os
import pickle
import signal
import subprocess
import sys
from contextlib import suppress
from typing import BinaryIO, Final

from bms_gateway.engine.events import Job

log = logging.getLogger(__name__)

NICE: Final = 5  # the loop goes first; and beside a busy program a fit still ends long before it is due
CHILD: Final = (sys.executable, "-P", "-m", "bms_gateway.service.aside")  # nothing from where it happens to run


def run_aside(job: Job) -> object:
    """Run a job in a child process and wait for its result; to be called in a thread.

    A child that does not end well (no memory for two processes, say) leaves the job to the calling thread; so what is
    wrong with the job itself shows there, too.

    Parameters
    ----------
    job : Job
        Must pickle, and so must its result.

    Returns
    -------
    object
        As of ``job.run()``; None if the child was told to end, as systemd tells all of a service that stops.
    """
    try:
        # a group of its own: an interrupt from the keyboard is for the service. No session of its own: Linux may share
        # the processor out by sessions, and then priorities count only within one.
        done = subprocess.run(  # noqa: S603 (our own module)
            CHILD, input=pickle.dumps(job), stdout=subprocess.PIPE, check=True, process_group=0
        )
    except (OSError, subprocess.CalledProcessError) as error:
        if isinstance(error, subprocess.CalledProcessError) and error.returncode == -signal.SIGTERM:
            return None
        log.warning("a fit could not be made in a process of its own (%s): it is made in this one", error)
        return job.run()
    result: object = pickle.loads(done.stdout)  # noqa: S301 (written by our own child)
    return result


def work(given: BinaryIO, out: BinaryIO) -> None:
    """Read a job, run it, write its result: what the child does."""
    job: Job = pickle.load(given)  # noqa: S301 (written by our own parent)
    pickle.dump(job.run(), out)


if __name__ == "__main__":
    with suppress(PermissionError):  # the hardened unit forbids it, and has put the loop above its children instead
        os.nice(NICE)
    work(sys.stdin.buffer, sys.stdout.buffer)
