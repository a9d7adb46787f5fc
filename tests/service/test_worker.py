"""One thread, one task after the other; what hangs keeps neither the loop nor the process."""

import asyncio
import subprocess
import sys
import threading

import pytest

from bms_gateway.service.task_thread import Worker
from tests.support.live_service import PATIENCE_S

SOON_S = 5.0  # a thread that is free answers in milliseconds


def within(part):
    """Run a coroutine in a loop of its own; what it waits for must come."""

    async def soon():
        async with asyncio.timeout(SOON_S):
            return await part()

    return asyncio.run(soon())


def test_tasks_are_done_in_order_in_one_thread_of_that_name_that_keeps_no_process():
    done = []

    async def part():
        worker = Worker("some name")
        futures = [worker.submit(lambda k=k: done.append((k, threading.current_thread())) or k) for k in range(50)]
        return [await future for future in futures]

    assert within(part) == list(range(50))
    assert [k for k, _ in done] == list(range(50))
    assert len({thread for _, thread in done}) == 1
    thread = done[0][1]
    assert (thread.name, thread.daemon) == ("some name", True)


def test_what_a_task_raises_is_raised_where_it_is_awaited_and_the_next_is_done():
    def wrong():
        raise SystemExit(3)

    async def part():
        worker = Worker("x")
        with pytest.raises(SystemExit):
            await worker.submit(wrong)
        return await worker.submit(lambda: 7)

    assert within(part) == 7


def test_a_task_that_nobody_waits_for_any_more_is_not_begun():
    begun, goes_on, done = threading.Event(), threading.Event(), []

    async def part():
        worker = Worker("x")
        first = worker.submit(lambda: begun.set() or goes_on.wait(PATIENCE_S))
        begun.wait(SOON_S)
        second, third = worker.submit(lambda: done.append(2)), worker.submit(lambda: done.append(3))
        second.cancel()
        await asyncio.sleep(0)  # the loop hands that on
        goes_on.set()
        await first
        await third

    try:
        within(part)
    finally:
        goes_on.set()
    assert done == [3]


def test_closed_it_does_what_was_given_before_and_ends():
    threads = []

    async def part():
        worker = Worker("x")
        last = worker.submit(lambda: threads.append(threading.current_thread()))
        worker.close()
        late = worker.submit(lambda: threads.append(None))
        await last
        threads[0].join(SOON_S)
        return late.done()

    assert within(part) is False
    assert not threads[0].is_alive()
    assert len(threads) == 1


def test_what_a_task_was_given_is_let_go_of_before_the_next_comes():
    """The state of a save is some megabytes, and the next save a minute away."""
    gone = threading.Event()

    class Given:
        def __del__(self):
            gone.set()

        def __call__(self):
            return None

    async def part():
        await Worker("x").submit(Given())
        return await asyncio.to_thread(gone.wait, SOON_S)

    assert within(part)


def test_a_task_that_hangs_does_not_keep_the_process():
    code = """
import asyncio, threading
from bms_gateway.service.task_thread import Worker
begun = threading.Event()
async def main():
    Worker("x").submit(lambda: begun.set() or threading.Event().wait())
    begun.wait()
asyncio.run(main())
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=PATIENCE_S, check=False).returncode == 0
