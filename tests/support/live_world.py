"""What is around the loop of the live service: a bus, an engine, systemd and a disk that do what a test says, at once.

The clock of the loop goes on at once where it would wait (`virtual_time`), so what happens when is exact.
"""

import asyncio
import socket
from collections import deque

from bms_gateway.bus.port import Counters, Link
from bms_gateway.engine.events import SendFrames
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.service.live import Gateway
from tests.bus.frames import make
from tests.support.virtual_time import START_S, VirtualLoop, micros

BASE_NS = 1_700_000_000_000_000_000
"""Bus time at the start of the loop."""


def at(seconds):
    return BASE_NS + round(seconds * 1e9)


class Port:
    """A bus to which frames come when a test says so; remembers when it was drained and pumped, µs."""

    gather_s, emptied, link = 0.1, True, Link.UP

    def __init__(self, descriptor=True):
        self.ours, self.theirs = socket.socketpair()
        self.ours.setblocking(False)
        self.descriptor = self.ours.fileno() if descriptor else -1
        self.counters = Counters()
        self.waits = None
        self.frames, self.drains, self.pumps, self.sent = [], [], [], []

    def fileno(self):
        return self.descriptor

    def now_ns(self):
        return at(asyncio.get_running_loop().time() - START_S)

    def arrive(self):
        self.frames.append((self.now_ns(), 0x123, b""))
        self.theirs.send(b"x")

    def drain(self):
        self.drains.append(micros())
        found, self.frames = self.frames, []
        if found:
            self.ours.recv(1000)
        return make(*found) if found else FrameBatch.empty()

    def send(self, frames):
        self.sent.append(frames)

    def pump(self):
        self.pumps.append(micros())
        return self.waits

    def close(self):
        self.ours.close()
        self.theirs.close()


class Engine:
    """Has one deadline at a time; remembers what it was given, and when, µs."""

    def __init__(self, *deadlines):
        self.deadlines = deque(at(d) for d in deadlines)
        self.dropped = 0
        self.did, self.queue = [], deque()
        self.on_frames = lambda: None

    def receive(self, frames, *, now_ns):
        self.did.append((micros(), "frames", len(frames), now_ns - BASE_NS))
        self.on_frames()

    def next_deadline(self):
        return self.deadlines[0] if self.deadlines else None

    def handle_timer(self, *, now_ns):
        self.did.append((micros(), "timer", now_ns - BASE_NS))
        self.deadlines.popleft()

    def next_output(self):
        return self.queue.popleft() if self.queue else None

    def snapshot(self):
        return {"of": self}


class Fits:
    def __init__(self, service, run, end):
        self.service, self.run, self.end, self.started, self.closed = service, run, end, [], 0

    def start(self, engine, event):
        self.started.append((engine, event))

    def close(self):
        self.closed += 1


class Saves:
    """The last one takes a second, in which the loop goes on."""

    def __init__(self, save, snapshot, tally):
        self.save, self.snapshot, self.tally, self.begun, self.most = save, snapshot, tally, [], []

    def begin(self):
        self.begun.append(micros())

    async def last(self, most_s):
        self.most.append(most_s)
        await asyncio.sleep(1.0)
        self.save(self.snapshot())


class Signals:
    def __init__(self):
        self.did, self.actions = [], {}

    def take(self, loop, actions):
        self.did.append("take")
        self.actions = actions

    def drop(self):
        self.did.append("drop")

    def close(self):
        self.did.append("close")


class World:
    """What is around the loop: told to systemd, by time in µs."""

    def __init__(self):
        self.told, self.ports, self.signals = [], [], Signals()
        self.watchdog_s = None

    def port(self, **how):
        self.ports.append(Port(**how))
        return self.ports[-1]

    def notify(self, *lines):
        self.told.append((micros(), *lines))

    def times(self, word):
        return [when for when, *lines in self.told if word in lines]

    def gateway(self, engine=None, port=None, **more):
        return Gateway(engine or Engine(), port or self.port(), **more)

    def play(self, gateway, *calls, seconds=1.0, then=lambda: None, **more):
        """Run it, with calls at times in s; gives what `then` gives in the loop after the end."""

        async def all_of_it():
            loop = asyncio.get_running_loop()
            for when, call in calls:
                loop.call_at(START_S + when, call)
            await gateway.run(seconds=seconds, **{"signals": self.signals} | more)
            return then()

        with asyncio.Runner(loop_factory=VirtualLoop) as runner:
            return runner.run(all_of_it())


def frames_at(seconds):
    """What the engine has to send at the end of a tick."""
    return SendFrames(at(seconds), make((at(seconds), 0x10, b"")))
