"""Signals that are received in any state of the event loop, and a limit for the time of ending.

An event loop gets a signal only between two of its steps, and Python's own handlers run in the main thread only. If
this thread hangs (in a system call, by a bug), only SIGKILL could stop the service. So a separate thread reads the
signal numbers, which the interpreter writes to a descriptor at once, passes them to the loop, and measures the time
from the first signal that requests the end.
"""

import asyncio
import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final

log = logging.getLogger(__name__)

ENDING: Final = frozenset({signal.SIGTERM, signal.SIGINT})
POKE: Final = signal.SIGURG  # no program sends it otherwise: ignored unless requested
CLOSED: Final = b"\0"  # no signal has this number
LAST_WORD_S: Final = 0.2  # time for the last line, if the journal hangs too


@dataclass(frozen=True, slots=True)
class End:
    """Time after which the process ends itself if it has not ended by then."""

    at_s: float
    after_s: float
    status: int

    def now(self) -> None:
        """End the process, with a last line in the log."""
        text = "%g s after it was told to stop the service still hangs: it is killed"
        word = threading.Thread(target=log.critical, args=(text, self.after_s), daemon=True)
        word.start()
        word.join(LAST_WORD_S)
        os._exit(self.status)


class Signals:
    """Hands signals to an event loop.

    Parameters
    ----------
    most_s : float, optional
        The process is ended, with status 1, if it still runs this time after SIGTERM or SIGINT.
    interrupt_s : float, optional
        The same after SIGINT, with status 130: a shorter time for a person at a terminal. Default: `most_s`.
    """

    def __init__(self, most_s: float | None = None, interrupt_s: float | None = None) -> None:
        self._most_s = most_s
        self._interrupt_s = most_s if interrupt_s is None else interrupt_s
        self._loop: asyncio.AbstractEventLoop | None = None
        self._actions: Mapping[int, Callable[[], object]] = {}
        self._before: dict[int, signal._HANDLER] = {}
        self._poke: Callable[[], None] = _nothing
        self._started: Callable[[], None] = _nothing
        self._close: Callable[[], None] | None = None

    def listen(self) -> None:
        """Measure the time from the first signal that requests the end, until `take`; its own handler still runs.

        To be called in the main thread, which must have its own handlers for these signals. The kernel gives a signal
        to the main thread if possible, even while this thread waits for a disk and does not react. So the signal is
        blocked there and comes to our thread, which sends the main thread another one whose only effect is to end a
        wait.
        """
        self._open()
        before = signal.signal(POKE, _nothing)
        signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
        main = threading.get_ident()
        self._poke = partial(signal.pthread_kill, main, POKE)

        def over() -> None:
            self._poke = _nothing
            signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
            signal.signal(POKE, before)

        self._started = over

    def _open(self) -> None:
        ours, theirs = socket.socketpair()
        theirs.setblocking(False)
        thread = threading.Thread(target=self._listen, args=(ours,), name="signals", daemon=True)
        thread.start()
        descriptor = signal.set_wakeup_fd(theirs.fileno(), warn_on_full_buffer=False)

        def close() -> None:
            self._started()
            signal.set_wakeup_fd(descriptor)
            for number, handler in self._before.items():
                signal.signal(number, handler)
            theirs.send(CLOSED)
            thread.join()
            ours.close()
            theirs.close()

        self._close = close

    def take(self, loop: asyncio.AbstractEventLoop, actions: Mapping[int, Callable[[], object]]) -> None:
        """Run an action in the loop on each of some signals; to be called once, in the main thread."""
        if self._close is None:
            self._open()
        self._started()
        self._loop, self._actions = loop, actions
        self._before = {number: signal.signal(number, _nothing) for number in actions}

    def drop(self) -> None:
        """Run no action from now on: a signal only starts the time `most_s`."""
        self._actions = {}

    def close(self) -> None:
        """Handle signals as before `listen` and `take`; in the main thread."""
        if self._close is not None:
            self._close()
        self._close = None

    def _listen(self, ours: socket.socket) -> None:
        end: End | None = None
        while True:
            ours.settimeout(None if end is None else max(1e-3, end.at_s - time.monotonic()))
            try:
                got = ours.recv(1)
            except TimeoutError:
                if end is not None:
                    end.now()
                return
            if got == CLOSED:
                return
            number = got[0]
            most_s, status = (self._interrupt_s, 130) if number == signal.SIGINT else (self._most_s, 1)
            if number in ENDING and end is None and most_s is not None:
                end = End(time.monotonic() + most_s, most_s, status)
            if number != POKE:
                self._poke()
            if self._loop is not None and (action := self._actions.get(number)) is not None:
                with suppress(RuntimeError):  # the loop has just been closed
                    self._loop.call_soon_threadsafe(action)


def signal_name(number: int) -> str:
    """Name a signal; real-time signals have no name.

    Examples
    --------
    >>> signal_name(9), signal_name(37)
    ('SIGKILL', 'signal 37')
    """
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _nothing(*_: object) -> None:
    """Handle a signal by doing nothing: the interpreter has written its number to the descriptor of `Signals`."""
