"""The live service from its start to its end: systemd, saves, signals, bugs and reloads, each at its very instant."""

import asyncio
import logging
import signal
from types import SimpleNamespace

import pytest

from bms_gateway.bus.port import Link
from bms_gateway.errors import ConfigError
from bms_gateway.service import live
from tests.support.live_world import Engine, Signals
from tests.support.virtual_time import START_S, micros

# systemd


def test_ready_is_told_once_the_bus_is_open_and_the_status_every_ten_seconds(world):
    port = world.port()
    port.link = Link.ABSENT
    port.counters.received, port.counters.sent, port.counters.dropped = 1, 2, 3
    gateway = world.gateway(port=port)
    lines = ["", "OK"]
    gateway.summary = lambda: lines.pop(0)
    world.play(
        gateway,
        (0.6, gateway.tell_status),
        (0.7, lambda: setattr(port, "link", Link.DOWN)),
        (1.2, lambda: setattr(port, "link", Link.UP)),
        seconds=12.0,
    )
    patience, counts = "EXTEND_TIMEOUT_USEC=30000000", "bus up; 1 frames in, 2 out, 3 lost"
    assert world.told == [
        (0, patience, "STATUS=waiting: bus absent"),
        (500_000, patience, "STATUS=waiting: bus absent"),
        (1_000_000, patience, "STATUS=waiting: bus down"),
        (1_500_000, "READY=1", f"STATUS={counts}"),
        (10_000_000, f"STATUS=OK; {counts}"),
        (12_000_000, "STOPPING=1", "STATUS=saving state"),
    ]


def test_a_bus_that_is_off_is_open(world):
    port = world.port()
    port.link = Link.BUS_OFF
    world.play(world.gateway(port=port))
    assert world.times("READY=1") == [0]


@pytest.mark.parametrize("descriptor", [True, False])
def test_the_watchdog_is_fed_three_times_in_its_time(world, descriptor):
    world.watchdog_s = 3.0
    world.play(world.gateway(Engine(100.0), world.port(descriptor=descriptor)), seconds=4.5)
    assert world.times("WATCHDOG=1") == [1_000_000, 2_000_000, 3_000_000, 4_000_000]


def test_no_watchdog_is_fed_where_there_is_none(world):
    world.play(world.gateway(), seconds=100.0)
    assert world.times("WATCHDOG=1") == []


@pytest.mark.parametrize(("when", "fed"), [(0.0, []), (1.5, [1_000_000, 2_000_000])])
def test_the_watchdog_is_not_fed_when_nothing_drains_any_more(world, caplog, when, fed):
    world.watchdog_s = 3.0
    gateway = world.gateway(port=world.port(descriptor=False))
    if when == 0.0:
        gateway.turns.begin = lambda: None
    world.play(gateway, (when, lambda: setattr(gateway.turns, "begin", lambda: None)), seconds=4.5)
    assert world.times("WATCHDOG=1") == fed
    assert set(caplog.messages) == {"stalled: receiving False, estimating True, sending True"}
    assert len(caplog.messages) == 4 - len(fed)


def test_the_watchdog_is_not_fed_when_frames_that_woke_it_are_never_drained(world, caplog):
    world.watchdog_s, port = 3.0, world.port()
    gateway = world.gateway(port=port)
    world.play(gateway, (1.4, lambda: setattr(gateway.turns, "begin", lambda: None)), (1.5, port.arrive), seconds=3.5)
    assert world.times("WATCHDOG=1") == [1_000_000]
    assert caplog.messages == ["stalled: receiving False, estimating True, sending True"] * 2


def test_the_watchdog_is_not_fed_once_a_deadline_is_two_seconds_old(world, caplog):
    world.watchdog_s = 3.0
    engine = Engine(0.0)
    gateway = world.gateway(engine)
    gateway.turns.arm = lambda: None
    engine.handle_timer = lambda *, now_ns: None
    world.play(gateway, seconds=3.5)
    assert world.times("WATCHDOG=1") == [1_000_000]
    assert set(caplog.messages) == {"stalled: receiving True, estimating False, sending True"}


def test_the_watchdog_is_not_fed_once_the_turn_of_the_sender_is_two_seconds_past(world, caplog):
    world.watchdog_s = 3.0
    port = world.port()
    port.waits = 0.0
    gateway = world.gateway(port=port)
    turn = SimpleNamespace(when=lambda: START_S, cancel=lambda: None)
    port.pump = lambda: None
    world.play(gateway, (0.1, lambda: setattr(gateway, "_pump_timer", turn)), seconds=3.5)
    assert world.times("WATCHDOG=1") == [1_000_000]
    assert set(caplog.messages) == {"stalled: receiving True, estimating True, sending False"}


# saves, the end


