"""Faults that reach the service through its metrics port and its broker."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.util import find_spec
from typing import Final

from bms_gateway.chaos.bus_faults import RECOVERS_S
from bms_gateway.chaos.reaction import Counted, Reaction, Uncounted
from bms_gateway.chaos.real_time import BusScenario, Fault, LiveBench
from bms_gateway.chaos.scenario import Scenario
from bms_gateway.config.schema import Mqtt
from bms_gateway.service.exposition import CONTENT_TYPE
from bms_gateway.service.http import MetricsServer
from bms_gateway.service.metrics import Page
from bms_gateway.service.watch import Watch

IDLE: Final = 60
SCRAPES: Final = 10
SCRAPE_S: Final = 10.0  # on a free machine a tenth of the time-out of Prometheus would do
GET: Final = b"GET /metrics HTTP/1.1\r\n\r\n"
HERE: Final = "127.0.0.1"
WELCOME: Final = bytes([0x20, 2, 0, 0])
HUGE: Final = bytes([0x30, 0xFF, 0xFF, 0xFF, 0x7F])  # a message of 256 MB begins
BROKER_S: Final = 10.0


def door_scenarios() -> list[BusScenario]:
    """Make all scenarios of this room."""

    def one(name: str, fault: str, expected: tuple[Reaction, ...], do: Fault, unfit: str = "") -> BusScenario:
        return BusScenario(Scenario(name, "service", fault, expected, 0.0, RECOVERS_S, unfit=unfit), do)

    return [
        one(
            "metrics-idle",
            f"{IDLE} idle connections to the metrics port, and {SCRAPES} scrapes",
            (Counted.of("scrapes"), Uncounted.of("scrapes_unanswered")),
            _idle_connections,
        ),
        one(
            "broker-huge",
            "the MQTT broker announces a message of 256 MB",
            (Counted.of("broker_left"),),
            _huge_message,
            "" if find_spec("aiomqtt") else "needs the extra mqtt",
        ),
    ]


@asynccontextmanager
async def _beside(part: "asyncio.Future[None]") -> AsyncIterator[None]:
    """Run a task beside the gateway within the block."""
    try:
        yield
    finally:
        part.cancel()
        with suppress(asyncio.CancelledError):
            await part


async def _idle_connections(bench: LiveBench) -> None:
    gateway = bench.gateway
    watch = Watch(gateway, lambda: bench.engine, channel=bench.channel or "memory")
    server = MetricsServer(HERE, 0, Page(gateway, lambda: bench.engine, watch), CONTENT_TYPE)
    loop, idle = asyncio.get_running_loop(), []
    async with _beside(asyncio.ensure_future(server.run())):
        while server.address is None:
            await asyncio.sleep(0.01)
        try:
            for _ in range(IDLE):
                idle.append(socket.socket())
                idle[-1].setblocking(False)
                await loop.sock_connect(idle[-1], server.address)
            for _ in range(SCRAPES):
                bench.count("scrapes" if await _scraped(*server.address) else "scrapes_unanswered")
        finally:
            for sock in idle:
                sock.close()


async def _scraped(host: str, port: int) -> bool:
    try:
        async with asyncio.timeout(SCRAPE_S):
            reader, writer = await asyncio.open_connection(host, port)
            writer.write(GET)
            answer = await reader.read()
            writer.close()
    except (OSError, TimeoutError):
        return False
    return b"bms_gateway_bus_up" in answer


async def _huge_message(bench: LiveBench) -> None:
    from bms_gateway.service.mqtt import Publisher

    left = asyncio.Event()

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1000)
        writer.write(WELCOME + HUGE)
        with suppress(ConnectionError):
            while await reader.read(1000):
                pass
        bench.count("broker_left")
        left.set()
        writer.close()

    server = await asyncio.start_server(talk, HERE, 0)
    port = server.sockets[0].getsockname()[1]
    publisher = Publisher(Mqtt(host=HERE, port=port), {}, status=lambda: "OK", estimates=dict)
    async with server, _beside(asyncio.ensure_future(publisher.run())):
        with suppress(TimeoutError):
            await asyncio.wait_for(left.wait(), BROKER_S)
