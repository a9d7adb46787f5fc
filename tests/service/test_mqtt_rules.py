"""The rules of the MQTT client one by one, without a broker: what is sent, in which order, how often it is tried."""

import asyncio
import json
import logging
import ssl
import threading
from types import SimpleNamespace

import aiomqtt
import pytest

from bms_gateway.errors import ConfigError
from bms_gateway.health.alerts import Change, Condition, Severity
from bms_gateway.service import broker, mqtt
from bms_gateway.service.spool import Message
from tests.service.mqtt_parts import certificates, publisher, running
from tests.support.live_service import come


class Client:
    """Takes all that is published; a failure ends it once so much was."""

    def __init__(self, fails_after=None, error=None):
        self.sent = []
        self.fails_after, self.error = fails_after, error or aiomqtt.MqttError("gone")
        self.broken = asyncio.Event()
        self.messages = self
        self._client = SimpleNamespace(_sock_recv=bytes)

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        return None

    async def publish(self, topic, payload, *, qos, retain):
        if self.fails_after is not None and len(self.sent) >= self.fails_after:
            raise self.error
        self.sent.append((topic, payload.decode(), qos, retain))

    def __aiter__(self):
        return self

    async def __anext__(self):
        await self.broken.wait()
        raise self.error

    @property
    def lines(self):
        return [(topic.removeprefix("cars/7/"), text) for topic, text, *_ in self.sent]


def test_the_bounds():
    assert (broker.RETRY_FIRST_S, broker.RETRY_MOST_S, broker.ANSWER_S, broker.FAREWELL_S) == (1.0, 60.0, 10.0, 1.0)
    assert (broker.KEEPALIVE_S, broker.MOST_PACKET, broker.FREE_BYTES) == (30, 128, 4096)
    assert (broker.BYTES_EACH, broker.BYTES_PER_S, broker.PORT, broker.PORT_TLS) == (32, 8, 1883, 8883)


def test_a_publisher_begins_with_nothing():
    p = publisher()
    assert (p.broker.connected, p.broker.connects, p.broker.published, p.broker.delay_s, p.broker.spool.head()) == (
        False,
        0,
        0,
        0.0,
        None,
    )


# what is put into the spool


def test_an_alert_is_one_object_that_says_what_where_and_when(monkeypatch):
    monkeypatch.setattr(mqtt.time, "time", lambda: 1234.56789)
    p = publisher()
    p.lines.append("ALARM: x")
    p.on_change(Change(Condition("sensor", Severity.ALARM, "60 °C", "s1", 4), False))
    kind, message = p.broker.spool.head()
    assert (kind, message.topic) == ("alert", "cars/7/alert")
    assert "60 °C".encode() in message.payload
    found = {"time": 1234.568, "raised": False, "severity": "ALARM", "alert": "sensor", "string": "s1", "cell": 4}
    assert json.loads(message.payload) == found | {"text": "60 °C"}
    assert p.broker.line == "ALARM: x"


def test_no_message_holds_what_json_has_not():
    with pytest.raises(ValueError, match="not JSON compliant"):
        publisher().put("estimate", {"x": float("nan")})


# the client


@pytest.fixture
def made(monkeypatch):
    """Calls of `aiomqtt.Client`, which gives a client that receives as many bytes as it is asked for."""
    calls = []

    def client(*args, **options):
        calls.append((args, options))
        return Client()

    monkeypatch.setattr(broker.aiomqtt, "Client", client)
    return calls


def test_a_client_has_our_name_our_last_will_and_our_patience(made):
    client = publisher(topic="t" * 120, username="car").broker.client()
    with pytest.raises(ConnectionError, match="which is not for us"):
        client._client._sock_recv(129)
    ((args, options),) = made
    will = options.pop("will")
    assert (will.topic, will.payload, will.qos, will.retain) == (
        "t" * 120 + "/status",
        "OFFLINE: the connection was lost",
        1,
        True,
    )
    logger = options.pop("logger")
    assert not logger.isEnabledFor(logging.ERROR)
    assert args == ("broker", 1883)
    assert options == {
        "username": "car",
        "password": None,
        "identifier": "bms-gateway-" + "t" * 116,
        "keepalive": 30,
        "timeout": 10.0,
        "tls_context": None,
    }


