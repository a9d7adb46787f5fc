"""The watch's own rules, on counters and clocks alone: what it calls wrong, when, and how it tells."""

import asyncio
import logging
import time
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_gateway.bus.port import Counters, Link
from bms_gateway.health.alerts import Alerts, AlertSettings, Change, Condition, Severity
from bms_gateway.service import watch as module
from bms_gateway.service.journal import NOTICE
from bms_gateway.service.tally import Tally
from bms_gateway.service.watch import EVENT_S, OLD_S, PERIOD_S, Watch


class Bare:
    """A watch over counters that a test sets; its engine raises what `also` holds."""

    def __init__(self, **times):
        self.also = Alerts(grace_s=0.0, hold_s=0.0)
        self.port = SimpleNamespace(link=Link.UP, counters=Counters())
        self.tally = Tally()
        self.gateway = SimpleNamespace(port=self.port, tally=self.tally, unread=lambda: "", on_alert=None)
        engine = SimpleNamespace(alerts=self.also)
        self.watch = Watch(self.gateway, lambda: engine, channel="can7", settings=AlertSettings(**times))
        self.begun = []
        begin = self.watch.alerts.begin
        self.watch.alerts.begin = lambda now_s: (self.begun.append(now_s), begin(now_s))

    def texts(self, now_s):
        return {c.name: c.text for c in self.watch.conditions(now_s)}


steps = st.lists(
    st.tuples(st.sampled_from([0.5, 1.0, 29.0, 59.0, 60.0, 61.0]), st.integers(0, 2), st.integers(0, 2)), max_size=12
)


@settings(deadline=None)
@given(steps)
def test_frames_lost_or_foreign_stay_told_for_a_minute_after_the_last_and_their_number_is_of_one_spell(story):
    bare, now = Bare(), 1000.0
    last = {"dropped": float("-inf"), "impostors": float("-inf")}
    spell = dict.fromkeys(last, 0)
    names = {"dropped": "loss", "impostors": "impostor"}
    for pause_s, dropped, impostors in story:
        now += pause_s
        for counter, more in (("dropped", dropped), ("impostors", impostors)):
            setattr(bare.port.counters, counter, getattr(bare.port.counters, counter) + more)
            if now - last[counter] >= 60.0:
                spell[counter] = 0
            if more:
                spell[counter] += more
                last[counter] = now
        found = {c.name: c for c in bare.watch.conditions(now)}
        assert set(found) == {names[counter] for counter in last if spell[counter]}
        for counter, name in names.items():
            if name in found:
                frames = "frame" if spell[counter] == 1 else "frames"
                assert found[name].text.startswith(f"{spell[counter]} {frames} ")
                assert found[name].settled  # told at once, though it lasts no time
    assert EVENT_S == 60.0


def test_a_state_is_old_after_two_and_a_half_minutes_and_its_age_is_told_only_then():
    bare = Bare()
    assert bare.texts(10_000.0) == {}  # no state is kept: none is old
    bare.tally.saved_s = 1000.0
    assert bare.texts(1000.0 + 150.0) == {}
    old = bare.texts(1000.0 + 150.5)["state"]
    assert old == (
        "nothing has been saved (the state on disk is 3 min old); repair this, or the learnt state is lost at the "
        "next stop"
    )
    bare.tally.save_problem = "the disk is full"
    assert bare.texts(1000.0 + 150.0)["state"].startswith("the disk is full; repair this")
    assert bare.texts(1000.0 + 150.5)["state"].startswith("the disk is full (the state on disk is 3 min old); ")
    assert OLD_S == 150.0


@pytest.mark.parametrize(("waiting", "says"), [(1, ": hung; it is"), (2, ": hung (2 fits wait); it is")])
def test_fits_that_wait_are_counted_from_the_second_on(waiting, says):
    bare = Bare()
    bare.tally.fit_problems = dict.fromkeys(range(waiting), "hung")
    assert says in bare.texts(0.0)["fit"]


def test_parts_and_states_are_told_apart():
    """Two parts that fail are two alerts, and a state that was kept unread is another one than a state not saved."""
    bare = Bare()
    bare.tally.failed_parts = {"mqtt": "KeyError", "metrics": "ValueError"}
    bare.tally.save_problem = "the disk is full"
    bare.gateway.unread = lambda: "a state was kept"
    found = list(bare.watch.conditions(0.0))
    assert len({c.key for c in found}) == len(found) == 4
    assert [c.text for c in found if c.settled] == ["a state was kept"]
    assert {c.severity for c in found} == {Severity.WARNING}


