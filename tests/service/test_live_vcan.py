"""The shell with the real port on a real interface that comes and goes."""

import asyncio
import logging
import subprocess

import numpy as np
import pytest

from bms_gateway.bus.access import Access
from bms_gateway.bus.port import Link
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.service.live import Gateway
from tests.bus.frames import make
from tests.service.engine import OWN_ID, TICK_NS, TickEngine
from tests.support.live_service import come, run

pytestmark = pytest.mark.vcan

CYCLE_NS = 200_000_000
OUTAGE_S = 3.0  # a frame kept over it would be so late; no machine that is only slow is


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
    port = SocketCanPort(vcan, Access([0x123], own={OWN_ID: CYCLE_NS}))
    heard = []

    async def listen():
        listener = SocketCanPort(vcan, Access([OWN_ID]))
        parts = []
        await come(lambda: parts.append(listener.drain()) or sum(map(len, parts)) >= 4)
        listener.close()
        batch = FrameBatch.concat(parts)
        heard.append(
            [(int(t), int.from_bytes(bytes(d), "big")) for t, d in zip(batch.time_ns, batch.data, strict=True)]
        )

    async def happenings():
        await send_one(vcan)
        await listen()
        await ip("ip link set vcan0 down")
        await asyncio.sleep(OUTAGE_S)
        await ip("ip link set vcan0 up")
        await listen()
        await ip("ip link del vcan0")
        await asyncio.sleep(OUTAGE_S)
        await ip("ip link add vcan0 type vcan; ip link set vcan0 up")
        await listen()
        await send_one(vcan)
        await come(lambda: port.counters.received == 2)

    done = []

    async def all_of_it():
        await happenings()
        done.append(True)

    with caplog.at_level(logging.INFO):
        run(Gateway(engine, port), all_of_it(), until=lambda: done)
    received, link = port.counters.received, port.link
    port.close()
    assert link is Link.UP
    assert received == 2
    assert all(len(frames) >= 4 for frames in heard)
    lateness = [arrived - due for frames in heard for arrived, due in frames]
    assert max(lateness) < OUTAGE_S * 1e9
    assert np.all(np.diff([d for d, _ in engine.ticks]) == TICK_NS)
    told = [r.getMessage() for r in caplog.records if r.name.endswith("socketcan")]
    assert len(told) <= 5, told  # two outages, told and ended; the buffer's size