def test_the_password_is_read_for_each_connection(made, tmp_path):
    file = tmp_path / "secret"
    p = publisher({"password_file": file}, username="car", password_file="x", tls=True)
    for word in ("one", "two"):
        file.touch(0o600)
        file.write_text(f"{word}\n")
        p.broker.client()
    assert [options["password"] for _, options in made] == ["one", "two"]


@pytest.mark.parametrize(
    ("settings", "port"), [({}, 1883), ({"tls": True}, 8883), ({"port": 99}, 99), ({"port": 98, "tls": True}, 98)]
)
def test_the_port_is_that_of_the_config_else_the_usual_one(made, settings, port):
    publisher(**settings).broker.client()
    assert made[0][0] == ("broker", port)
    assert (made[0][1]["tls_context"] is None) is ("tls" not in settings)


# what a broker may send


@pytest.fixture
def reading(monkeypatch):
    """A publisher, the function by which its client reads, and the time."""
    now = [1000.0]
    monkeypatch.setattr(broker.time, "monotonic", lambda: now[0])
    p = publisher()
    p.broker.published = 5
    client = SimpleNamespace(_client=SimpleNamespace(_sock_recv=bytes))
    p.broker.bound(client)
    return p, client._client._sock_recv, now


def test_a_packet_of_more_bytes_than_any_that_we_need_is_not_read(reading):
    p, read, _ = reading
    assert read(128) == bytes(128)
    with pytest.raises(ConnectionError, match=r"^the broker sends a packet of 1,290 bytes, which is not for us$"):
        read(1290)
    with pytest.raises(ConnectionError, match="129 bytes"):
        read(129)
    assert p.broker.refused == "the broker sends a packet of 129 bytes, which is not for us"


def used_up(read):
    """How many bytes can be read, one at a time, before the connection is refused."""
    for count in range(100_000):
        try:
            read(1)
        except ConnectionError:
            return count
    raise AssertionError("no end")


def test_a_broker_may_send_some_bytes_and_then_as_many_as_our_messages_and_the_time_explain(reading):
    p, read, now = reading
    assert used_up(read) == 4097
    assert p.broker.refused == "the broker has sent 4,097 bytes, though it has nothing to tell us"
    p.broker.published += 2
    assert used_up(read) == 64
    now[0] += 3.0
    assert used_up(read) == 24


# connecting again


def test_pauses_double_up_to_a_minute_and_only_the_first_is_told_to_people(caplog):
    p = publisher()
    caplog.set_level(logging.DEBUG)
    p.broker.connected = True
    delays = []
    for _ in range(8):
        p.broker.on_failed(OSError("no route"))
        delays.append(p.broker.delay_s)
    assert delays == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    assert [r.levelno for r in caplog.records] == [logging.WARNING] + [logging.DEBUG] * 7
    assert caplog.messages[0] == "MQTT: broker: no route; trying again, messages wait"
    assert caplog.records[0].code == "mqtt"
    assert not p.broker.connected


def test_the_reason_is_that_of_the_refusal_else_of_the_error_else_its_name(caplog):
    p = publisher()
    caplog.set_level(logging.DEBUG)
    p.broker.refused = "too much"
    for error in (OSError("x"), OSError("x"), ConnectionResetError()):
        p.broker.on_failed(error)
    assert [m.split(": ")[2].split(";")[0] for m in caplog.messages] == ["too much", "x", "ConnectionResetError"]


def test_a_connection_is_told_and_does_not_shorten_the_pause_before_something_is_acknowledged(caplog):
    caplog.set_level(logging.INFO)
    p = publisher()
    p.broker.delay_s, p.broker.told = 8.0, "OK"
    p.broker.on_connected()
    assert (p.broker.connected, p.broker.connects, p.broker.delay_s, p.broker.told) == (True, 1, 8.0, None)
    assert caplog.messages == ["MQTT: connected to broker"]
    asyncio.run(p.broker.publish(client := Client(), Message("t", b"x"), retain=False))
    assert (p.broker.delay_s, p.broker.published, client.sent) == (0.0, 1, [("t", "x", 1, False)])


# the order of what is sent


def publishing(p, client, *parts, end=True):
    """Run `publish_all` beside coroutine functions; gives the exception with which it ended."""

    async def both():
        task = asyncio.ensure_future(p.broker.publish_all(client))
        for part in parts:
            await part()
        if end:
            task.cancel()
        (result,) = await asyncio.gather(task, return_exceptions=True)
        await asyncio.sleep(0)
        if not end:  # each connection that broke would leave its tasks behind
            assert asyncio.all_tasks() == {asyncio.current_task()}
        return result

    return asyncio.run(both())


