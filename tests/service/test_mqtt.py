"""MQTT against a real broker: what arrives, what waits, and that no frame waits for it."""

import asyncio
import gc
import json
import logging
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import tracemalloc
from contextlib import suppress

import aiomqtt
import numpy as np
import pytest

from bms_gateway.config.schema import Mqtt
from bms_gateway.errors import ConfigError
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.service import broker as module
from bms_gateway.service.live import Gateway
from bms_gateway.service.mqtt import Publisher
from bms_gateway.service.spool import Message, Spool
from bms_gateway.service.summary import estimates, status
from tests.service.broker import make_broker
from tests.service.engine import TICK_NS, TickEngine
from tests.service.mqtt_parts import certificates
from tests.service.pack import Pack
from tests.support.live_service import Bus, come, run, traffic


@pytest.fixture
def broker(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "RETRY_FIRST_S", 0.05)
    monkeypatch.setattr(module, "RETRY_MOST_S", 0.2)
    monkeypatch.setattr(module, "ANSWER_S", 2.0)
    broker = make_broker(tmp_path)
    yield broker
    broker.stop()


def publisher(broker, files=None, **settings):
    settings = {"interval_s": 3600.0, "topic": "cars/7", "spool": 10} | settings
    lines = ["OK"]
    made = Publisher(
        Mqtt(host="localhost", port=broker.port, **settings),
        files or {},
        status=lambda: lines[-1],
        estimates=lambda: {"state": "OK", "strings": {}},
    )
    made.lines = lines
    return made


def plug(k, raised=True):
    return Change(Condition("sensor", Severity.WARNING, f"plug {k} °C", "string_1", k), raised)


class Listener:
    """All that the broker has for us, in order."""

    def __init__(self, port, **options):
        self.port, self.options = port, options
        self.heard = []
        self.ready = False

    async def run(self):
        while True:
            try:
                async with aiomqtt.Client("localhost", self.port, **self.options) as client:
                    await client.subscribe("#", qos=1)
                    self.ready = True
                    async for m in client.messages:
                        self.heard.append((m.topic.value, m.payload.decode(), m.retain))
            except aiomqtt.MqttError:
                self.ready = False
                await asyncio.sleep(0.05)

    def on(self, topic):
        return [payload for t, payload, _ in self.heard if t == topic]


def beside(publisher, *tasks, listener=None):
    """Run the publisher, and a listener, beside coroutine functions one after the other; then stop it."""

    async def all_of_it():
        running = asyncio.ensure_future(publisher.run())
        listening = asyncio.ensure_future(listener.run()) if listener else None
        try:
            for task in tasks:
                await task()
        finally:
            running.cancel()
            await asyncio.wait([running])
            if listener:
                await come(lambda: "STOPPED" in listener.on("cars/7/status") or not publisher.broker.connects)
                listening.cancel()
                await asyncio.wait([listening])

    asyncio.run(all_of_it())


def test_status_alerts_and_estimates_arrive_and_the_status_is_kept_for_who_comes_later(broker):
    p, listener, late = publisher(broker, interval_s=1.0), Listener(broker.port), Listener(broker.port)

    async def happenings():
        await come(lambda: "OK" in listener.on("cars/7/status") and listener.on("cars/7/estimates"))
        p.lines.append("WARNING: string_1: plug 3 °C")
        p.on_change(plug(3))
        await come(lambda: listener.on("cars/7/alert") and p.lines[-1] in listener.on("cars/7/status"))
        task = asyncio.ensure_future(late.run())
        await come(lambda: late.heard)
        task.cancel()
        await asyncio.wait([task])

    beside(p, happenings, listener=listener)
    found = json.loads(listener.on("cars/7/alert")[0])
    assert found.pop("time") > 1e9
    assert found == {
        "raised": True,
        "severity": "WARNING",
        "alert": "sensor",
        "string": "string_1",
        "cell": 3,
        "text": "plug 3 °C",
    }
    assert json.loads(listener.on("cars/7/estimates")[0]).items() >= {"state": "OK", "strings": {}}.items()
    assert late.heard[0] == ("cars/7/status", "WARNING: string_1: plug 3 °C", True)
    assert listener.on("cars/7/status")[-1] == "STOPPED"


