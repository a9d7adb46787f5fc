"""A thread that does one task after the other, and never prevents the process from ending.

Python waits at its end for the threads of `concurrent.futures`. One call that hangs (a disk that does not answer) would
keep the whole service from ending. This thread is a daemon: its present task is cut off when the process ends.
"""

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import TypeVar

T = TypeVar("T")


class Worker:
    """One thread, started with its first task.

    Parameters
    ----------
    name : str
        Of the thread.

    Examples
    --------
    >>> async def main():
    ...     return await Worker("example").submit(lambda: 6 * 7)
    >>> asyncio.run(main())
    42
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._waiting: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def submit(self, work: Callable[[], T]) -> "asyncio.Future[T]":
        """Run a task after all earlier ones; to be called in an event loop, which gets the result."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        done: Future[T] = Future()

        def do() -> None:
            if done.set_running_or_notify_cancel():
                try:
                    result = work()
                except BaseException as error:  # noqa: BLE001 (handed on, as `concurrent.futures` does)
                    done.set_exception(error)
                else:
                    done.set_result(result)

        self._waiting.put(do)
        return asyncio.wrap_future(done)

    def close(self) -> None:
        """Accept no more work, and end when all earlier work is done."""
        self._waiting.put(None)

    def _work(self) -> None:
        while (do := self._waiting.get()) is not None:
            do()
            del do  # otherwise it would keep its last work until the next one comes
