"""Processes that share long work. They end with their parent, however it ends: by Ctrl-C, by an error, or killed."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import connection, resource_tracker
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Processes(ProcessPoolExecutor):
    """A pool whose processes ignore Ctrl-C: the parent receives it and ends them."""

    def __init__(self, count: int) -> None:
        with _safe_path():  # the pool's locks start the resource tracker
            # spawned: a fork would copy the locks of this process's threads
            super().__init__(count, multiprocessing.get_context("spawn"), initializer=_end_with_parent)
            resource_tracker.ensure_running()  # it would open the ears again when it is started

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> "Future[T]":
        """Submit work; a process that is started for it ignores interrupts from its beginning."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with _safe_path():
                return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Prevent processes that start meanwhile from loading modules of the working directory."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


@contextmanager
def processes(count: int) -> Iterator[Processes]:
    """Return a pool that leaves no process behind: after an interruption it does not wait for running work."""
    pool = Processes(count)
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.kill()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()


def _end_with_parent() -> None:
    """Watch the parent: a parent that was killed cannot end its processes."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # noqa: S101 (a pool has started this process)

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