def test_it_looks_at_once_and_then_once_a_second_from_a_grace_time_on(monkeypatch):
    bare, looked, slept = Bare(), [], []

    async def sleep(seconds):
        slept.append(seconds)
        if len(slept) == 3:
            raise asyncio.CancelledError

    monkeypatch.setattr(module.asyncio, "sleep", sleep)
    monkeypatch.setattr(bare.watch, "look", looked.append)
    before = time.monotonic()
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(bare.watch.run())
    assert slept == [1.0, 1.0, 1.0]
    (begun,) = bare.begun
    assert before <= begun <= looked[0] <= looked[1] <= looked[2] <= time.monotonic()
    assert PERIOD_S == 1.0


@pytest.mark.parametrize(("asleep_s", "grace"), [(0.0, False), (1.0, False), (1.25, True), (3600.0, True)])
def test_only_a_computer_that_slept_longer_than_a_look_takes_gets_a_new_grace_time(monkeypatch, asleep_s, grace):
    bare, clock = Bare(), [50.0]
    monkeypatch.setattr(module, "slept_s", lambda: clock[0])
    bare.watch.look(1.0)
    bare.begun.clear()
    clock[0] += asleep_s
    bare.watch.look(2.0)
    bare.watch.look(3.0)
    assert bare.begun == ([2.0] if grace else [])


def test_how_long_the_computer_slept_is_what_the_clock_that_stands_still_lacks(monkeypatch):
    clocks = {time.CLOCK_BOOTTIME: 5000.0, time.CLOCK_MONOTONIC: 1400.0}
    monkeypatch.setattr(module.time, "clock_gettime", clocks.__getitem__)
    assert module.slept_s() == 3600.0


def test_a_grace_time_begins_when_the_bus_is_back_and_after_each_pause_and_not_before():
    bare = Bare()
    bare.watch.look(0.0)
    assert bare.begun == []
    for now, link in enumerate((Link.DOWN, Link.ABSENT, Link.UP, Link.UP), 1):
        bare.port.link = link
        bare.watch.look(float(now))
    assert bare.begun == [3.0]
    bare.tally.wakes += 1
    bare.watch.look(5.0)
    bare.watch.look(6.0)
    assert bare.begun == [3.0, 5.0]


@pytest.mark.parametrize(
    ("severity", "level"), [(Severity.WARNING, logging.WARNING), (Severity.ALARM, logging.CRITICAL)]
)
def test_a_line_of_the_journal_has_level_string_and_cell_and_listeners_hear_each_change(caplog, severity, level):
    bare, heard = Bare(), []
    bare.watch.listeners += [heard.append, heard.append]
    condition = Condition("core", severity, "cell 3 is hot", string="s1", cell=3)
    over, raised = Change(condition, raised=False), Change(condition, raised=True)
    with caplog.at_level(1, logger="bms_gateway"):
        bare.gateway.on_alert(raised)
        bare.gateway.on_alert(over)
    assert heard == [raised, raised, over, over]
    first, second = caplog.records
    assert (first.levelno, first.getMessage()) == (level, f"{severity.name}: cell 3 is hot [s1]")
    assert (second.levelno, second.getMessage()) == (NOTICE, "over: cell 3 is hot [s1]")
    for record in (first, second):
        assert (record.code, record.kind, record.string, record.cell) == ("alert-core", "alert-core s1", "s1", 3)


def test_a_line_without_a_string_names_none(caplog):
    bare = Bare(grace_s=0.0)
    bare.port.counters.impostors = 2
    with caplog.at_level(1, logger="bms_gateway"):
        bare.watch.look(1.0)
    assert caplog.messages == ["ALARM: 2 frames with identifiers of this node came from another sender: find it"]


def test_alerts_that_the_engine_raises_count_in_the_line_and_are_not_told_again():
    bare = Bare()
    bare.also.update(0.0, [Condition("core", Severity.ALARM, "cell 3 is hot", string="s1")])
    bare.watch.listeners.append(pytest.fail)
    bare.watch.look(20.0)
    assert bare.watch.alerts.line == "ALARM: s1: cell 3 is hot"


@pytest.mark.parametrize("which", ["grace_s", "hold_s", "clear_s"])
def test_its_times_are_those_of_the_configuration(which):
    assert getattr(Bare(**{which: 77.5}).watch.alerts, which) == 77.5
    defaults = Watch(Bare().gateway, lambda: None, channel="can7").alerts
    assert getattr(defaults, which) == getattr(AlertSettings(), which)
