"""Fits, saves and what waits for a broker, by their own rules: with a worker whose tasks end when a test says so."""

import asyncio
import logging
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.errors import StateError
from bms_gateway.service import fits as fits_module
from bms_gateway.service import saves as saves_module
from bms_gateway.service import spool as spool_module
from bms_gateway.service.fit_process import NotDone
from bms_gateway.service.fits import Fits
from bms_gateway.service.saves import Saves
from bms_gateway.service.spool import KINDS, Message, Spool
from bms_gateway.service.tally import Tally


class Loop:
    """As far as it is asked: a clock, and calls that come later."""

    def __init__(self):
        self.now_s, self.later = 0.0, []

    def time(self):
        return self.now_s

    def call_later(self, delay_s, call, *args):
        self.later.append((delay_s, lambda: call(*args)))


class Task:
    """A future that a test ends."""

    def __init__(self, work, loop):
        self.work, self._loop, self._calls, self._over = work, loop, [], ""
        self._result, self._error = None, None

    def add_done_callback(self, call):
        self._calls.append(call)

    def get_loop(self):
        return self._loop

    def done(self):
        return bool(self._over)

    def cancelled(self):
        return self._over == "cancelled"

    def result(self):
        return self._result

    def exception(self):
        return self._error

    def end(self, result=None, error=None, over="done"):
        self._result, self._error, self._over = result, error, over
        for call in self._calls:
            call(self)


class Worker:
    made = ()

    def __init__(self, name, loop):
        self.name, self.closed, self.tasks, self._loop = name, False, [], loop

    def submit(self, work):
        assert not self.closed
        self.tasks.append(Task(work, self._loop))
        return self.tasks[-1]

    def close(self):
        self.closed = True


@pytest.fixture
def loop(monkeypatch):
    loop = Loop()
    loop.workers = []

    def worker(name):
        loop.workers.append(Worker(name, loop))
        return loop.workers[-1]

    for module in (fits_module, saves_module):
        monkeypatch.setattr(module, "Worker", worker)
    monkeypatch.setattr(asyncio, "get_running_loop", lambda: loop)
    return loop


class Engine:
    def __init__(self):
        self.finished = []

    def finish(self, job_id, result):
        self.finished.append((job_id, result))


def fitting(loop):
    service = SimpleNamespace(
        engine=Engine(), stopping=False, tally=Tally(), port=SimpleNamespace(now_ns=lambda: service.now_ns), now_ns=0
    )
    ended = []
    fits = Fits(service, lambda job: f"fit of {job}", lambda: ended.append(True))
    return service, fits, loop.workers[-1], ended


EVENT = SimpleNamespace(job="a window", job_id=7, due_ns=1000)


@pytest.mark.parametrize(("now_ns", "late"), [(999, 0), (1000, 0), (1001, 1)])
def test_a_fit_goes_to_the_engine_that_asked_and_counts_as_late_after_its_time(loop, now_ns, late):
    service, fits, worker, _ = fitting(loop)
    fits.start(service.engine, EVENT)
    (task,) = worker.tasks
    assert (worker.name, task.work()) == ("fits", "fit of a window")
    service.now_ns = now_ns
    service.tally.fit_problems = {7: "hung", 8: "another"}
    task.end(result="found")
    assert service.engine.finished == [(7, "found")]
    tally = service.tally
    assert (tally.jobs, tally.jobs_late, tally.jobs_failed, tally.fit_problems) == (1, late, 0, {8: "another"})
    assert loop.later == []


def test_a_fit_that_comes_to_nothing_is_tried_again_after_one_two_four_and_at_most_fifteen_minutes(loop, caplog):
    service, fits, worker, _ = fitting(loop)
    fits.start(service.engine, EVENT)
    for k, delay_s in enumerate((60.0, 120.0, 240.0, 480.0, 900.0, 900.0), 1):
        worker.tasks[-1].end(result=NotDone(f"hung {k}"))
        assert (service.tally.jobs_failed, service.tally.fit_problems) == (k, {7: f"hung {k}"})
        assert caplog.messages[-1] == f"a fit was not made: hung {k}; next try in {delay_s:g} s"
        assert caplog.records[-1].code == "fit"
        ((told_s, again),) = loop.later
        assert told_s == delay_s
        loop.later.clear()
        again()
        assert len(worker.tasks) == k + 1
    worker.tasks[-1].end(result="found")
    assert (service.engine.finished, service.tally.fit_problems, service.tally.jobs) == ([(7, "found")], {}, 1)


@pytest.mark.parametrize("why", ["stopping", "reloaded"])
@pytest.mark.parametrize("when", ["before", "while", "waiting"])
def test_nothing_more_is_tried_for_a_service_that_stops_or_an_engine_that_was_replaced(loop, why, when):
    service, fits, worker, _ = fitting(loop)
    mine = service.engine

    def change():
        if why == "stopping":
            service.stopping = True
        else:
            service.engine = Engine()

    if when == "before":
        change()
    fits.start(mine, EVENT)
    if when == "before":
        assert worker.tasks == []
        return
    if when == "while":
        change()
    worker.tasks[0].end(result=NotDone("hung"))
    if when == "while":
        assert (loop.later, service.tally.jobs_failed, service.tally.fit_problems) == ([], 0, {})
        return
    change()
    loop.later[0][1]()
    assert len(worker.tasks) == 1


def test_the_result_of_a_fit_goes_to_its_own_engine_after_a_reload_and_to_none_after_the_end(loop):
    service, fits, worker, _ = fitting(loop)
    mine = service.engine
    for _ in range(3):
        fits.start(mine, EVENT)
    service.engine = Engine()
    worker.tasks[0].end(result="found")
    assert (mine.finished, service.engine.finished) == ([(7, "found")], [])
    worker.tasks[1].end(over="cancelled")
    service.stopping = True
    worker.tasks[2].end(result="found")
    assert mine.finished == [(7, "found")]