def test_the_state_is_saved_each_minute_and_at_the_end(world):
    saved, engine = [], Engine()
    gateway = world.gateway(engine, save=saved.append)
    world.play(gateway, seconds=130.0)
    assert gateway.tally.saved_s == START_S
    assert gateway.saves.begun == [60_000_000, 120_000_000]
    assert gateway.saves.most == [2.0]
    (state,) = saved
    assert (state["of"], set(state)) == (engine, {"of", "clock"})


def test_no_state_is_saved_where_none_is_kept(world):
    gateway = world.gateway()
    world.play(gateway)
    assert (gateway.tally.saved_s, gateway.saves) == (None, None)


def test_nothing_is_done_any_more_while_the_last_state_is_saved(world):
    engine, port = Engine(0.5), world.port(descriptor=False)
    world.watchdog_s, port.waits = 0.3, 0.25
    gateway = world.gateway(engine, port, save=lambda _: None)
    world.play(gateway, seconds=0.45)
    assert port.drains == [0, 100_000, 200_000, 300_000, 400_000]
    assert (engine.did, port.pumps) == ([], [0, 250_000])
    assert world.told[-1] == (450_000, "STOPPING=1", "STATUS=saving state")
    assert gateway.fits.closed == 1
    assert gateway.stopping


def test_a_bus_that_comes_up_at_the_end_does_not_make_the_service_ready(world):
    port = world.port()
    port.link = Link.DOWN
    gateway = world.gateway(port=port, save=lambda _: None)
    world.play(gateway, (0.6, lambda: setattr(port, "link", Link.UP)), seconds=0.7)
    assert world.times("READY=1") == []


@pytest.mark.parametrize(
    ("number", "saving", "waiting_us"), [(signal.SIGTERM, 2.0, 1_000_000), (signal.SIGINT, 0.5, 250_000)]
)
def test_a_signal_ends_it_and_a_person_waits_less_long(world, number, saving, waiting_us):
    gateway, cancelled = world.gateway(save=lambda _: None), []

    async def stays():
        try:
            await asyncio.sleep(3600.0)
        except asyncio.CancelledError:
            cancelled.append(micros())
            await asyncio.sleep(0.8)  # its farewell

    gateway.beside["stays"] = stays
    end = world.play(gateway, (0.2, lambda: world.signals.actions[number]()), seconds=3600.0, then=micros)
    assert world.times("STOPPING=1") == [200_000]
    assert gateway.ended_by == number
    assert gateway.saves.most == [saving]
    assert cancelled == [1_200_000]
    assert end == 1_200_000 + min(waiting_us, 800_000)


def test_signals_are_taken_and_dropped_and_those_of_others_are_not_closed(world, monkeypatch):
    world.play(world.gateway())
    assert world.signals.did == ["take", "drop"]
    assert set(world.signals.actions) == {signal.SIGTERM, signal.SIGINT}
    made = []
    monkeypatch.setattr(live, "Signals", lambda: made.append(Signals()) or made[-1])
    world.play(world.gateway(reload=lambda: None), signals=None)
    assert [s.did for s in made] == [["take", "drop", "close"]]
    assert set(made[0].actions) == {signal.SIGTERM, signal.SIGINT, signal.SIGHUP}


@pytest.mark.parametrize(("number", "interrupted"), [(signal.SIGINT, True), (signal.SIGTERM, False), (None, False)])
def test_a_command_that_a_person_has_interrupted_says_so(world, monkeypatch, number, interrupted):
    gateway, ran = world.gateway(), []

    async def run(*, seconds, signals):
        ran.append((seconds, signals))
        gateway.ended_by = number

    monkeypatch.setattr(gateway, "run", run)
    if interrupted:
        with pytest.raises(KeyboardInterrupt):
            gateway.serve(seconds=5.0, signals=world.signals)
    else:
        gateway.serve(seconds=5.0, signals=world.signals)
    assert ran == [(5.0, world.signals)]


# bugs, what runs beside


def test_a_bug_in_the_loop_ends_it_with_the_first_one_and_saves_nothing(world):
    def fail(error):
        raise error

    gateway = world.gateway(save=lambda _: None)

    def both():
        loop = asyncio.get_running_loop()
        loop.call_soon(fail, ZeroDivisionError("first"))
        loop.call_soon(fail, ValueError("second"))

    with pytest.raises(ZeroDivisionError, match="first"):
        world.play(gateway, (0.5, both), seconds=3600.0)
    assert world.times("STOPPING=1") == [500_000]
    assert (gateway.saves.most, gateway.fits.closed) == ([], 1)


def test_a_fault_of_which_the_loop_knows_only_words_ends_it_with_these(world):
    def tell():
        asyncio.get_running_loop().call_exception_handler({"message": "no exception"})

    with pytest.raises(RuntimeError, match="no exception"):
        world.play(world.gateway(), (0.5, tell), seconds=3600.0)


