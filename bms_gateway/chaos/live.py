"""The bench for what breaks the bus itself: in real time, with the service's own loop on the interface.

The simulated pack talks in its own time, the gateway runs as `run` runs it, and the fault is done to the interface
between them. Without an interface a socket pair stands in its place; what needs the kernel is left out there.
"""

import asyncio
import logging
import os
import signal
import socket
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain

import numpy as np

from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import RECEIVE_BUFFER, SocketCanPort
from bms_gateway.bus.traffic import SECOND
from bms_gateway.chaos.drive import Drive
from bms_gateway.chaos.record import Bystander, Line, Record
from bms_gateway.chaos.scenario import STEADY, Outcome, Scenario, is_sound, judge
from bms_gateway.engine import Engine, Event, Notice, Plan
from bms_gateway.errors import BusError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.service.live import Gateway

WARM_MOST_S = 60.0  # a slow machine may take so long for what takes three seconds
STEADY_FIRST = 3  # seconds that must look alike before anything is broken
SLICE_S = 0.02
SMALL_BUFFER = 64 << 10  # of the gateway's socket, where a burst is to overflow it
DRIVE_S = 300
FOREIGN_ID = 0x7E5
MOST_BEHIND_S = 0.1  # a machine too slow for the load asked for gets what it can


def foreign_frames(count: int) -> FrameBatch:
    """Make frames that concern nobody here."""
    ids, data = np.full(count, FOREIGN_ID, np.uint32), np.full((count, 8), 0x55, np.uint8)
    return FrameBatch(np.zeros(count, np.int64), ids, np.full(count, 8, np.uint8), data)


class RefusingPort(SocketCanPort):
    """The service's port on a socket whose transmit queue can be made full."""

    refuses: OSError | None = None

    def put(self, wire: bytes) -> None:
        """Send one frame, or fail as a full queue does."""
        if self.refuses is not None:
            raise self.refuses
        super().put(wire)


@dataclass(slots=True)
class LiveBench:
    """What a fault may lay hands on.

    Attributes
    ----------
    channel : str or None
        Interface; None: a socket pair.
    port : RefusingPort
        The gateway's.
    own : tuple of int
        Identifiers of the gateway.
    wanted : tuple of int
        Identifiers that it reads.
    raw : callable
        Puts one frame as the kernel lays it out onto the bus, whatever it is.
    send_all : callable
        Puts data frames of anybody onto the bus.
    """

    channel: str | None
    port: RefusingPort
    own: tuple[int, ...]
    wanted: tuple[int, ...]
    raw: Callable[[bytes], None]
    send_all: Callable[[FrameBatch], object]
    hushed: bool = False
    """The pack says nothing."""

    async def ip(self, words: str) -> None:
        """Run `ip link`.

        Raises
        ------
        BusError
            It failed: no right to, or no such interface.
        """
        process = await asyncio.create_subprocess_exec("ip", "link", *words.split(), stderr=asyncio.subprocess.PIPE)
        _, said = await process.communicate()
        if process.returncode:
            raise BusError(f"ip link {words}: {said.decode().strip()}")


Fault = Callable[[LiveBench], Awaitable[None]]


class Vehicle:
    """Sends the pack's frames when they are due; an interface that is away costs what was due.

    Parameters
    ----------
    channel : str or None
    pair : socket.socket, optional
        In place of the interface.
    """

    def __init__(self, channel: str | None, pair: socket.socket | None = None) -> None:
        self._channel, self._pair = channel, pair
        self._sender: SocketCanSender | None = None

    def send(self, frames: FrameBatch) -> bool:
        """Send all; False: the interface is away, and how many went nobody knows."""
        if self._pair is not None:
            for wire in to_wire(frames):
                self.raw(wire)
            return True
        try:
            if self._sender is None:
                self._sender = SocketCanSender(self._channel or "")
            self._sender.send(frames)
        except BusError:
            self.close()
            return False
        return True

    def raw(self, wire: bytes) -> None:
        """Put one frame as the kernel lays it out on the bus."""
        if self._pair is not None:
            with suppress(BlockingIOError):  # nobody reads: as on a bus, it is lost
                self._pair.send(wire)
            return
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock, suppress(OSError):
            sock.bind((self._channel,))
            sock.send(wire)

    def close(self) -> None:
        """Leave the bus."""
        if self._sender is not None:
            self._sender.close()
        self._sender = None


class _Lines(logging.Handler):
    def __init__(self, told: Callable[[str, str], None]) -> None:
        super().__init__(logging.INFO)
        self._told = told

    def emit(self, record: logging.LogRecord) -> None:
        if record.name.startswith("bms_gateway.bus"):
            self._told(getattr(record, "code", "bus"), record.getMessage())


@contextmanager
def _listening(told: Callable[[str, str], None]) -> Iterator[None]:
    package, handler = logging.getLogger("bms_gateway"), _Lines(told)
    before = package.level, package.propagate
    package.addHandler(handler)
    package.setLevel(logging.INFO)
    package.propagate = False
    try:
        yield
    finally:
        package.removeHandler(handler)
        package.setLevel(before[0])
        package.propagate = before[1]


