"""Sends status, alerts and estimates to an MQTT broker, and survives every fault of broker and network.

Below the topic of the gateway::

    status      one line, retained: "OK: …", "WARNING: …", "ALARM: …"; "STOPPED", or "OFFLINE" as the last will
    alert       one JSON object when an alert is raised, changes or is over
    estimates   one JSON object every interval: hottest and coldest core, growth and flags of each string

Every message is acknowledged (QoS 1) before the next one is sent, so that no messages collect inside the client; they
wait in the spool. A broker that is slow, silent, or refuses is tried again after growing pauses.

The client runs in a thread with an event loop of its own. The gateway's loop treats every exception as a bug and ends
the service. This would be too strict for a client that sometimes meets a closed socket, and no frame may ever wait for
the client. Messages are made in the gateway's loop, where the engine is, and passed on as text.
"""

import asyncio
import json
import logging
import ssl
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import Any, Final, Literal

import aiomqtt

from bms_gateway.config.credential import read_secret
from bms_gateway.config.schema import Mqtt
from bms_gateway.errors import ConfigError
from bms_gateway.health.alerts import Change
from bms_gateway.service.exposition import Family
from bms_gateway.service.spool import KINDS, Message, Spool

log = logging.getLogger(__name__)

RETRY_FIRST_S: Final = 1.0  # a broker that is restarted is back after a second or two
RETRY_MOST_S: Final = 60.0  # after hours in a tunnel a minute more does no harm
ANSWER_S: Final = 10.0  # for an acknowledgement; a mobile network takes seconds
FAREWELL_S: Final = 1.0
KEEPALIVE_S: Final = 30  # the broker tells our last will after one and a half of it
MOST_PACKET: Final = 128  # bytes; nothing is subscribed, and an acknowledgement has two
FREE_BYTES: Final = 4096  # what a broker may send in a connection, before the next two
BYTES_EACH: Final = 32  # for a message of ours, whose acknowledgement has four
BYTES_PER_S: Final = 8  # an answer to a sign of life has two, each half minute
PORT, PORT_TLS = 1883, 8883
OFFLINE: Final = "OFFLINE: the connection was lost"
STOPPED: Final = "STOPPED"


class Threads(ThreadPoolExecutor):
    """One thread per call, which nobody waits for at the end: a name server that is silent must not hold up a stop."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Run it."""
        future: Future[Any] = Future()

        def work() -> None:
            if not future.set_running_or_notify_cancel():
                return
            try:
                result = fn(*args, **kwargs)
            except BaseException as error:  # noqa: BLE001 — handed over to whoever awaits the call, as an executor does
                future.set_exception(error)
            else:
                future.set_result(result)

        Thread(target=work, name="mqtt-connect", daemon=True).start()
        return future


