"""Fits and saves beside the loop: neither waits for the other, and one that hangs holds up nothing but itself."""

import asyncio
import logging
import os
import signal
import threading
import time

import numpy as np

from bms_gateway.errors import StateError
from bms_gateway.service import fits, live
from bms_gateway.service.fit_process import NotDone
from bms_gateway.service.live import Gateway, Jobs
from tests.service.engine import TICK_NS, TickEngine
from tests.support.live_service import PATIENCE_S, come, run, traffic


def test_state_is_saved_now_and_then_and_a_full_disk_does_no_harm(bus, monkeypatch, caplog):
    monkeypatch.setattr(live, "SAVE_S", 0.2)
    saved = []

    def save(state):
        saved.append(threading.current_thread().name)
        raise StateError("disk full") if len(saved) % 2 else OSError(28, "No space left on device")

    with caplog.at_level(logging.WARNING):
        run(Gateway(TickEngine(), bus.port, save=save), until=lambda: len(saved) >= 3)
    assert len(saved) >= 4
    assert set(saved) == {"saves"}
    assert "disk full" in caplog.text


def test_a_fit_that_hangs_stops_no_save(bus, monkeypatch):
    """Fits and saves had one thread for both: the state on disk grew old, and nothing said so."""
    monkeypatch.setattr(live, "SAVE_S", 0.05)
    engine, saved, hangs = TickEngine(), [], threading.Event()
    engine.job(1, hangs.wait)
    gateway = Gateway(engine, bus.port, save=saved.append)
    begun = time.monotonic()
    run(gateway, until=lambda: len(saved) >= 3)
    hangs.set()
    assert len(saved) >= 4
    assert (gateway.tally.jobs, engine.results) == (1, {})
    assert time.monotonic() - begun < PATIENCE_S


def test_a_fit_that_came_to_nothing_is_counted_told_and_tried_again_ever_less_often(bus, monkeypatch, caplog):
    monkeypatch.setattr(fits, "RETRY_FIRST_S", 0.05)
    monkeypatch.setattr(fits, "RETRY_MOST_S", 0.15)
    engine, tries, told = TickEngine(), [], []

    def run_job(job):
        tries.append(time.monotonic())
        told.append(dict(gateway.tally.fit_problems))
        return NotDone("it hung") if len(tries) < 5 else job.run()

    gateway = Gateway(engine, bus.port, jobs=Jobs(run_job))
    engine.job(7, lambda: 42)
    with caplog.at_level(logging.WARNING):
        run(gateway, until=lambda: engine.results)
    assert engine.results == {7: 42}
    assert told == [{}, *[{7: "it hung"}] * 4]
    assert (gateway.tally.jobs, gateway.tally.jobs_failed, gateway.tally.fit_problems) == (1, 4, {})
    assert [r.getMessage() for r in caplog.records if getattr(r, "code", "") == "fit"] == [
        f"a fit was not made: it hung; next try in {s:g} s" for s in (0.05, 0.1, 0.15, 0.15)
    ]
    assert all(b - a >= least for a, b, least in zip(tries, tries[1:], (0.05, 0.1, 0.15, 0.15), strict=False))


def test_a_fit_of_an_engine_that_a_reload_has_replaced_is_not_tried_again(bus, monkeypatch):
    monkeypatch.setattr(fits, "RETRY_FIRST_S", 0.2)
    old, new, tries, before = TickEngine(), TickEngine(), [], []

    async def reload():
        return new

    gateway = Gateway(old, bus.port, reload=reload, jobs=Jobs(lambda _: tries.append(1) or NotDone("it hung")))
    old.job(7, lambda: 42)

    async def hup():
        await come(lambda: gateway.tally.fit_problems)
        os.kill(os.getpid(), signal.SIGHUP)
        await come(lambda: gateway.engine is new)
        before.append(len(tries))
        await asyncio.sleep(0.5)

    done = asyncio.Event()

    async def then():
        await hup()
        done.set()

    run(gateway, then(), until=done.is_set)
    assert before[0] >= 1
    assert ([len(tries)], gateway.tally.fit_problems) == (before, {})


def test_a_disk_that_hangs_is_told_holds_up_nothing_and_not_even_the_end(bus, monkeypatch, caplog):
    monkeypatch.setattr(live, "SAVE_S", 0.05)
    monkeypatch.setattr(live, "SAVE_LAST_S", 0.3)
    engine, tries, answers = TickEngine(), [], threading.Event()
    gateway = Gateway(engine, bus.port, save=lambda state: tries.append(state) or answers.wait())
    begun = time.monotonic()
    run(gateway, traffic(bus), until=lambda: gateway.tally.saves_failed >= 3 and len(engine.ticks) >= 3)
    assert len(tries) == 1  # none queues up behind the one that hangs
    assert "the disk has not answered for" in gateway.tally.save_problem
    assert "the state is not saved at the end: the disk has not answered for 0.3 s" in caplog.text
    assert time.monotonic() - begun < PATIENCE_S
    assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)
    answers.set()


def test_a_disk_that_answers_again_is_saved_to_again(bus, monkeypatch):
    monkeypatch.setattr(live, "SAVE_S", 0.05)
    answers = threading.Event()
    gateway = Gateway(TickEngine(), bus.port, save=lambda _: answers.wait() and None)
    begun = time.monotonic()

    async def mend():
        await come(lambda: gateway.tally.saves_failed)
        assert gateway.tally.saved_s < begun + PATIENCE_S
        answers.set()

    run(gateway, mend(), until=lambda: gateway.tally.saves >= 2)
    assert gateway.tally.save_problem == ""
    assert gateway.tally.saved_s > begun


def test_a_reload_that_has_not_ended_when_the_service_ends_takes_no_engine_any_more(bus):
    """The loop goes on while the last state is saved; the engine that is saved is the last one."""
    old, new, saved, reads, read = TickEngine(), TickEngine(), [], threading.Event(), threading.Event()

    async def reload():
        reads.set()
        while not read.is_set():
            await asyncio.sleep(0.01)
        return new

    def save(state):
        read.set()
        time.sleep(0.3)
        saved.append(state)

    async def hup():
        os.kill(os.getpid(), signal.SIGHUP)

    gateway = Gateway(old, bus.port, reload=reload, save=save)
    run(gateway, hup(), until=reads.is_set)
    assert len(saved) == 1
    assert gateway.engine is old
    assert gateway.tally.reloads == 0
