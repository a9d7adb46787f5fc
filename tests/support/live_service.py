"""The live service over a socket pair: frames, a bus, and a gateway that runs until something holds."""

import asyncio
import os
import signal
import socket
import sys
import threading
import time

from bms_gateway.bus.access import Access
from bms_gateway.bus.canframe import from_wire
from bms_gateway.bus.socketcan import SocketCanPort
from tests.service.engine import OWN_ID

FRAME = (0x123).to_bytes(4, sys.byteorder) + bytes([8, 0, 0, 0]) + bytes(8)


class Bus:
    """A socket pair: our port at one end, the test at the other."""

    def __init__(self):
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.theirs.setblocking(False)
        self.port = SocketCanPort.over(self.ours, Access(own={OWN_ID: 1_000_000_000}))

    def sent(self):
        found = []
        try:
            while True:
                can_id, payload = from_wire(self.theirs.recv(100))
                assert can_id == OWN_ID
                found.append(int.from_bytes(payload, "big"))
        except BlockingIOError:
            return found

    def close(self):
        self.port.close()
        self.theirs.close()


PATIENCE_S = 30.0
"""How long a busy machine may take for what takes a second."""


async def come(true):
    """Wait until something holds; what a test then asserts tells what did not come."""
    end = time.monotonic() + PATIENCE_S
    while not true() and time.monotonic() < end:
        await asyncio.sleep(0.005)


def run(gateway, *tasks, seconds=None, until=None):
    """Run the gateway beside coroutines, for some seconds or until something holds."""

    async def end():
        await come(until)
        os.kill(os.getpid(), signal.SIGTERM)

    async def both():
        beside = [asyncio.ensure_future(t) for t in (*tasks, *([end()] if until else []))]
        await gateway.run(seconds=seconds or 2 * PATIENCE_S)
        for task in beside:
            task.cancel()
        for result in await asyncio.gather(*beside, return_exceptions=True):
            if isinstance(result, Exception):
                raise result

    asyncio.run(both())


async def traffic(bus, rate=1_000, duration=10.0):
    """Frames evenly from a thread of its own, as a bus does."""
    stop = threading.Event()

    def send():
        begun = time.monotonic()
        k = 0
        while not stop.is_set() and k < rate * duration:
            due = begun + k / rate
            time.sleep(max(0.0, due - time.monotonic()))
            try:
                bus.theirs.send(FRAME)
            except BlockingIOError:
                continue
            except OSError:
                return
            k += 1

    thread = threading.Thread(target=send)
    thread.start()
    try:
        await asyncio.sleep(duration + 1)
    finally:
        stop.set()
        thread.join()
