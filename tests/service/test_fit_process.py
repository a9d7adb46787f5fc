"""Jobs in a process of their own: the same result, to the last bit, and nothing hangs or dies with the process."""

import io
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.engine import StartJob
from bms_gateway.service import fit_process
from bms_gateway.service.fit_process import Aside, NotDone, work
from bms_gateway.service.fits import run_here
from bms_gateway.service.live import Gateway, Jobs
from tests.service.engine import TickEngine
from tests.support.fit_jobs import EndedBy, windows
from tests.support.live_service import FRAME, PATIENCE_S, come, run


@dataclass(frozen=True)
class Sum:
    """A job that numpy alone can pickle, and that tells where and how it ran."""

    values: tuple[float, ...]

    def run(self):
        score = int(Path("/proc/self/oom_score_adj").read_text())
        return float(np.sum(np.sin(self.values))), os.getpid(), os.nice(0), score


@dataclass(frozen=True)
class Wrong:
    def run(self):
        raise ZeroDivisionError("in the job")


@dataclass(frozen=True)
class Large:
    """A job that no pipe holds."""

    content: bytes

    def run(self):
        return self.content[::-1]


@pytest.fixture
def path(monkeypatch):
    """The child finds the jobs of this file."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(p for p in sys.path if p))


def test_a_job_runs_in_another_process_at_a_lower_priority_with_the_same_result(path):
    job = Sum(tuple(np.linspace(0.0, 9.0, 1000).tolist()))
    value, process, priority, score = Aside().run(job)
    assert value == job.run()[0]
    assert process != os.getpid()
    assert priority == min(os.nice(0) + fit_process.NICE, 19)
    assert score == 1000  # where memory is short the kernel ends it, and not the service


def test_a_job_and_a_result_beyond_what_a_pipe_holds_come_through(path):
    content = bytes(range(256)) * 8_000
    assert Aside().run(Large(content)) == content[::-1]


def test_what_is_wrong_with_a_job_shows_in_the_lines_of_its_process_and_ends_nothing_else(path, capfd):
    assert "failed by a bug" in Aside().run(Wrong()).why
    assert "ZeroDivisionError: in the job" in capfd.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_child_that_is_ended_has_made_no_fit_and_this_process_does_not_make_it_either(path, number):
    """Were it short of memory, the second try would end the service instead."""
    assert Aside().run(EndedBy(number)) == NotDone(f"its process was ended by {number.name}")


def test_a_signal_without_a_name_is_told_by_its_number(path):
    """Signals for real time; it raised `ValueError`, which ends the service."""
    number = signal.SIGRTMIN + 3
    assert Aside().run(EndedBy(number)) == NotDone(f"its process was ended by signal {number}")


def test_without_a_process_there_is_no_fit():
    found = Aside(child=("/nonexistent/python",)).run(Sum((0.0,)))
    assert found == NotDone("no process could be started for it: No such file or directory")


def test_a_fit_that_hangs_is_killed_at_its_deadline(path):
    """Stopped, as by a debugger or a frozen control group: no signal but SIGKILL reaches it."""
    one, begun = Aside(deadline_s=2.0), time.monotonic()
    found, children = [], []
    thread = threading.Thread(target=lambda: found.append(one.run(EndedBy(signal.SIGSTOP))))
    thread.start()
    while one.process is None and time.monotonic() < begun + PATIENCE_S:
        time.sleep(0.01)
    children.append(one.process)
    thread.join(PATIENCE_S)
    assert 2.0 <= time.monotonic() - begun < PATIENCE_S
    assert found == [NotDone("it had not ended after 2 s and was killed")]
    assert one.process is None
    with pytest.raises(ProcessLookupError):  # reaped, too
        os.kill(children[0], 0)


def test_at_the_end_a_fit_is_killed_and_none_is_started_any_more(path):
    one, found = Aside(), []
    thread = threading.Thread(target=lambda: found.append(one.run(EndedBy(signal.SIGSTOP))))
    thread.start()
    while one.process is None:
        time.sleep(0.01)
    one.close()
    thread.join(PATIENCE_S)
    assert found == [NotDone("its process was ended by SIGKILL")]
    assert one.run(Sum((0.0,))) == NotDone("the service ends")


PARENT = """
import sys, threading, time
from bms_gateway.service.fit_process import Aside
from tests.support.fit_jobs import EndedBy
one = Aside()
threading.Thread(target=one.run, args=(EndedBy(19),), daemon=True).start()
while one.process is None:
    time.sleep(0.01)
print(one.process, flush=True)
time.sleep(60)
"""


def state_of(process):
    """One letter as `ps` shows it; empty for none."""
    try:
        with open(f"/proc/{process}/stat") as f:
            return f.read().rsplit(") ", 1)[1][0]
    except FileNotFoundError:
        return ""


def test_a_fit_that_hangs_goes_with_a_service_that_is_killed(path):
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE)
    child, end = int(parent.stdout.readline()), time.monotonic() + PATIENCE_S
    while state_of(child) != "T" and time.monotonic() < end:
        time.sleep(0.01)
    assert state_of(child) == "T"
    parent.kill()
    parent.wait()
    parent.stdout.close()
    while state_of(child) not in ("", "Z") and time.monotonic() < end:
        time.sleep(0.01)
    assert state_of(child) in ("", "Z")


def test_the_child_reads_a_job_and_writes_its_result():
    out = io.BytesIO()
    work(io.BytesIO(pickle.dumps(Sum((0.0,)))), out)
    assert pickle.loads(out.getvalue())[0] == 0.0


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
    here, there = run_here(jobs[0]), Aside().run(jobs[0])
    assert type(here) is type(there)
    assert plain(here) == plain(there)


def test_the_gateway_applies_what_the_child_found(bus, path):
    engine = TickEngine()

    async def start():
        bus.theirs.send(FRAME)
        await come(lambda: engine.ticks)
        engine.queue.append(StartJob(engine.last, 3, engine.last + 10**10, Sum((0.5,))))

    run(Gateway(engine, bus.port, jobs=Jobs(Aside().run)), start(), until=lambda: engine.results)
    assert engine.results[3][0] == float(np.sin(0.5))
    assert engine.results[3][1] != os.getpid()
