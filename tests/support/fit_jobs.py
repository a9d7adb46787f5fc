"""Jobs for a process of fits."""

import os
import time
from dataclasses import dataclass

from bms_gateway.engine import Engine, StartJob
from tests.engine.packs import database, plan, traffic
from tests.support.live_service import PATIENCE_S


@dataclass(frozen=True)
class EndedBy:
    """A job whose process gets a signal while it works."""

    number: int

    def run(self):
        os.kill(os.getpid(), self.number)
        time.sleep(PATIENCE_S)
        return "here"


def windows():
    """The first window of two strings, as the engine hands it out."""
    engine, jobs = Engine(plan(2), database()), []
    frames = traffic(1260)
    engine.receive(frames, now_ns=int(frames.time_ns[-1]))
    while (event := engine.next_output()) is not None:
        if isinstance(event, StartJob):
            jobs.append(event.job)
    return jobs
