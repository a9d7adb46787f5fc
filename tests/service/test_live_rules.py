"""The loop of the live service: what is drained, handled, sent and counted, each at its very instant."""

import asyncio
import dataclasses
import logging

import pytest

from bms_gateway.bus.port import Link
from bms_gateway.engine.engine import LATEST_NS
from bms_gateway.engine.events import Alerted, Estimated, Level, Notice, StartJob
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.service import live, turns
from bms_gateway.service.turns import pause
from tests.support.live_world import BASE_NS, Engine, at, frames_at
from tests.support.virtual_time import VirtualLoop


def test_the_bounds():
    assert (turns.DRAIN_S, turns.SETTLE_NS, turns.ROUNDING_S) == (0.01, 2_000_000, 0.0002)
    assert live.OVERDUE_NS == 2_000_000_000
    assert (live.SAVE_S, live.SAVE_LAST_S, live.END_S, live.HASTE) == (60.0, 2.0, 1.0, 0.25)
    assert (live.FEEDS, live.STATUS_S, live.LOOK_S, live.PATIENCE_S) == (3, 10.0, 0.5, 30)


# frames in


def test_a_silent_bus_is_waited_for_and_traffic_is_drained_as_often_as_frames_may_gather(world):
    engine, port = Engine(), world.port()
    port.counters.dropped = 3
    gateway = world.gateway(engine, port)
    arrivals = [(when, port.arrive) for when in (0.2, 0.205, 0.25, 0.6)]
    left = world.play(gateway, *arrivals, then=lambda: asyncio.get_running_loop().remove_reader(port.fileno()))
    # the first frame after a silence waits 10 ms; then each 0.1 s until one brings nothing
    assert port.drains == [0, 210_000, 310_000, 410_000, 610_000, 710_000]
    assert engine.did == [
        (210_000, "frames", 2, 210_000_000),
        (310_000, "frames", 1, 310_000_000),
        (610_000, "frames", 1, 610_000_000),
    ]
    assert engine.dropped == 3
    assert not left  # after its end it waits for the port no more


def test_a_port_without_a_descriptor_is_polled(world):
    port = world.port(descriptor=False)
    world.play(world.gateway(port=port), seconds=0.35)
    assert port.drains == [0, 100_000, 200_000, 300_000]


def test_the_first_descriptor_of_a_process_is_waited_for_too(world, monkeypatch):
    """A service that was started without a standard input gets it for its bus."""
    port, waited = world.port(), []
    port.descriptor = 0
    monkeypatch.setattr(VirtualLoop, "add_reader", lambda self, fileno, call: waited.append(fileno))
    monkeypatch.setattr(VirtualLoop, "remove_reader", lambda self, fileno: waited.remove(fileno))
    world.play(world.gateway(port=port), (0.2, lambda: waited.append(len(waited))), seconds=0.35)
    assert (port.drains, waited) == ([0], [1])


def test_frames_gather_up_to_the_last_moments_before_a_deadline():
    assert pause(0.1, 0.01) == 0.1
    assert pause(0.1, 0.05) == pytest.approx(0.04)
    assert (pause(0.1, 0.5), pause(0.1, None), pause(0.1, -1.0)) == (0.1, 0.1, 0.1)


# deadlines


def test_a_deadline_is_handled_two_milliseconds_after_it_and_the_next_one_too(world):
    engine, port = Engine(0.3, 0.5), world.port()
    world.play(world.gateway(engine, port))
    assert engine.did == [(302_200, "timer", 300_200_000), (502_200, "timer", 500_200_000)]
    assert port.drains == [0, 302_200, 502_200]


def test_the_last_drain_before_a_deadline_comes_ten_milliseconds_before_it(world):
    engine, port = Engine(0.25), world.port(descriptor=False)
    world.play(world.gateway(engine, port), seconds=0.4)
    assert port.drains == [0, 100_000, 200_000, 240_000, 252_200, 340_000]


@pytest.mark.parametrize(("after_ns", "handled"), [(1_999_999, 0), (2_000_000, 1)])
def test_a_deadline_is_handled_as_soon_as_it_has_settled(world, after_ns, handled):
    engine, port = Engine(0.0), world.port()
    port.now_ns = lambda: BASE_NS + after_ns
    world.play(world.gateway(engine, port), seconds=0.0001)
    assert [what for _, what, *_ in engine.did] == ["timer"] * handled