class Publisher:
    """Keeps a broker informed.

    Parameters
    ----------
    settings : Mqtt
        `[mqtt]` of the config.
    files : mapping of str to Path
        `password_file`, `ca_file`, `cert_file`, `key_file`, as found.
    status : callable
        Gives the one line of now.
    estimates : callable
        Gives what is known of the strings now, JSON-able.

    Attributes
    ----------
    spool : Spool
    connected : bool
    connects, published : int

    Raises
    ------
    ConfigError
        A certificate or key cannot be used.
    """

    def __init__(
        self,
        settings: Mqtt,
        files: dict[str, Path],
        *,
        status: Callable[[], str],
        estimates: Callable[[], dict[str, Any]],
    ) -> None:
        self._settings, self._files = settings, files
        self._status, self._estimates = status, estimates
        self._tls = _tls(settings, files)
        self._wake = asyncio.Event()  # of the client's loop, as all below
        self._client_loop: asyncio.AbstractEventLoop | None = None
        self._client_task: asyncio.Task[None] | None = None
        self._delay_s = 0.0
        self._line = ""
        self._told: str | None = None
        self._refused = ""
        self.spool = Spool(settings.spool)
        self.connected = False
        self.connects = self.published = 0

    def on_change(self, change: Change) -> None:
        """Queue an alert; for `Watch.listeners`."""
        c = change.condition
        found = {
            "time": round(time.time(), 3),
            "raised": change.raised,
            "severity": c.severity.name,
            "alert": c.name,
            "string": c.string,
            "cell": c.cell,
            "text": c.text,
        }
        self._put("alert", found)

    async def run(self) -> None:
        """Gather and have it sent, until cancelled.

        Raises
        ------
        Exception
            What has ended the client's thread: a bug.
        """
        here, ended = asyncio.get_running_loop(), asyncio.Event()
        failures: list[BaseException] = []

        def work() -> None:
            try:
                asyncio.run(self._live())
            except asyncio.CancelledError:
                pass
            except BaseException as error:  # noqa: BLE001 — raised below, in the loop that must know
                failures.append(error)
            with suppress(RuntimeError):  # nobody waits any more
                here.call_soon_threadsafe(ended.set)

        self._line = self._status()
        Thread(target=work, name="mqtt", daemon=True).start()
        try:
            while not await _within(ended, self._settings.interval_s):
                self._put("estimate", {"time": round(time.time(), 3), **self._estimates()})
        finally:
            if self._client_loop is not None and self._client_task is not None:
                with suppress(RuntimeError):
                    self._client_loop.call_soon_threadsafe(self._client_task.cancel)
            await _within(ended, 1.5 * FAREWELL_S)
        raise failures[0] if failures else RuntimeError("the client has ended")

    def _put(self, kind: Any, found: dict[str, Any]) -> None:
        text = json.dumps(found, ensure_ascii=False, allow_nan=False)
        topic = "alert" if kind == "alert" else "estimates"
        self.spool.put(kind, Message(f"{self._settings.topic}/{topic}", text.encode()))
        self._line = self._status()
        if self._client_loop is not None:
            with suppress(RuntimeError):
                self._client_loop.call_soon_threadsafe(self._wake.set)

    # in the client's thread

    async def _live(self) -> None:
        """Connect, publish, connect again, until cancelled."""
        loop = asyncio.get_running_loop()
        loop.set_default_executor(Threads())
        loop.set_exception_handler(lambda _, context: log.debug("MQTT: in the client: %s", context["message"]))
        self._client_loop, self._client_task = loop, asyncio.current_task()
        while True:
            try:
                async with self._client() as client:
                    self._on_connected()
                    await self._publish_all(client)
            except (aiomqtt.MqttError, ConfigError, OSError) as error:
                self._on_failed(error)
            await asyncio.sleep(self._delay_s)

    def _client(self) -> aiomqtt.Client:
        s = self._settings
        password = None
        if (file := self._files.get("password_file")) is not None:
            password = read_secret(file, "mqtt.password_file")
        client = aiomqtt.Client(
            s.host,
            s.port or (PORT_TLS if s.tls else PORT),
            username=s.username,
            password=password,
            logger=_quiet(),
            identifier=f"bms-gateway-{s.topic}"[:128],
            will=aiomqtt.Will(f"{s.topic}/status", OFFLINE, qos=1, retain=True),
            keepalive=KEEPALIVE_S,
            timeout=ANSWER_S,
            tls_context=self._tls,
        )
        self._bound(client)
        return client

    def _bound(self, client: aiomqtt.Client) -> None:
        """Let the client read no packet that is larger than any that it can need, nor more than answers to its own.

        It takes the room for a whole packet as soon as that announces its length, up to 256 MB, and keeps every message
        that a broker sends until that has acknowledged it. It has no setting for less; so this stands between it and
        its socket.
        """
        paho = client._client
        receive = paho._sock_recv
        begun_s, before, taken = time.monotonic(), self.published, 0

        def bounded(size: int) -> bytes:
            nonlocal taken
            if size > MOST_PACKET:
                self._refused = f"the broker sends a packet of {size:,} bytes, which is not for us"
                raise ConnectionError(self._refused)
            due = BYTES_EACH * (self.published - before) + BYTES_PER_S * (time.monotonic() - begun_s)
            if taken > FREE_BYTES + due:
                self._refused = f"the broker has sent {taken:,} bytes, though it has nothing to tell us"
                raise ConnectionError(self._refused)
            part = receive(size)
            taken += len(part)
            return part

        paho._sock_recv = bounded  # type: ignore[assignment,method-assign]

    def _on_connected(self) -> None:
        self.connected, self._told = True, None
        self.connects += 1
        log.info("MQTT: connected to %s", self._settings.host)

    def _on_failed(self, error: Exception) -> None:
        level = logging.DEBUG if self._delay_s else logging.WARNING
        self.connected = False
        self._delay_s = min(max(RETRY_FIRST_S, 2 * self._delay_s), RETRY_MOST_S)
        why, self._refused = self._refused or str(error) or type(error).__name__, ""
        log.log(level, "MQTT: %s: %s; trying again, messages wait", self._settings.host, why, extra={"code": "mqtt"})

    async def _publish_all(self, client: aiomqtt.Client) -> None:
        gone = asyncio.ensure_future(_until_gone(client))
        try:
            while True:
                self._wake.clear()
                await self._tell_status(client)
                while (head := self.spool.head()) is not None:
                    kind, message = head
                    await self._publish(client, message, retain=False)
                    self.spool.sent(kind, message)
                    await self._tell_status(client)
                woken = asyncio.ensure_future(self._wake.wait())
                await asyncio.wait({woken, gone}, return_when=asyncio.FIRST_COMPLETED)
                woken.cancel()
                if gone.done():
                    gone.result()
        except asyncio.CancelledError:
            self._told = None
            with suppress(TimeoutError, aiomqtt.MqttError):
                await asyncio.wait_for(self._tell_status(client, STOPPED), FAREWELL_S)
            raise
        finally:
            gone.cancel()
            self.connected = False

    async def _tell_status(self, client: aiomqtt.Client, line: str | None = None) -> None:
        line = line or self._line
        if line != self._told:
            await self._publish(client, Message(f"{self._settings.topic}/status", line.encode()), retain=True)
            self._told = line

    async def _publish(self, client: aiomqtt.Client, message: Message, *, retain: bool) -> None:
        await client.publish(message.topic, message.payload, qos=1, retain=retain)
        self._delay_s = 0.0  # not before: a broker that takes us and then fails is no better than one that is gone
        self.published += 1

    def families(self) -> Iterator[Family]:
        """Metrics of the connection."""
        yield _one("connected", "gauge", "1 while the broker is reached.", self.connected)
        yield _one("connects_total", "counter", "Connections made.", self.connects)
        yield _one("published_total", "counter", "Messages acknowledged by the broker.", self.published)
        waiting = tuple(("", {"kind": kind}, float(self.spool.waiting(kind))) for kind in KINDS)
        yield Family("bms_gateway_mqtt_waiting", "gauge", "Messages that wait, by kind.", waiting)
        dropped = tuple(("", {"kind": kind}, float(self.spool.dropped[kind])) for kind in KINDS)
        yield Family("bms_gateway_mqtt_dropped_total", "counter", "Messages dropped, by kind.", dropped)


