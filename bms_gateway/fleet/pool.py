"""The tasks of a fleet, spread over processes of this machine or over an existing Dask cluster.

Both ways run the same function and return its outcomes in the order of completion; the results do not depend on the
order. A process that dies loses only its own work, which is done again. Every other fault of a log becomes an outcome
that describes it.
"""

import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from uuid import uuid4

from bms_gateway.errors import MissingExtraError, UsageError
from bms_gateway.fleet.task import Outcome, Task, analyse
from bms_gateway.report.processes import processes

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
AHEAD = 2
"""Tasks handed out per process: a process need not wait for its next task, and few tasks are suspect when it dies."""
CONNECT_S = 30.0
"""A scheduler normally answers at once; a busy one may take longer."""
DIED = "the process that analysed it was ended twice (killed, or out of memory)"

Numbered = tuple[int, Outcome]
"""Index of a task and its outcome."""


def on_this_machine(tasks: Sequence[Task], jobs: int) -> Iterator[Numbered]:
    """Run the tasks in `jobs` processes of one BLAS thread each.

    Yields
    ------
    (int, Outcome)
        In the order of completion.
    """
    for name in THREADS:  # read by the libraries when a fresh process loads them
        os.environ[name] = "1"
    waiting = deque(enumerate(tasks))
    while waiting:
        suspects: list[tuple[int, Task]] = []
        with processes(min(jobs, len(waiting))) as pool:
            yield from _until_broken(pool, jobs, waiting, suspects)
        for i, task in sorted(
            suspects, key=lambda s: s[0]
        ):  # one of these tasks ended a process: run each in a process of its own to find out which
            with processes(1) as alone:
                future = alone.submit(analyse, task)
                wait([future])
                yield i, _outcome(future)


def _until_broken(
    pool: ProcessPoolExecutor, jobs: int, waiting: deque[tuple[int, Task]], suspects: list[tuple[int, Task]]
) -> Iterator[Numbered]:
    """Run the tasks until none is left or a process has died; `suspects` then holds the tasks that were running."""
    flying: dict[Future[Outcome], tuple[int, Task]] = {}
    while (waiting and not suspects) or flying:
        while waiting and not suspects and len(flying) < AHEAD * jobs:
            try:
                flying[pool.submit(analyse, waiting[0][1])] = waiting[0]
            except BrokenProcessPool:
                break
            waiting.popleft()
        if not flying:  # the pool broke while no task was running: the caller makes a new pool
            return
        for future in wait(flying, return_when=FIRST_COMPLETED).done:
            i, task = flying.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):
                suspects.append((i, task))
            else:
                yield i, _outcome(future)


def _outcome(future: Future[Outcome]) -> Outcome:
    wrong = future.exception()
    return future.result() if wrong is None else failed(wrong)


def failed(wrong: BaseException) -> Outcome:
    """Describe an unexpected exception in one line."""
    if isinstance(wrong, BrokenProcessPool):
        return Outcome(error=DIED)
    text = " ".join(str(wrong).split())
    return Outcome(error=f"unexpected {type(wrong).__name__}: {text}" if text else f"unexpected {type(wrong).__name__}")


def on_cluster(tasks: Sequence[Task], address: str) -> Iterator[Numbered]:
    """Run the tasks on the workers of an existing Dask scheduler; those of workers that are lost are run again.

    Raises
    ------
    MissingExtraError
        No `dask.distributed`.
    UsageError
        Nothing answers at the address, or it has no workers.
    """
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise MissingExtraError("fleet --scheduler", "fleet") from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as e:  # distributed's TimeoutError is an OSError
        raise UsageError(f"--scheduler {address}: no Dask scheduler answers: {' '.join(str(e).split())}") from None
    with client:
        _expect_workers(client, address)
        this = uuid4().hex  # Dask returns the old result for a name that was used before
        numbers = {f"bms-gateway-{this}-{i}": i for i in range(len(tasks))}
        futures = client.map(analyse, tasks, key=list(numbers))
        for future in as_completed(futures, loop=client.loop):  # type: ignore[no-untyped-call]
            wrong = future.exception()
            yield numbers[future.key], future.result() if wrong is None else failed(wrong)


def _expect_workers(client: object, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)  # type: ignore[attr-defined]
    except TimeoutError:
        raise UsageError(
            f"--scheduler {address}: the scheduler has no workers; start one: dask worker {address}"
        ) from None