def test_a_timer_whose_drain_left_something_comes_again(world):
    engine, port = Engine(0.3), world.port()
    port.emptied = False
    world.play(world.gateway(engine, port), (0.3025, lambda: setattr(port, "emptied", True)))
    assert engine.did == [(302_600, "timer", 300_600_000)]
    assert port.drains == [0, 302_200, 302_400, 302_600]


@pytest.mark.parametrize(("moved", "then"), [([0.26], [262_200]), ([], [])])
def test_a_deadline_that_frames_have_moved_is_not_waited_for_any_more(world, moved, then):
    engine, port = Engine(0.3), world.port()
    engine.on_frames = lambda: (engine.deadlines.clear(), engine.deadlines.extend(at(d) for d in moved))
    world.play(world.gateway(engine, port), (0.1, port.arrive))
    assert [when for when, what, *_ in engine.did if what == "timer"] == then
    assert [when for when in port.drains if when > 220_000] == then


# events out


def estimated_at(seconds):
    return Estimated(at(seconds), **{f.name: None for f in dataclasses.fields(Estimated) if f.name != "time_ns"})


def test_all_that_the_engine_says_is_carried_out_in_order(world, caplog):
    seen, changes, engine, port = [], [], Engine(), world.port()
    gateway = world.gateway(engine, port, watch=seen.append)
    gateway.on_alert = changes.append
    change = Change(Condition("sensor", Severity.ALARM, "60 °C", "s1", 4), True)
    job = StartJob(at(0.0), 7, LATEST_NS, None)
    notices = [Notice(at(0.0), Level.WARNING, code, f"text {code}") for code in ("awake", "clock", "clock")]
    events = [job, frames_at(0.0), *notices, Alerted(at(0.0), change), frames_at(0.0)]
    engine.queue.extend(events)
    with caplog.at_level(logging.INFO):
        world.play(gateway)
    assert seen == events[1:]
    assert gateway.fits.started == [(engine, job)]
    assert port.sent == [events[1].batch, events[-1].batch]
    assert changes == [change]
    assert (gateway.tally.notices, gateway.tally.wakes) == ({"awake": 1, "clock": 2}, 1)
    assert caplog.messages == ["text awake", "text clock", "text clock"]


def test_each_tick_counts_once_with_the_time_from_its_end(world):
    engine = Engine()
    gateway = world.gateway(engine)
    notice = Notice(at(0.9), Level.WARNING, "x", "text")

    def put(*events):
        engine.queue.extend(events)
        gateway.put_out()

    now = gateway.tally
    found = []
    world.play(
        gateway,
        (0.5, lambda: (put(estimated_at(0.25), frames_at(0.25)), found.append((now.ticks, now.lateness.total)))),
        (0.6, lambda: (put(frames_at(0.25), estimated_at(0.2), notice), found.append((now.ticks, now.lateness.total)))),
        (0.7, lambda: (put(frames_at(0.7)), put(frames_at(0.8)), found.append((now.ticks, now.lateness.total)))),
        seconds=0.9,
    )
    assert found == [(1, 0.25), (1, 0.25), (3, 0.25)]


def test_frames_are_pumped_at_once_unless_the_sender_waits_for_its_turn(world):
    engine, port = Engine(), world.port()
    gateway = world.gateway(engine, port)

    def send(*events):
        engine.queue.extend(events)
        gateway.put_out()

    world.play(
        gateway,
        (0.2, lambda: send(frames_at(0.0), frames_at(0.0))),
        (0.3, lambda: send(Notice(at(0.0), Level.INFO, "x", "text"))),
        (0.4, lambda: (setattr(port, "waits", 0.15), send(frames_at(0.0)))),
        (0.45, lambda: (send(frames_at(0.0)), setattr(port, "waits", None))),
    )
    assert port.pumps == [0, 200_000, 400_000, 550_000]


def test_a_bus_that_is_away_is_looked_for_at_each_drain_unless_its_turn_is_set(world):
    port = world.port(descriptor=False)
    port.link = Link.BUS_OFF
    world.play(
        world.gateway(port=port),
        (0.15, lambda: setattr(port, "waits", 0.25)),
        (0.42, lambda: setattr(port, "link", Link.UP)),
        (0.42, lambda: setattr(port, "waits", None)),
        seconds=0.7,
    )
    assert port.pumps == [0, 0, 100_000, 200_000, 450_000]
