"""Jobs given out by the engine: a result takes effect at a fixed later bus time, whoever computes it."""

from collections.abc import Iterator
from dataclasses import dataclass

from bms_gateway.engine.events import Job, StartJob


@dataclass(slots=True)
class _Running:
    """A job that is given out."""

    string: int
    due_ns: int
    job: Job
    taken: bool = False
    result: object | None = None


class Jobs:
    """Jobs whose results have not been applied."""

    def __init__(self) -> None:
        self._running: dict[int, _Running] = {}
        self._next = 1

    def hand_out(self, string: int, job: Job, now_ns: int, due_ns: int) -> StartJob:
        """Give a job of a string its number; return its event."""
        event = StartJob(now_ns, self._next, due_ns, job)
        self._running[self._next] = _Running(string, due_ns, job)
        self._next += 1
        return event

    def take(self, job_id: int) -> None:
        """Note that somebody has taken a job and will return its result."""
        if self.awaits(job_id):
            self._running[job_id].taken = True

    def awaits(self, job_id: int) -> bool:
        """Whether a job still needs a result: none has been applied."""
        return job_id in self._running

    def finish(self, job_id: int, result: object) -> None:
        """Keep a result until it is due; None returns the job without a result."""
        if self.awaits(job_id):
            running = self._running[job_id]
            running.result, running.taken = result, result is not None

    def results(self, now_ns: int) -> Iterator[tuple[int, object]]:
        """Yield strings and results that are due, in the order of the jobs; a job that nobody took runs here."""
        due = [i for i, r in self._running.items() if r.due_ns <= now_ns and (r.result is not None or not r.taken)]
        for job_id in due:
            running = self._running.pop(job_id)
            yield running.string, running.job.run() if running.result is None else running.result