def test_a_part_that_fails_is_told_and_left_off_and_the_others_go_on(world, caplog):
    gateway, did = world.gateway(), []

    async def fails():
        await asyncio.sleep(0.1)
        raise ZeroDivisionError("a bug")

    async def ends():
        did.append("ends")

    async def stays():
        try:
            await asyncio.sleep(3600.0)
        finally:
            did.append(("stays", micros()))

    gateway.beside |= {"fails": fails, "ends": ends, "stays": stays}
    world.play(gateway)
    assert did == ["ends", ("stays", 1_000_000)]
    assert gateway.tally.failed_parts == {"fails": "ZeroDivisionError: a bug"}
    assert caplog.messages == ["fails has failed and is off until a restart; estimates go on"]
    assert caplog.records[0].exc_info[0] is ZeroDivisionError


# reloads


def reloading(world, *answers, took_s=0.1, **more):
    """A gateway whose config is read again in `took_s`, with these results; and how often it was."""
    reads, left = [], list(answers)

    async def reload():
        reads.append(micros())
        await asyncio.sleep(took_s)
        answer = left.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    return world.gateway(reload=reload, **more), reads


def hup(world):
    return world.signals.actions[signal.SIGHUP]()


def test_a_reload_takes_the_new_engine_with_its_deadline(world, caplog):
    new = Engine(0.5)
    gateway, _ = reloading(world, new)
    gateway.tally.fit_problems[7] = "it hung"
    with caplog.at_level(logging.INFO):
        world.play(gateway, (0.2, lambda: hup(world)))
    assert gateway.engine is new
    assert new.did == [(502_200, "timer", 500_200_000)]
    assert (gateway.tally.reloads, gateway.tally.reloads_refused, gateway.tally.fit_problems) == (1, 0, {})
    assert [(when, lines[0]) for when, *lines in world.told] == [
        (0, "READY=1"),
        (200_000, "RELOADING"),
        (300_000, "READY=1"),
        (1_000_000, "STOPPING=1"),
    ]
    assert caplog.messages == ["reloaded"]
    assert (caplog.records[0].code, caplog.records[0].asked) == ("reload", True)  # a person has asked for it
    assert gateway.reloads.going is None  # what is over is not kept


def test_a_config_that_is_wrong_is_told_and_the_engine_stays(world, caplog):
    old = Engine()
    gateway, _ = reloading(world, ConfigError("gateway.toml: wrong"), engine=old)
    gateway.tally.fit_problems[7] = "it hung"
    world.play(gateway, (0.2, lambda: hup(world)))
    assert gateway.engine is old
    assert (gateway.tally.reloads, gateway.tally.reloads_refused) == (0, 1)
    assert gateway.tally.fit_problems == {7: "it hung"}
    assert caplog.messages == ["not reloaded, going on as before: gateway.toml: wrong"]
    assert world.times("READY=1") == [0, 300_000]


def test_what_is_asked_for_during_a_reload_is_done_once_more_behind_it(world):
    last = Engine()
    gateway, reads = reloading(world, Engine(), last, Engine())
    world.play(gateway, *((when, lambda: hup(world)) for when in (0.2, 0.22, 0.24)))
    assert reads == [200_000, 300_000]
    assert gateway.engine is last
    assert world.times("RELOADING") == reads
    assert world.times("READY=1") == [0, 400_000]


def test_a_reload_before_the_bus_is_open_does_not_make_the_service_ready(world):
    port = world.port()
    port.link = Link.ABSENT
    gateway, _ = reloading(world, Engine(), port=port)
    world.play(gateway, (0.2, lambda: hup(world)))
    assert gateway.tally.reloads == 1
    assert world.times("READY=1") == []


def test_a_bug_in_a_reload_ends_the_service_with_it(world):
    gateway, _ = reloading(world, ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError, match="a bug"):
        world.play(gateway, (0.2, lambda: hup(world)), seconds=3600.0)


@pytest.mark.parametrize("again", [False, True])
def test_a_reload_that_has_not_ended_at_the_end_is_given_up(world, again):
    old = Engine()
    gateway, reads = reloading(world, Engine(), Engine(), engine=old, took_s=0.5, save=lambda _: None)
    calls = [(0.2, lambda: hup(world))] * (1 + again)
    world.play(gateway, *calls, seconds=0.4)
    assert gateway.engine is old
    assert reads == [200_000]
    assert world.times("READY=1") == [0]


def test_a_reload_that_ends_with_the_service_makes_it_not_ready_again(world):
    async def reload():
        gateway.stop()
        return Engine()

    gateway = world.gateway(reload=reload, save=lambda _: None)
    world.play(gateway, (0.2, lambda: hup(world)), seconds=3600.0)
    assert world.times("STOPPING=1") == [200_000]
    assert world.times("READY=1") == [0]