def test_a_process_that_is_killed_leaves_its_last_will(broker):
    code = f"""
        import asyncio
        from bms_gateway.config.schema import Mqtt
        from bms_gateway.service.mqtt import Publisher
        settings = Mqtt(host="localhost", port={broker.port}, topic="cars/7")
        asyncio.run(Publisher(settings, {{}}, status=lambda: "OK", estimates=dict).run())
    """
    listener = Listener(broker.port)

    async def happenings():
        listening = asyncio.ensure_future(listener.run())
        process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)])
        await come(lambda: "OK" in listener.on("cars/7/status"))
        process.send_signal(signal.SIGKILL)
        process.wait()
        await come(lambda: len(listener.heard) >= 2)
        listening.cancel()
        await asyncio.wait([listening])

    asyncio.run(happenings())
    assert listener.on("cars/7/status") == ["OK", "OFFLINE: the connection was lost"]


def test_what_happens_while_the_broker_is_gone_waits_bounded_and_arrives_alerts_first(broker, caplog):
    p, listener = publisher(broker), Listener(broker.port)
    caplog.set_level(logging.DEBUG, "bms_gateway.service.broker")

    connect = p.broker.client

    def when_heard():
        if not listener.ready:
            raise aiomqtt.MqttError("nobody listens yet")
        return connect()

    p.broker.client = when_heard

    async def happenings():
        await come(lambda: p.broker.connected)
        broker.stop()
        await come(lambda: not p.broker.connected and not listener.ready)
        p.lines.append("ALARM: x")
        for k in range(1, 16):
            p.put("estimate", {"k": k})
            p.on_change(plug(k))
        await come(lambda: caplog.text.count("trying again") >= 2)
        assert (p.broker.spool.waiting("alert"), p.broker.spool.waiting("estimate")) == (10, 10)
        broker.start()
        await come(lambda: len(listener.on("cars/7/estimates")) >= 10)

    beside(p, happenings, listener=listener)
    order = [t for t, _, _ in listener.heard if not t.endswith("status")]
    assert order == ["cars/7/alert"] * 10 + ["cars/7/estimates"] * 10
    assert [json.loads(a)["cell"] for a in listener.on("cars/7/alert")] == list(range(6, 16))
    assert p.broker.spool.dropped == {"alert": 5, "estimate": 5}
    assert "ALARM: x" in listener.on("cars/7/status")
    told = [r for r in caplog.records if r.levelno == logging.WARNING]
    assert len(told) <= 2, told  # told once that it is gone, however often it is tried
    assert p.broker.connects >= 2


def test_a_broker_that_hangs_or_is_gone_delays_no_frame(broker):
    bus, engine = Bus(), TickEngine()
    gateway = Gateway(engine, bus.port)
    p = publisher(broker, interval_s=1.0, spool=50)
    gateway.beside["mqtt"] = p.run
    done = []

    async def happenings():
        await come(lambda: p.broker.connected and len(engine.ticks) >= 3)
        broker.halt()
        for k in range(200):
            p.on_change(plug(k))
        at = len(engine.ticks)
        await come(lambda: not p.broker.connected and len(engine.ticks) >= at + 15)  # until the answer is overdue
        assert p.broker.spool.dropped["alert"] >= 100
        broker.go_on()
        await come(lambda: p.broker.connected and not p.broker.spool.waiting("alert"))
        broker.stop()
        at = len(engine.ticks)
        await come(lambda: not p.broker.connected and len(engine.ticks) >= at + 5)
        done.append(p.broker.published)

    run(gateway, traffic(bus, duration=60.0), happenings(), until=lambda: done)
    bus.close()
    assert done
    assert done[0] >= 50
    assert engine.late == []
    assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)
    assert gateway.tally.failed_parts == {}