def sent(client, count):
    async def wait():
        await come(lambda: len(client.sent) >= count)
        await asyncio.sleep(0.02)

    return wait


def test_first_the_status_then_alerts_then_estimates_and_the_status_again_where_it_is_another():
    p, client = publisher(), Client()
    p.broker.line = "OK"
    p.broker.connected = True
    for k in (1, 2):
        p.broker.spool.put("estimate", Message("cars/7/estimates", b"%d" % k))
        p.broker.spool.put("alert", Message("cars/7/alert", b"%d" % k))

    async def more():
        p.broker.line = "WARNING"
        p.broker.spool.put("alert", Message("cars/7/alert", b"3"))
        p.broker.wake.set()
        await sent(client, 7)()
        assert not p.broker.wake.is_set()  # it waits, and does not go round and round

    result = publishing(p, client, sent(client, 5), more)
    assert isinstance(result, asyncio.CancelledError)
    assert client.lines == [
        ("status", "OK"),
        ("alert", "1"),
        ("alert", "2"),
        ("estimates", "1"),
        ("estimates", "2"),
        ("status", "WARNING"),
        ("alert", "3"),
        ("status", "STOPPED"),
    ]
    assert {(topic.endswith("status"), qos, retain) for topic, _, qos, retain in client.sent} == {
        (True, 1, True),
        (False, 1, False),
    }
    assert (p.broker.published, p.broker.connected, p.broker.spool.head()) == (8, False, None)


def test_a_status_that_changes_while_messages_are_sent_is_told_between_them():
    p, client = publisher(), Client()
    p.broker.line = "OK"
    for k in (1, 2):
        p.broker.spool.put("alert", Message("cars/7/alert", b"%d" % k))
    publish = client.publish

    async def changing(topic, payload, **options):
        await publish(topic, payload, **options)
        if payload == b"1":
            p.broker.line = "ALARM"

    client.publish = changing
    publishing(p, client, sent(client, 4))
    assert client.lines == [
        ("status", "OK"),
        ("alert", "1"),
        ("status", "ALARM"),
        ("alert", "2"),
        ("status", "STOPPED"),
    ]


def test_a_message_that_was_not_acknowledged_waits_for_the_next_connection():
    p, client = publisher(), Client(fails_after=2)
    p.broker.line = "OK"
    p.broker.connected = True
    for k in (1, 2):
        p.broker.spool.put("alert", Message("cars/7/alert", b"%d" % k))
    assert isinstance(publishing(p, client, end=False), aiomqtt.MqttError)
    assert client.lines == [("status", "OK"), ("alert", "1")]
    assert p.broker.spool.head()[1].payload == b"2"
    assert not p.broker.connected


def test_a_broker_that_goes_while_nothing_is_to_be_sent_is_noticed():
    p, client = publisher(), Client(error=aiomqtt.MqttError("it is gone"))
    p.broker.line = "OK"

    async def goes():
        client.broken.set()

    result = publishing(p, client, sent(client, 1), goes, end=False)
    assert (type(result), str(result)) == (aiomqtt.MqttError, "it is gone")
    assert client.lines == [("status", "OK")]


def test_the_farewell_waits_for_nobody_long(monkeypatch):
    monkeypatch.setattr(broker, "FAREWELL_S", 0.05)
    p, client = publisher(), Client()
    p.broker.line = "OK"
    publish = client.publish

    async def slow(topic, payload, **options):
        if payload == b"STOPPED":
            await asyncio.sleep(3600.0)
        await publish(topic, payload, **options)

    client.publish = slow
    assert isinstance(publishing(p, client, sent(client, 1)), asyncio.CancelledError)
    assert client.lines == [("status", "OK")]


# the thread of the client


