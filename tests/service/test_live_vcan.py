"""The shell with the real port on a real interface that comes and goes."""

import asyncio
import logging
import subprocess

import numpy as np
import pytest

from bms_gateway.bus.port import Link
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.service.live import Gateway
from tests.bus.frames import make
from tests.service.engine import OWN_ID, TICK_NS, TickEngine

pytestmark = pytest.mark.vcan

CYCLE_NS = 200_000_000


@pytest.fixture
def vcan():
    yield "vcan0"
    subprocess.run(["ip", "link", "del", "vcan0"], stderr=subprocess.DEVNULL, check=False)
    subprocess.run("ip link add vcan0 type vcan && ip link set vcan0 up", shell=True, check=True)


async def ip(words):
    process = await asyncio.create_subprocess_shell(words)
    assert await process.wait() == 0


async def send_one(channel):
    sender = SocketCanSender(channel)
    sender.send(make((0, 0x123, b"12345678")))
    sender.close()


def test_the_service_outlives_its_interface_and_sends_no_old_frames_afterwards(vcan, caplog):
    engine = TickEngine()
    port = SocketCanPort(vcan, wanted=[0x123], own={OWN_ID: CYCLE_NS})
    heard = []

    async def listen(seconds):
        listener = SocketCanPort(vcan, wanted=[OWN_ID])
        await asyncio.sleep(seconds)
        batch = listener.drain()
        listener.close()
        heard.append(
            [(int(t), int.from_bytes(bytes(d), "big")) for t, d in zip(batch.time_ns, batch.data, strict=True)]
        )

    async def happenings():
        await send_one(vcan)
        await listen(0.7)
        await ip("ip link set vcan0 down")
        await asyncio.sleep(1.0)
        await ip("ip link set vcan0 up")
        await listen(1.5)
        await ip("ip link del vcan0")
        await asyncio.sleep(1.0)
        await ip("ip link add vcan0 type vcan; ip link set vcan0 up")
        await listen(2.7)
        await send_one(vcan)
        await asyncio.sleep(0.1)

    async def both():
        task = asyncio.ensure_future(happenings())
        await Gateway(engine, port).run(seconds=10)
        await task

    with caplog.at_level(logging.INFO):
        asyncio.run(both())
    received, link = port.counters.received, port.link
    port.close()
    assert link is Link.UP
    assert received == 2
    assert all(len(frames) >= 4 for frames in heard)
    lateness = [arrived - due for frames in heard for arrived, due in frames]
    assert max(lateness) <= CYCLE_NS + 50_000_000
    assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)
    told = [r.getMessage() for r in caplog.records if r.name.endswith("socketcan")]
    assert len(told) <= 5, told  # two outages, told and ended; the buffer's size
