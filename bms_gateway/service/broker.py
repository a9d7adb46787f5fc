"""The connection to an MQTT broker: order of messages, limit of what is read, pauses between attempts.

Every message is acknowledged (QoS 1) before the next one is sent, so that no messages collect inside the client; they
wait in the spool. A broker that is slow, silent, or refuses is tried again after growing pauses.
"""

import asyncio
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
from bms_gateway.service.exposition import Family
from bms_gateway.service.spool import KINDS, Message, Spool

log = logging.getLogger(__name__)

RETRY_FIRST_S: Final = 1.0  # a broker that is restarted is back after a second or two
RETRY_MOST_S: Final = 60.0  # after hours in a tunnel a minute more does no harm
ANSWER_S: Final = 10.0  # for an acknowledgement; a mobile network takes seconds
FAREWELL_S: Final = 1.0
KEEPALIVE_S: Final = 30  # the broker publishes our last will after one and a half times this
MOST_PACKET: Final = 128  # bytes; nothing is subscribed, and an acknowledgement has two
FREE_BYTES: Final = 4096  # what a broker may send in a connection, besides what the next two constants allow
BYTES_EACH: Final = 32  # for each message of ours; an acknowledgement has four
BYTES_PER_S: Final = 8  # for keeping the connection alive: an answer of two bytes each half minute
PORT, PORT_TLS = 1883, 8883
OFFLINE: Final = "OFFLINE: the connection was lost"
STOPPED: Final = "STOPPED"


