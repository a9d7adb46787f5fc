"""A stand-in for the engine: it ticks, answers each tick with one frame and remembers all it was told."""

from collections import deque

import numpy as np

from bms_gateway.engine.engine import LATEST_NS
from bms_gateway.engine.events import Level, Notice, SendFrames, StartJob
from bms_gateway.frames.batch import FrameBatch

TICK_NS = 100_000_000
OWN_ID = 0x10


class Job:
    def __init__(self, work):
        self._work = work

    def run(self):
        return self._work()


class TickEngine:
    """Ticks on multiples of `TICK_NS` from the first frame on; after `silent` ticks without frames it goes to sleep.

    Attributes
    ----------
    ticks : list of (deadline, frames stamped before it and not before the tick before)
    late : list of stamps of frames that came after the tick they belong to: must stay empty
    """

    def __init__(self, silent=1_000_000):
        self.deadline = None
        self.dropped = 0
        self.last = 0
        self.silent, self.idle = silent, 0
        self.pending, self.ticks, self.late, self.results, self.calls = [], [], [], {}, []
        self.queue, self.overdue = deque(), set()

    def receive(self, frames, *, now_ns):
        assert frames.time_ns.max() <= now_ns
        self.calls.append(("receive", now_ns))
        self.late += [t for t in frames.time_ns.tolist() if t < self.last]
        self.idle = 0
        for t in frames.time_ns.tolist():
            while self.deadline is not None and t >= self.deadline:
                self.tick()
            if self.deadline is None:  # the first frame, or the first after a silence, which may lie within a batch
                self.deadline = (t // TICK_NS + 1) * TICK_NS
            self.pending.append(t)

    def next_deadline(self):
        return self.deadline

    def handle_timer(self, *, now_ns):
        self.calls.append(("timer", now_ns))
        while self.deadline is not None and self.deadline <= now_ns:
            self.tick()

    def tick(self):
        self.ticks.append((self.deadline, len(self.pending)))
        self.pending.clear()
        self.last = self.deadline
        one = FrameBatch(
            np.array([self.deadline]),
            np.array([OWN_ID], np.uint32),
            np.array([8], np.uint8),
            np.frombuffer(self.deadline.to_bytes(8, "big"), np.uint8).reshape(1, 8).copy(),
        )
        self.queue.append(SendFrames(self.deadline, one))
        self.idle += 1
        self.deadline = None if self.idle > self.silent else self.deadline + TICK_NS

    def notice(self, text, code="test"):
        self.queue.append(Notice(self.last, Level.WARNING, code, text))

    def job(self, job_id, work):
        due = self.last if job_id in self.overdue else LATEST_NS
        self.queue.append(StartJob(self.last, job_id, due, Job(work)))

    def next_output(self):
        return self.queue.popleft() if self.queue else None

    def finish(self, job_id, result):
        self.results[job_id] = result

    def snapshot(self):
        return {"ticks": len(self.ticks)}