def _one(name: str, kind: Literal["gauge", "counter"], text: str, value: float) -> Family:
    return Family(f"bms_gateway_mqtt_{name}", kind, text, (("", {}, float(value)),))


async def _within(event: asyncio.Event, seconds: float) -> bool:
    """Wait for an event; whether it came."""
    with suppress(TimeoutError):
        await asyncio.wait_for(event.wait(), seconds)
    return event.is_set()


async def _until_gone(client: aiomqtt.Client) -> None:
    """End, with the client's own error, when the broker is gone; nothing is subscribed, so nothing comes."""
    async for _ in client.messages:
        pass


def _quiet() -> logging.Logger:
    """Logger for the client: what it has to say reaches people as our own lines."""
    logger = logging.getLogger(f"{__name__}.client")
    logger.setLevel(logging.CRITICAL)
    return logger


def _tls(settings: Mqtt, files: dict[str, Path]) -> ssl.SSLContext | None:
    """Make the context that checks the broker's certificate, always; None without TLS."""
    if not settings.tls:
        return None
    key = "ca_file"
    try:
        context = ssl.create_default_context(cafile=files.get(key))
        if (certificate := files.get("cert_file")) is not None:
            key = "cert_file"
            context.load_cert_chain(certificate, files["key_file"])
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"mqtt.{key}: {str(files.get(key))!r} cannot be used: {error}") from None
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    return context