def test_it_connects_again_after_the_pause_and_says_goodbye_at_the_end(monkeypatch, caplog):
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(broker, "RETRY_FIRST_S", 0.01)
    p, clients = publisher(), []

    def client():
        if not clients:
            clients.append(None)
            raise ConfigError("mqtt.password_file: is open to others")
        clients.append(Client(fails_after=1 if len(clients) == 1 else None, error=OSError("reset")))
        return clients[-1]

    p.broker.client = client

    async def until():
        await come(lambda: len(clients) == 2 and clients[1].sent)
        assert [t.daemon for t in threading.enumerate() if t.name == "mqtt"] == [True]  # it holds up no end
        p.put("estimate", {"k": 1})
        await come(lambda: len(clients) == 3 and len(clients[2].sent) == 2)

    assert isinstance(running(p, until), asyncio.CancelledError)
    assert "MQTT: broker: mqtt.password_file: is open to others; trying again, messages wait" in caplog.messages
    assert clients[1].lines == [("status", "OK")]
    assert clients[2].lines == [("status", "OK"), ("estimates", '{"k": 1}'), ("status", "STOPPED")]
    assert (p.broker.connects, p.broker.connected, p.broker.delay_s) == (2, False, 0.0)


def test_estimates_are_put_out_each_interval_with_the_time_and_the_line_of_then(monkeypatch):
    monkeypatch.setattr(mqtt.time, "time", lambda: 99.12345)
    p, client = publisher(estimates=lambda: {"a": 1}, interval_s=1.0), []
    p.interval_s = 0.05
    p.broker.client = lambda: client.append(Client()) or client[0]

    async def until():
        await come(lambda: client and len(client[0].sent) >= 2)
        p.lines.append("WARNING")
        await come(lambda: ("status", "WARNING") in client[0].lines)

    running(p, until)
    assert client[0].lines[:2] == [("status", "OK"), ("estimates", '{"time": 99.123, "a": 1}')]
    assert len(client) == 1


def test_a_bug_in_the_client_ends_the_part_with_it_and_not_in_silence():
    p = publisher()

    def broken():
        raise ZeroDivisionError("a bug")

    p.broker.client = broken
    with pytest.raises(ZeroDivisionError, match="a bug"):
        asyncio.run(p.run())


def test_a_client_that_ends_without_a_reason_is_a_bug_too():
    p = publisher()

    async def ends():
        return None

    p.broker.live = ends
    with pytest.raises(RuntimeError, match="the client has ended"):
        asyncio.run(p.run())


def test_the_metrics_of_the_connection():
    p = publisher()
    p.broker.connected, p.broker.connects, p.broker.published = True, 2, 3
    for kind, count in (("alert", 1), ("estimate", 13)):
        for _ in range(count):
            p.broker.spool.put(kind, Message("t", b""))
    assert {
        (f.name.removeprefix("bms_gateway_mqtt_"), f.kind, *labels.items(), value)
        for f in p.broker.families()
        for _, labels, value in f.samples
    } == {
        ("connected", "gauge", 1.0),
        ("connects_total", "counter", 2.0),
        ("published_total", "counter", 3.0),
        ("waiting", "gauge", ("kind", "alert"), 1.0),
        ("waiting", "gauge", ("kind", "estimate"), 10.0),
        ("dropped_total", "counter", ("kind", "alert"), 0.0),
        ("dropped_total", "counter", ("kind", "estimate"), 3.0),
    }


def test_tls_checks_the_brokers_certificate_shows_ours_and_is_of_today(tmp_path):
    ca, key, cert = certificates(tmp_path)
    files = {"ca_file": ca, "cert_file": cert, "key_file": key}
    settings = {"tls": True, "ca_file": "x", "cert_file": "x", "key_file": "x"}
    context = publisher(files, **settings).broker.tls
    assert (context.verify_mode, context.check_hostname) == (ssl.CERT_REQUIRED, True)
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert len(context.get_ca_certs()) == 1
    for wrong, file in (("ca_file", key), ("cert_file", ca)):
        with pytest.raises(ConfigError, match=rf"^mqtt\.{wrong}: '{file}' cannot be used: "):
            publisher(files | {wrong: file}, **settings)
    assert publisher(files).broker.tls is None


def test_the_end_waits_for_the_farewell_and_half_as_long_again(monkeypatch):
    monkeypatch.setattr(broker, "FAREWELL_S", 0.5)
    within, waits = mqtt.within, []

    async def noted(event, seconds):
        waits.append(seconds)
        return await within(event, seconds)

    monkeypatch.setattr(mqtt, "within", noted)
    p, clients = publisher(interval_s=3600.0), []
    p.broker.client = lambda: clients.append(Client()) or clients[-1]

    async def until():
        await come(lambda: clients and clients[0].sent)

    running(p, until)
    assert waits == [3600.0, 0.75]