def test_the_end_of_fits_closes_their_thread_and_ends_their_process(loop):
    _, fits, worker, ended = fitting(loop)
    fits.close()
    assert (worker.closed, ended) == (True, [True])


def saving(loop):
    tally, saved = Tally(), []
    saves = Saves(saved.append, lambda: {"at": loop.now_s}, tally)
    return saves, tally, loop.workers[-1], saved


def test_a_save_takes_the_state_of_its_beginning_and_counts_from_then(loop, caplog):
    saves, tally, worker, saved = saving(loop)
    loop.now_s = 100.0
    saves.begin()
    loop.now_s = 130.0
    worker.tasks[0].work()
    tally.save_problem = "full"
    worker.tasks[0].end()
    assert saved == [{"at": 100.0}]
    assert worker.name == "saves"
    assert (tally.saves, tally.saved_s, tally.save_problem, tally.saves_failed) == (1, 100.0, "", 0)
    assert caplog.messages == []
    loop.now_s = 160.0
    saves.begin()
    worker.tasks[1].end()
    assert (tally.saves, tally.saved_s) == (2, 160.0)


def test_behind_a_disk_that_does_not_answer_no_second_save_waits_and_each_is_told_with_the_time(loop, caplog):
    saves, tally, worker, _ = saving(loop)
    loop.now_s = 100.0
    saves.begin()
    for k, now_s in enumerate((160.0, 220.0), 1):
        loop.now_s = now_s
        saves.begin()
        why = f"the disk has not answered for {now_s - 100.0:.0f} s"
        assert (tally.saves_failed, tally.save_problem, caplog.messages[-1]) == (k, why, why)
        assert caplog.records[-1].code == "save"
    assert len(worker.tasks) == 1
    worker.tasks[0].end()
    assert (tally.saves, tally.saved_s, tally.save_problem) == (1, 100.0, "")
    saves.begin()
    assert len(worker.tasks) == 2


@pytest.mark.parametrize("error", [StateError("/x: full"), OSError(28, "full")])
def test_a_save_that_fails_is_told_and_leaves_the_age_of_the_state(loop, caplog, error):
    saves, tally, worker, _ = saving(loop)
    saves.begin()
    worker.tasks[0].end(error=error)
    assert (tally.saves, tally.saved_s, tally.saves_failed, tally.save_problem) == (0, None, 1, str(error))
    assert caplog.messages == [str(error)]


def test_a_save_that_was_cancelled_is_none_and_a_bug_in_it_is_no_failure_of_the_disk(loop):
    saves, tally, worker, _ = saving(loop)
    saves.begin()
    worker.tasks[0].end(over="cancelled")
    saves.begin()
    with pytest.raises(KeyError):
        worker.tasks[1].end(error=KeyError("a bug"))
    assert (tally.saves, tally.saves_failed) == (0, 0)


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (None, []),
        (StateError("/x: full"), ["/x: full"]),
        (TimeoutError(), ["the state is not saved at the end: the disk has not answered for 2 s"]),
    ],
)
def test_the_last_save_waits_no_longer_than_it_may_and_says_what_became_of_it(monkeypatch, caplog, error, says):
    asked = []

    class Given:
        def __init__(self, name):
            pass

        def submit(self, work):
            return work

    async def wait_for(work, most_s):
        asked.append(most_s)
        work()
        if error is not None:
            raise error

    monkeypatch.setattr(saves_module, "Worker", Given)
    monkeypatch.setattr(saves_module.asyncio, "wait_for", wait_for)
    saved = []
    asyncio.run(Saves(saved.append, lambda: {"a": 1}, Tally()).last(2.0))
    assert (saved, asked) == ([{"a": 1}], [2.0])
    assert caplog.messages == says
    assert {r.levelno for r in caplog.records} <= {logging.ERROR}


steps = st.lists(
    st.tuples(st.sampled_from(["put", "put", "send", "take"]), st.sampled_from(KINDS), st.integers(0, 12)), max_size=40
)


@settings(deadline=None, max_examples=200)
@given(st.integers(1, 4), st.integers(1, 25), steps)
def test_what_waits_for_a_broker_is_the_newest_of_each_kind_alerts_first(limit, most_bytes, story):
    """Against plain lists. A message is taken, sent, and only then taken out; meanwhile it may have given way."""
    with pytest.MonkeyPatch.context() as m:
        m.setattr(spool_module, "MOST_BYTES", most_bytes)
        spool, model, dropped, going = Spool(limit), {kind: [] for kind in KINDS}, dict.fromkeys(KINDS, 0), None
        for what, kind, size in story:
            if what == "put":
                message = Message("t", bytes(size))
                spool.put(kind, message)
                model[kind].append(message)
                while len(model[kind]) > limit or sum(len(x.payload) for x in model[kind]) > most_bytes:
                    del model[kind][0]
                    dropped[kind] += 1
            elif what == "take":
                going = spool.head()
                first = next(((k, model[k][0]) for k in KINDS if model[k]), None)
                assert (going is None) == (first is None)
                assert going is None or (going[0] == first[0] and going[1] is first[1])
            elif going is not None:
                spool.sent(*going)
                model[going[0]] = [x for x in model[going[0]] if x is not going[1]]
                going = None
            assert {k: spool.waiting(k) for k in KINDS} == {k: len(model[k]) for k in KINDS}
            assert spool.dropped == dropped


def test_a_spool_holds_four_mebibytes_of_a_kind():
    assert spool_module.MOST_BYTES == 4_194_304
