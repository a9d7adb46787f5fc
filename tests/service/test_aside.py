"""Jobs in a process of their own: the same result, to the last bit, and none is lost with the process."""

import io
import logging
import os
import pickle
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass

import numpy as np
import pytest

from bms_gateway.engine import Engine, StartJob
from bms_gateway.service import aside
from bms_gateway.service.aside import run_aside, work
from bms_gateway.service.live import Gateway, run_here
from tests.engine.packs import database, plan, traffic
from tests.service.engine import TickEngine
from tests.service.test_live import FRAME, bus, come, run  # noqa: F401 (bus is a fixture)


@dataclass(frozen=True)
class Sum:
    """A job that numpy alone can pickle, and that tells where it ran."""

    values: tuple[float, ...]

    def run(self):
        return float(np.sum(np.sin(self.values))), os.getpid(), os.nice(0)


@dataclass(frozen=True)
class Wrong:
    def run(self):
        raise ZeroDivisionError("in the job")


@dataclass(frozen=True)
class DiesInAChild:
    parent: int
    by: int = signal.SIGKILL

    def run(self):
        if os.getpid() != self.parent:
            os.kill(os.getpid(), self.by)
        return "here"


@pytest.fixture
def path(monkeypatch):
    """The child finds the jobs of this file."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(p for p in sys.path if p))


def test_a_job_runs_in_another_process_at_a_lower_priority_with_the_same_result(path):
    job = Sum(tuple(np.linspace(0.0, 9.0, 1000).tolist()))
    value, process, priority = run_aside(job)
    assert value == job.run()[0]
    assert process != os.getpid()
    assert priority == min(os.nice(0) + aside.NICE, 19)


def test_what_is_wrong_with_a_job_shows_in_the_thread_that_called(path, capfd):
    with pytest.raises(ZeroDivisionError, match="in the job"):
        run_aside(Wrong())
    assert "ZeroDivisionError" in capfd.readouterr().err  # the child has told it too


def test_a_child_that_dies_leaves_the_job_to_the_thread_and_a_warning(path, caplog):
    with caplog.at_level(logging.WARNING):
        assert run_aside(DiesInAChild(os.getpid())) == "here"
    assert "could not be made in a process of its own" in caplog.text


def test_a_child_that_is_told_to_end_ends_and_nobody_does_its_work_now(path, caplog):
    """Else a service that stops would first finish what nobody waits for."""
    with caplog.at_level(logging.WARNING):
        assert run_aside(DiesInAChild(os.getpid(), signal.SIGTERM)) is None
    assert caplog.text == ""


def test_without_room_for_a_process_the_thread_does_it(monkeypatch, caplog):
    monkeypatch.setattr(aside, "CHILD", ("/nonexistent/python",))
    with caplog.at_level(logging.WARNING):
        assert run_aside(DiesInAChild(os.getpid())) == "here"
    assert "No such file" in caplog.text


def test_the_child_reads_a_job_and_writes_its_result():
    out = io.BytesIO()
    work(io.BytesIO(pickle.dumps(Sum((0.0,)))), out)
    assert pickle.loads(out.getvalue())[0] == 0.0


def windows():
    """The first window of two strings, as the engine hands it out."""
    engine, jobs = Engine(plan(2), database()), []
    frames = traffic(1260)
    engine.receive(frames, now_ns=int(frames.time_ns[-1]))
    while (event := engine.next_output()) is not None:
        if isinstance(event, StartJob):
            jobs.append(event.job)
    return jobs


def plain(value):
    """A result as nested tuples, arrays and numbers by their bytes."""
    if is_dataclass(value):
        return tuple((f.name, plain(getattr(value, f.name))) for f in fields(value))
    if isinstance(value, np.ndarray | float):
        array = np.asarray(value)
        return array.shape, array.dtype.str, array.tobytes()
    if isinstance(value, Mapping):
        return tuple((k, plain(v)) for k, v in value.items())
    if isinstance(value, tuple | list):
        return tuple(plain(v) for v in value)
    assert value is None or isinstance(value, str | int | bool | np.generic), type(value)
    return value


@pytest.mark.slow
def test_every_job_that_the_engine_hands_out_gives_the_same_aside_and_here_bit_for_bit():
    jobs = windows()
    assert jobs
    here, there = run_here(jobs[0]), run_aside(jobs[0])
    assert type(here) is type(there)
    assert plain(here) == plain(there)


def test_the_gateway_applies_what_the_child_found(bus, path):  # noqa: F811
    engine = TickEngine()

    async def start():
        bus.theirs.send(FRAME)
        await come(lambda: engine.ticks)
        engine.queue.append(StartJob(engine.last, 3, engine.last + 10**10, Sum((0.5,))))

    run(Gateway(engine, bus.port, run_job=run_aside), start(), until=lambda: engine.results)
    assert engine.results[3][0] == float(np.sin(0.5))
    assert engine.results[3][1] != os.getpid()