def test_a_name_server_that_is_silent_holds_up_no_stop(broker, monkeypatch):
    blocked = threading.Event()
    monkeypatch.setattr(aiomqtt.Client, "_client_connect", lambda self: blocked.set() or threading.Event().wait())
    bus = Bus()
    gateway = Gateway(TickEngine(), bus.port)
    gateway.beside["mqtt"] = publisher(broker).run
    run(gateway, until=blocked.is_set)  # returns though the thread never does
    bus.close()
    assert blocked.is_set()


def passwords(broker, folder, word):
    file = folder / "passwords"
    file.write_text("")
    file.chmod(0o600)
    subprocess.run(["mosquitto_passwd", "-b", file, "car", word], check=True, capture_output=True)
    broker.configure("allow_anonymous false", f"password_file {file}")


def secret(folder, text, mode=0o600):
    file = folder / "mqtt-password"
    file.write_text(text)
    file.chmod(mode)
    return file


def test_a_broker_that_refuses_is_told_once_and_a_new_password_is_taken_without_a_restart(broker, tmp_path, caplog):
    broker.stop()
    passwords(broker, tmp_path, "right")
    broker.start()
    p = publisher(broker, {"password_file": secret(tmp_path, "wrong\n")}, username="car", password_file="x")
    caplog.set_level(logging.DEBUG, "bms_gateway.service.broker")

    async def happenings():
        await come(lambda: caplog.text.count("trying again") >= 4)
        assert not p.broker.connected
        secret(tmp_path, "right\n", 0o644)
        await come(lambda: "is open to others" in caplog.text)
        secret(tmp_path, "right\n")
        await come(lambda: p.broker.connected)

    beside(p, happenings)
    refused = [r for r in caplog.records if "trying again" in r.getMessage()]
    assert [r.levelno for r in refused[:4]] == [logging.WARNING] + [logging.DEBUG] * 3
    assert "Not authori" in refused[0].getMessage()
    assert "right" not in caplog.text
    assert "wrong" not in caplog.text
    assert p.broker.connects == 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the client forgets a refused socket
def test_tls_is_spoken_with_the_right_broker_only(broker, tmp_path, caplog):
    ca, key, cert = certificates(tmp_path)
    other, _, _ = certificates(tmp_path, "elsewhere")
    broker.stop()
    broker.configure("allow_anonymous true", f"certfile {cert}", f"keyfile {key}")
    broker.start()
    caplog.set_level(logging.INFO)
    good = publisher(broker, {"ca_file": ca}, tls=True, ca_file="x")
    bad = publisher(broker, {"ca_file": other}, tls=True, ca_file="x")

    async def both():
        await come(lambda: good.broker.connected)

    async def refused():
        await come(lambda: "certificate verify failed" in caplog.text)

    beside(good, both)
    beside(bad, refused)
    assert (good.broker.connects, bad.broker.connects) == (1, 0)
    gc.collect()
    with pytest.raises(ConfigError, match=r"mqtt\.ca_file"):
        publisher(broker, {"ca_file": key}, tls=True, ca_file="x")


class Liar(threading.Thread):
    """A broker that takes a client, then announces a packet of 256 MB and begins to send it."""

    lie = b"\x30\xff\xff\xff\x7f" + bytes((1 << 20) - 5)

    def __init__(self):
        super().__init__(daemon=True)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.sent = 0

    def run(self):
        with suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                with client, suppress(OSError):
                    client.recv(4096)
                    client.sendall(b"\x20\x02\0\0" + self.lie)
                    for _ in range(64):
                        client.sendall(self.next())
                        self.sent += 1

    def next(self):
        return bytes(1 << 20)


class Talker(Liar):
    """A broker that sends small messages that nobody has subscribed to, to be acknowledged, without end."""

    lie = b"\x34\x09\x00\x04some\x00\x01x"

    def next(self):
        numbers = range(self.sent * 1000 % 65_000 + 1, self.sent * 1000 % 65_000 + 1001)
        return b"".join(b"\x34\x09\x00\x04some" + n.to_bytes(2, "big") + b"x" for n in numbers)