class RealTimeBench:
    """Runs scenarios of the bus.

    Parameters
    ----------
    plan, database
        Of the gateway's config.
    channel : str or None
        Interface; None: a socket pair.
    seed : int
    """

    def __init__(self, plan: Plan, database: Database, channel: str | None = None, seed: int = 0) -> None:
        self._plan, self._database, self._channel = plan, database, channel
        self._seconds = [s.frames for s in Drive(plan, database, seed).seconds(DRIVE_S)]

    def run(self, scenario: Scenario, fault: Fault, *, small_buffer: bool = False, load: int = 0) -> Outcome:
        """Run one scenario from a fresh start to its recovery; `load` frames/s of others fill the bus meanwhile.

        Raises
        ------
        BusError
            The interface cannot be used, or does not carry the traffic at all.
        """
        return judge(scenario, asyncio.run(self._run(scenario, fault, small_buffer=small_buffer, load=load)))

    async def _run(self, scenario: Scenario, fault: Fault, *, small_buffer: bool, load: int) -> Record:
        engine = Engine(self._plan, self._database)
        own, wanted = engine.sends, tuple(engine.can_ids.tolist())
        buffer = SMALL_BUFFER if small_buffer else RECEIVE_BUFFER
        pair: socket.socket | None = None
        if self._channel is None:
            ours, pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            pair.setblocking(False)
            port = RefusingPort("pair", wanted=wanted, own=own, sock=ours, receive_buffer=buffer)
            ears = SocketCanPort.over(pair)
        else:
            port = RefusingPort(self._channel, wanted=wanted, own=own, receive_buffer=buffer)
            ears = SocketCanPort(self._channel, wanted=own)
        vehicle = Vehicle(self._channel, pair)
        bench = LiveBench(self._channel, port, tuple(own), wanted, vehicle.raw, vehicle.send)
        run = _LiveRun(scenario, bench, ears, vehicle, Bystander(self._plan, self._database), self._seconds)
        run.load = load
        gateway = Gateway(engine, port, watch=run.watch)
        run.engine = engine
        try:
            with _listening(run.tell):
                work = asyncio.ensure_future(gateway.run())
                try:
                    return await run.drive(fault)
                finally:
                    os.kill(os.getpid(), signal.SIGTERM)  # as systemd stops the service
                    await work
        finally:
            vehicle.close()
            port.close()
            ears.close()


class _LiveRun:
    """State of one run."""

    def __init__(
        self,
        scenario: Scenario,
        bench: LiveBench,
        ears: SocketCanPort,
        vehicle: Vehicle,
        bystander: Bystander,
        seconds: list[FrameBatch],
    ) -> None:
        self.scenario, self.bench, self.ears = scenario, bench, ears
        self.vehicle, self.bystander, self.seconds = vehicle, bystander, seconds
        self.record = Record(np.inf, np.inf)
        self.engine: Engine | None = None
        self.load = 0
        self._begun = time.monotonic()
        self._sent_s = 0.0
        self._cells = len(bystander.cells)

    @property
    def now_s(self) -> float:
        return time.monotonic() - self._begun

    def tell(self, code: str, text: str) -> None:
        self.record.lines.append(Line(self.now_s, code, text))

    def watch(self, event: Event) -> None:
        if isinstance(event, Notice):
            self.tell(event.code, event.text)

    async def drive(self, fault: Fault) -> Record:
        """Warm up, break, wait for the end of the fault and of its consequences."""
        record = self.record
        while not self._steady():
            if self.now_s > WARM_MOST_S:
                raise BusError(f"{self.bench.channel or 'the socket pair'}: no steady estimates: is the bus free?")
            await self._until(self.now_s + 1.0)
        record.start_s = self.now_s
        doing = asyncio.ensure_future(fault(self.bench))
        while not doing.done():
            await self._until(self.now_s + 0.25, doing)
        await doing
        record.end_s = self.now_s
        sound = 0
        while sound < STEADY and self.now_s - record.end_s < self.scenario.recovers_s + STEADY + 1.0:
            await self._until(self.now_s + 1.0)
            sound = sound + 1 if is_sound(record.seen[-1], record.before()) else 0
        return record

    def _steady(self) -> bool:
        last = self.record.seen[-STEADY_FIRST:]
        alike = len(last) == STEADY_FIRST and all(
            s.state == last[0].state == 1 and (s.quality == last[0].quality).all() for s in last
        )
        return alike and bool(np.isfinite(last[-1].sd).all())

    async def _until(self, end_s: float, doing: "asyncio.Future[None] | None" = None) -> None:
        """Keep the pack talking for a second of the bench, or until the fault is over; then sum up."""
        while self.now_s < end_s or (doing is not None and not doing.done() and self.now_s < end_s + 0.75):
            self._send_due()
            self.ears.pump()
            self.bystander.take(self.ears.drain())
            await asyncio.sleep(SLICE_S)
            if doing is not None and doing.done():
                break
        nowhere = np.full(self._cells, np.nan)  # the truth of the drive is that of another start
        seen = self.bystander.close_second(self.now_s, nowhere, self._counts())
        self.record.seen.append(seen)

    def _send_due(self) -> None:
        now, self._sent_s = self._sent_s, self.now_s
        if self.bench.hushed:
            return
        if others := round(self.load * min(self._sent_s - now, MOST_BEHIND_S)):
            self.vehicle.send(foreign_frames(others))
        whole = range(int(now), int(self._sent_s) + 1)
        for k in whole:
            frames = self.seconds[k % len(self.seconds)]
            base = k % len(self.seconds) * SECOND
            since, until = (round((x - k) * SECOND) + base for x in (now, self._sent_s))
            a, b = np.searchsorted(frames.time_ns, [since, until]).tolist()
            if b > a:
                self.vehicle.send(frames[a:b])

    def _counts(self) -> dict[str, int]:
        c = self.bench.port.counters
        counts = {name: getattr(c, name) for name in ("dropped", "stale", "outages", "impostors", "sent", "limited")}
        counts |= {f"error_{name}": n for name, n in c.errors.items()}
        engine = self.engine
        return counts | dict(chain(engine.rejected.items(), engine.clock_counts.items()) if engine is not None else ())
