"""Fits that the engine gives out run beside the event loop; a fit without a result is tried again."""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Final, Protocol

from bms_gateway.bus.port import Port
from bms_gateway.engine.events import Job, StartJob
from bms_gateway.service.engine_protocol import LiveEngine
from bms_gateway.service.fit_process import NotDone
from bms_gateway.service.tally import Tally
from bms_gateway.service.task_thread import Worker

log = logging.getLogger(__name__)

RETRY_FIRST_S: Final = 60.0  # the reason why a fit was killed (no memory, a busy machine) may be gone by then
RETRY_MOST_S: Final = 900.0  # a fit that always hangs takes a minute of a process in each such time


def run_here(job: Job) -> object:
    """Run a job in the calling thread."""
    return job.run()


class Service(Protocol):
    """What fits need of the service."""

    engine: LiveEngine
    port: Port
    tally: Tally

    @property
    def stopping(self) -> bool:
        """Whether the service is ending, so that nothing new begins."""
        ...


class Fits:
    """Jobs of the engine, one after the other, in a thread of their own.

    Parameters
    ----------
    service : Service
        A reload may replace its engine; the new engine fits its own windows.
    run, end : callable
        As in `live.Jobs`.
    """

    def __init__(self, service: Service, run: Callable[[Job], object], end: Callable[[], None]) -> None:
        self._service, self._run, self._end = service, run, end
        self._worker = Worker("fits")

    def start(self, engine: LiveEngine, event: StartJob) -> None:
        """Start a job; its result goes to `engine`."""
        self._service.tally.jobs += 1
        self._try(engine, event, RETRY_FIRST_S)

    def close(self) -> None:
        """Start no more jobs; running jobs need not be finished."""
        self._worker.close()
        self._end()

    def _try(self, engine: LiveEngine, event: StartJob, again_s: float) -> None:
        """Run a job; without a result, it is tried again after `again_s`, then at growing intervals."""
        if self._service.stopping or engine is not self._service.engine:
            return
        done = self._worker.submit(partial(self._run, event.job))
        done.add_done_callback(partial(self._ended, engine, event, again_s))

    def _ended(self, engine: LiveEngine, event: StartJob, again_s: float, done: "asyncio.Future[object]") -> None:
        service, tally = self._service, self._service.tally
        if done.cancelled() or service.stopping:
            return
        result = done.result()
        if not isinstance(result, NotDone):
            tally.fit_problems.pop(event.job_id, None)
            tally.jobs_late += service.port.now_ns() > event.due_ns
            engine.finish(event.job_id, result)
        elif engine is service.engine:
            tally.jobs_failed += 1
            tally.fit_problems[event.job_id] = result.why
            log.warning("a fit was not made: %s; next try in %g s", result.why, again_s, extra={"code": "fit"})
            done.get_loop().call_later(again_s, self._try, engine, event, min(2 * again_s, RETRY_MOST_S))