def test_a_broker_that_talks_without_end_is_left(monkeypatch, caplog):
    """The client keeps each such message until the broker has acknowledged the acknowledgement: 190 MB in 8 s."""
    monkeypatch.setattr(module, "RETRY_FIRST_S", 0.05)
    monkeypatch.setattr(module, "RETRY_MOST_S", 0.2)
    monkeypatch.setattr(module, "ANSWER_S", 1.0)
    caplog.set_level(logging.DEBUG, "bms_gateway.service.broker")
    broker = Talker()
    broker.start()
    p = publisher(broker)

    async def some_time():
        running = asyncio.ensure_future(p.run())
        await come(lambda: caplog.text.count("though it has nothing to tell us") >= 2)
        running.cancel()
        await asyncio.wait([running])

    asyncio.run(some_time())
    broker.listener.close()


def test_a_packet_that_announces_256_mb_takes_none_of_it(monkeypatch, caplog):
    """The client took room for all of it at once: 61 MB became 266."""
    monkeypatch.setattr(module, "RETRY_FIRST_S", 0.05)
    monkeypatch.setattr(module, "RETRY_MOST_S", 0.2)
    monkeypatch.setattr(module, "ANSWER_S", 2.0)
    caplog.set_level(logging.DEBUG, "bms_gateway.service.broker")
    broker = Liar()
    broker.start()
    p = publisher(broker)
    tracemalloc.start()

    async def all_of_it():
        running = asyncio.ensure_future(p.run())
        await come(lambda: caplog.text.count("trying again") >= 3)
        running.cancel()
        await asyncio.wait([running])

    asyncio.run(all_of_it())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    broker.listener.close()
    assert peak < 16 << 20
    assert "the broker sends a packet of 268,435,455 bytes" in caplog.text
    told = [r for r in caplog.records if r.levelno == logging.WARNING]
    assert len(told) == 1


def test_the_spool_is_bounded_in_bytes_too_and_what_gave_way_while_it_was_sent_is_not_taken_twice(monkeypatch):
    monkeypatch.setattr("bms_gateway.service.spool.MOST_BYTES", 100)
    spool = Spool(1000)
    for k in range(5):
        spool.put("estimate", Message("t", bytes([k]) * 40))
    assert (spool.waiting("estimate"), spool.dropped["estimate"]) == (2, 3)
    kind, first = spool.head()
    spool.put("estimate", Message("t", b"n" * 40))
    spool.sent(kind, first)
    assert [spool.head()[1].payload[:1], spool.waiting("estimate")] == [b"\4", 2]


def test_the_line_and_the_summary_say_what_is_known_as_plain_json():
    pack = Pack(12)
    assert status(pack.gateway, pack.watch, pack.engine) == "OK: the bus is silent"
    pack.drive(6)
    line = status(pack.gateway, pack.watch, pack.engine)
    s = max(pack.engine.strings, key=lambda s: s.centre.max())
    k = s.centre.argmax()
    assert line == (
        f"OK: hottest point {s.centre[k]:.1f} ± {s.centre_sd[k]:.1f} °C, core {s.core[k]:.1f} ± {s.core_sd[k]:.1f} °C "
        f"({s.plan.name}, cell {k + 1})"
    )
    found = json.loads(json.dumps(estimates(pack.gateway, pack.watch, pack.engine), allow_nan=False))
    assert (found["state"], found["bus"], found["awake"], set(found["strings"])) == (
        "OK",
        "up",
        True,
        {"string_1", "string_2"},
    )
    assert found["strings"]["string_1"]["resistance_growth"] is None
    k = s.centre.argmax()
    hottest = {name: found["strings"][s.plan.name][f"hottest_point_{name}"] for name in ("C", "sd_K", "cell")}
    assert hottest == {"C": round(s.centre[k], 2), "sd_K": round(s.centre_sd[k], 2), "cell": k + 1}
    pack.watch.alerts.update(1e12, [Condition("x", Severity.ALARM, "all is lost", settled=True)])
    assert status(pack.gateway, pack.watch, pack.engine) == "ALARM: all is lost"
