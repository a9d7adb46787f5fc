"""The live page's pictures are what the engine said, tick for tick; looking back or ahead changes none of it."""

import json
import socket

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.bus.traffic import Traffic
from bms_gateway.bus.virtual import VirtualPack
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.errors import UsageError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.workbench import kept_ticks
from bms_gateway.workbench import live_estimates as watching
from bms_gateway.workbench.live_estimates import Watch
from bms_gateway.workbench.sources import Listening, Playback
from tests.workbench.browser import come

SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def loaded():
    return load_config(shipped("deploy/example/gateway.toml"))


@pytest.fixture(scope="module")
def log(loaded, tmp_path_factory):
    """A minute of traffic of sixty cells."""
    path = tmp_path_factory.mktemp("log") / "drive.log"
    pack = VirtualPack(loaded.plan, 3)
    traffic = Traffic(loaded.plan, loaded.database, noise_K=0.05, seed=3)
    parts = [
        traffic.between([s.series for s in segments], int(segments[0].time_s[0]) * SECOND, 60 * SECOND)
        for segments in pack.segments(60.0)
    ]
    write_log(path, parts)
    return path


def play(loaded, log, **how):
    engine = Engine(loaded.plan, loaded.database)
    source = Playback([log])
    watch = Watch(engine, "log", log.name, 500e3, source.traffic)
    for name, value in how.items():
        setattr(watch, name, value)
    source.start(engine, watch)
    come(lambda: watch.whole, "the end of the log")
    return watch


def picture(watch, **wish):
    view = "test"
    watch.steer(view, {"play": False, **wish})
    return json.loads(next(watch.stream(view)))


@pytest.fixture(scope="module")
def watch(loaded, log):
    return play(loaded, log)


@pytest.fixture(scope="module")
def said(loaded, log):
    """What the engine says of the log as `analyze` runs it."""
    events = drive(Engine(loaded.plan, loaded.database), read_log(log))
    return [s for e in events if isinstance(e, Estimated) for s in e.strings()]


def test_each_picture_is_what_the_engine_said_at_that_tick(watch, said):
    strings = [s["name"] for s in watch.about()["strings"]]
    first = said[0].time_ns
    for seconds in (0, 7, 31, 55, 20):  # back again too
        shown = picture(watch, seek=seconds)
        for name, s in zip(strings, shown["strings"], strict=True):
            e = next(e for e in said if e.string == name and e.time_ns == first + seconds * SECOND)
            np.testing.assert_allclose(np.array(s["core"], float), e.core, atol=0.006)
            np.testing.assert_allclose(np.array(s["half"], float), 1.96 * e.core_sd, atol=0.006)
            assert s["quality"] == e.quality.tolist()
            np.testing.assert_allclose(np.array(s["centre"], float), e.centre, atol=0.006)
            np.testing.assert_allclose(np.array(s["centre_half"], float), 1.96 * e.centre_sd, atol=0.006)
            assert s["hottest"] == (int(np.nanargmax(e.centre)) if np.isfinite(e.centre).any() else None)


def test_the_load_of_the_bus_is_counted_from_the_frames(watch, log):
    frames = FrameBatch.concat(list(read_log(log)))
    bits = int(np.where(frames.can_id >= 0x8000_0000, 67, 47).sum() + 8 * frames.length.sum())
    shown = picture(watch, seek=40)["bus"]
    assert shown["load"] == pytest.approx(100.0 * bits / 60.0 / 500e3, rel=0.05)
    assert shown["per_s"] == pytest.approx(len(frames) / 60.0, rel=0.05)


def test_a_log_is_played_at_its_speed_and_stops_at_its_end(watch, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(watching.time, "monotonic", lambda: now[0])
    watch.steer("other", {"seek": 10, "speed": 5, "play": True})
    for wall, at in ((102.0, 20.0), (104.0, 30.0), (200.0, 58.0)):
        now[0] = wall
        shown = json.loads(next(watch.stream("other")))
        assert shown["at"] == pytest.approx(min(at, shown["last"]))
    watch.steer("other", {"seek": 5})
    now[0] = 201.0
    assert json.loads(next(watch.stream("other")))["at"] == pytest.approx(10.0)


def test_two_tabs_look_at_their_own_moment(watch):
    watch.steer("one", {"seek": 3, "play": False})
    watch.steer("two", {"seek": 50, "play": False})
    assert json.loads(next(watch.stream("one")))["at"] == 3.0
    assert json.loads(next(watch.stream("two")))["at"] == 50.0


def test_nothing_is_sent_twice(watch):
    watch.steer("still", {"seek": 3, "play": False})
    stream = watch.stream("still")
    assert next(stream)
    assert next(stream) == ""


@pytest.mark.parametrize("wish", [{"speed": 3}, {"seek": "x"}, {"seek": float("nan")}, {"seek": True}])
def test_a_wish_that_makes_no_sense_is_one_line(watch, wish):
    with pytest.raises(UsageError):
        watch.steer("test", wish)


def test_a_long_log_is_thinned_evenly(loaded, log, monkeypatch):
    monkeypatch.setattr(kept_ticks, "MOST_TICKS", 20)
    watch = play(loaded, log)
    times = np.diff(watch.ticks.times_ns)
    assert len(watch.ticks.times_ns) <= 20
    assert set(times.tolist()) == {4 * SECOND}


def test_a_log_that_is_none_is_told_on_the_page(loaded, tmp_path):
    bad = tmp_path / "bad.log"
    bad.write_text("nothing\n" * 30)
    watch = play(loaded, bad)
    told = json.loads(next(watch.stream("x")))
    assert told["ticks"] == 0
    assert "bad.log" in told["problem"]


def test_the_port_only_listens(loaded):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, theirs:
        port = Listening(SocketCanPort.over(ours))
        port.send(
            FrameBatch(np.array([1]), np.array([0x123], np.uint32), np.array([8], np.uint8), np.zeros((1, 8), np.uint8))
        )
        port.pump()
        theirs.setblocking(False)
        with pytest.raises(BlockingIOError):
            theirs.recv(100)
        theirs.send(bytes.fromhex("23010000 08000000 0102030405060708"))
        come(lambda: len(port.drain()), "the frame")
        assert port.traffic() == {"received": 1, "dropped": 0, "bits": 47 + 64, "link": "up"}
        port.close()