class Threads(ThreadPoolExecutor):
    """One thread per call; the process does not wait for it at its end, so a silent name server cannot delay a stop."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """Run the call."""
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


class Broker:
    """Sends a line of status and the messages of a spool to a broker, in an event loop of its own.

    Parameters
    ----------
    settings, files : Mqtt, mapping of str to Path
        As for `mqtt.Publisher`.

    Attributes
    ----------
    spool : Spool
    line : str
        Present status.
    told : str or None
        Status that the broker has received; None before the first.
    connected : bool
    connects, published : int
    delay_s : float
        Pause before the next attempt.
    refused : str
        Reason why the gateway itself closed a connection.
    wake : asyncio.Event
        Set when there is something to send.
    tls : ssl.SSLContext or None

    Raises
    ------
    ConfigError
        A certificate or key cannot be used.
    """

    def __init__(self, settings: Mqtt, files: dict[str, Path]) -> None:
        self._settings, self._files = settings, files
        self.tls = tls_context(settings, files)
        self.spool = Spool(settings.spool)
        self.wake = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._task: asyncio.Task[None] | None = None
        self.delay_s = 0.0
        self.line = ""
        self.told: str | None = None
        self.refused = ""
        self.connected = False
        self.connects = self.published = 0

    # from another thread

    def look(self) -> None:
        """Make it check the spool and the status line."""
        if self._loop is not None:
            with suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self.wake.set)

    def cancel(self) -> None:
        """Make it send the last status and end."""
        if self._loop is not None and self._task is not None:
            with suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self._task.cancel)

    # in its own thread

    async def live(self) -> None:
        """Connect, publish, connect again, until cancelled."""
        loop = asyncio.get_running_loop()
        loop.set_default_executor(Threads())
        loop.set_exception_handler(lambda _, context: log.debug("MQTT: in the client: %s", context["message"]))
        self._loop, self._task = loop, asyncio.current_task()
        while True:
            try:
                async with self.client() as client:
                    self.on_connected()
                    await self.publish_all(client)
            except (aiomqtt.MqttError, ConfigError, OSError) as error:
                self.on_failed(error)
            await asyncio.sleep(self.delay_s)

    def client(self) -> aiomqtt.Client:
        """Make a client of these settings; the password is read anew each time."""
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
            tls_context=self.tls,
        )
        self.bound(client)
        return client

    def bound(self, client: aiomqtt.Client) -> None:
        """Limit the size of a packet that the client reads, and the number of answers.

        The client allocates memory for a whole packet as soon as its length is announced, up to 256 MB, and keeps every
        message of a broker until it is acknowledged. It has no setting for a limit, so this function is put between the
        client and its socket.
        """
        paho = client._client
        receive = paho._sock_recv
        begun_s, before, taken = time.monotonic(), self.published, 0

        def bounded(size: int) -> bytes:
            nonlocal taken
            if size > MOST_PACKET:
                self.refused = f"the broker sends a packet of {size:,} bytes, which is not for us"
                raise ConnectionError(self.refused)
            due = BYTES_EACH * (self.published - before) + BYTES_PER_S * (time.monotonic() - begun_s)
            if taken > FREE_BYTES + due:
                self.refused = f"the broker has sent {taken:,} bytes, though it has nothing to tell us"
                raise ConnectionError(self.refused)
            part = receive(size)
            taken += len(part)
            return part

        paho._sock_recv = bounded  # type: ignore[assignment,method-assign]

    def on_connected(self) -> None:
        """Note a connection."""
        self.connected, self.told = True, None
        self.connects += 1
        log.info("MQTT: connected to %s", self._settings.host)

    def on_failed(self, error: Exception) -> None:
        """Note why the connection was lost, and double the pause."""
        level = logging.DEBUG if self.delay_s else logging.WARNING
        self.connected = False
        self.delay_s = min(max(RETRY_FIRST_S, 2 * self.delay_s), RETRY_MOST_S)
        why, self.refused = self.refused or str(error) or type(error).__name__, ""
        log.log(level, "MQTT: %s: %s; trying again, messages wait", self._settings.host, why, extra={"code": "mqtt"})

    async def publish_all(self, client: aiomqtt.Client) -> None:
        """Send the status and all waiting messages, whenever there are any, until the broker is lost or cancelled."""
        gone = asyncio.ensure_future(_until_gone(client))
        try:
            while True:
                self.wake.clear()
                await self.tell_status(client)
                while (head := self.spool.head()) is not None:
                    kind, message = head
                    await self.publish(client, message, retain=False)
                    self.spool.sent(kind, message)
                    await self.tell_status(client)
                woken = asyncio.ensure_future(self.wake.wait())
                await asyncio.wait({woken, gone}, return_when=asyncio.FIRST_COMPLETED)
                woken.cancel()
                if gone.done():
                    gone.result()
        except asyncio.CancelledError:
            self.told = None
            with suppress(TimeoutError, aiomqtt.MqttError):
                await asyncio.wait_for(self.tell_status(client, STOPPED), FAREWELL_S)
            raise
        finally:
            gone.cancel()
            self.connected = False

    async def tell_status(self, client: aiomqtt.Client, line: str | None = None) -> None:
        """Send the status line, by default the present one, unless it equals the last one sent."""
        line = line or self.line
        if line != self.told:
            await self.publish(client, Message(f"{self._settings.topic}/status", line.encode()), retain=True)
            self.told = line

    async def publish(self, client: aiomqtt.Client, message: Message, *, retain: bool) -> None:
        """Send one message, and wait until it is acknowledged."""
        await client.publish(message.topic, message.payload, qos=1, retain=retain)
        self.delay_s = 0.0  # only now: a broker that accepts the connection and then fails is no better than none
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


async def _until_gone(client: aiomqtt.Client) -> None:
    """End with the client's own error when the connection is lost; nothing is subscribed, so no message comes."""
    async for _ in client.messages:
        pass


def _quiet() -> logging.Logger:
    """Return a logger for the client that writes nothing: people get our own lines."""
    logger = logging.getLogger(f"{__name__}.client")
    logger.setLevel(logging.CRITICAL)
    return logger


def tls_context(settings: Mqtt, files: dict[str, Path]) -> ssl.SSLContext | None:
    """Make the TLS context, which always checks the broker's certificate; None without TLS."""
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
