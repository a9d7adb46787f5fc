"""The bench for faults of the bus itself: in real time, with the service's own loop on the interface.

The simulated pack sends in real time, the gateway runs as under `run`, and the fault is injected into the interface
between them. Without an interface, a socket pair takes its place, and faults that need the kernel are left out.
"""

import asyncio
import logging
import socket
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np

from bms_gateway.bus.access import Access
from bms_gateway.bus.canframe import to_wire
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import RECEIVE_BUFFER, SocketCanPort
from bms_gateway.bus.traffic import SECOND
from bms_gateway.chaos.observed_run import Bystander, Line, Record
from bms_gateway.chaos.scenario import STEADY, Outcome, Scenario, is_sound, judge
from bms_gateway.chaos.simulated_pack import Drive
from bms_gateway.engine import Engine, Event, Notice, Plan, StartJob
from bms_gateway.engine.events import Job
from bms_gateway.errors import BusError
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.service.fit_process import Aside
from bms_gateway.service.live import Gateway, Jobs
from bms_gateway.service.reread import reread
from bms_gateway.store import StateStore

WARM_MOST_S = 60.0  # a slow machine may need this long for what normally takes three seconds
STEADY_FIRST = 3  # seconds that must look alike before a fault is injected
SLICE_S = 0.02
SMALL_BUFFER = 64 << 10  # receive buffer of the gateway's socket, for a burst that must overflow it
DRIVE_S = 300
FOREIGN_ID = 0x7E5
NO_JOB, MINUTE_NS = -1, 60 * SECOND
SAVE_S = 0.5  # between two saves of the gateway: with the usual minute, a scenario would end before a save
FIT_S = 3.0  # a fit that takes longer is killed
MOST_BEHIND_S = 0.1  # a machine that is too slow for this load sends what it can


def foreign_frames(count: int) -> FrameBatch:
    """Make frames that no node of the bench wants."""
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
    """The parts of the bench that a fault may use and change.

    Attributes
    ----------
    channel : str or None
        Interface; None: a socket pair.
    port : RefusingPort
        The gateway's.
    own : tuple of int
        Identifiers that the gateway sends.
    wanted : tuple of int
        Identifiers that it reads.
    raw : callable
        Puts one frame in the kernel's layout on the bus, without a check.
    send_all : callable
        Puts data frames of any sender on the bus.
    """

    channel: str | None
    port: RefusingPort
    own: tuple[int, ...]
    wanted: tuple[int, ...]
    raw: Callable[[bytes], None]
    send_all: Callable[[FrameBatch], object]
    folder: Path
    """Where the gateway keeps its state."""
    disk: threading.Event
    """Set while the disk answers."""
    hushed: bool = False
    """Whether the pack is silent."""
    config: Path = Path()
    """Config that a reload reads."""
    talk: Callable[[], None] = lambda: None
    """Puts all frames that are due on the bus; for faults that block the loop."""
    counts: Counter[str] = field(default_factory=Counter)
    """Counts of the fault itself, for the expected reactions."""

    def count(self, name: str) -> None:
        """Count something that happened."""
        self.counts[name] += 1

    @property
    def engine(self) -> Engine:
        """The present engine of the gateway."""
        assert isinstance(self.gateway.engine, Engine)  # noqa: S101 (the bench has no other)
        return self.gateway.engine

    @property
    def gateway(self) -> Gateway:
        """The gateway as it runs."""
        assert self._gateway is not None  # noqa: S101 (a fault begins after it)
        return self._gateway

    _gateway: Gateway | None = None

    def start_fit(self, job: Job) -> None:
        """Make the gateway start a job that its engine has not handed out."""
        now_ns = self.port.now_ns()
        self.gateway.start_job(StartJob(now_ns, NO_JOB, now_ns + MINUTE_NS, job))

    async def ip(self, words: str) -> None:
        """Run `ip link`.

        Raises
        ------
        BusError
            The command failed: missing rights, or no such interface.
        """
        process = await asyncio.create_subprocess_exec("ip", "link", *words.split(), stderr=asyncio.subprocess.PIPE)
        _, said = await process.communicate()
        if process.returncode:
            raise BusError(f"ip link {words}: {said.decode().strip()}")


Fault = Callable[[LiveBench], Awaitable[None]]


class Vehicle:
    """Sends the pack's frames when they are due; while the interface is absent, due frames are lost.

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
        """Send all frames; False if the interface is absent and the number of sent frames is unknown."""
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
            with suppress(BlockingIOError):  # no reader: the frame is lost, as on a bus
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
        code = getattr(record, "code", "bus")
        if record.name.startswith("bms_gateway.bus") or code in ("fit", "save"):
            self._told(code, record.getMessage())


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


@dataclass(frozen=True, slots=True)
class BusScenario:
    """A scenario in real time, with the function that injects the fault.

    Attributes
    ----------
    scenario : Scenario
    fault : Fault
    small_buffer : bool
        Whether the receive buffer of the gateway's socket is small.
    load : int
        Frames of other nodes beside those of the pack, 1/s.
    all_frames : bool
        Whether the gateway's port receives these frames too, as if it needed their identifiers.
    """

    scenario: Scenario
    fault: Fault
    small_buffer: bool = False
    load: int = 0
    all_frames: bool = False


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

    def run(self, played: BusScenario) -> Outcome:
        """Run one scenario from a fresh start to its recovery.

        Raises
        ------
        BusError
            The interface cannot be used, or does not carry the traffic at all.
        """
        with tempfile.TemporaryDirectory() as folder:
            engine = Engine(self._plan, self._database)
            return judge(played.scenario, asyncio.run(self._run(played, engine, Path(folder))))

    async def _run(self, played: BusScenario, engine: Engine, folder: Path) -> Record:
        wanted = (*engine.can_ids.tolist(), *([FOREIGN_ID] if played.all_frames else []))
        own = engine.sends
        access = Access(wanted, own=own)
        buffer = SMALL_BUFFER if played.small_buffer else RECEIVE_BUFFER
        pair: socket.socket | None = None
        if self._channel is None:
            ours, pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            pair.setblocking(False)
            port = RefusingPort.over(ours, access, receive_buffer=buffer)
            ears = SocketCanPort.over(pair)
        else:
            port = RefusingPort(self._channel, access, receive_buffer=buffer)
            ears = SocketCanPort(self._channel, Access(own))
        vehicle = Vehicle(self._channel, pair)
        disk, store, fits = threading.Event(), StateStore(folder), Aside(FIT_S)
        disk.set()
        ended, saving = threading.Event(), threading.Lock()

        def save(state: Mapping[str, object]) -> None:
            disk.wait()
            with saving:
                if ended.is_set():  # a save that hung goes on when its disk answers, and the folder is removed
                    return
                if (problem := store.save(state, wall_ns=time.time_ns())) is not None:
                    raise problem

        async def reload() -> Engine:
            return (await reread(bench.config)).engine()

        def end_jobs() -> None:
            disk.set()  # a service that stops during this fault would wait for the disk
            fits.close()

        bench = LiveBench(self._channel, port, tuple(own), wanted, vehicle.raw, vehicle.send, folder, disk)
        run = _LiveRun(played.scenario, bench, ears, vehicle, Bystander(self._plan, self._database), self._seconds)
        run.load = played.load
        gateway = Gateway(engine, port, watch=run.watch, save=save, reload=reload, jobs=Jobs(fits.run, end_jobs))
        gateway.save_every_s = SAVE_S
        gateway.unread = lambda: store.unread
        bench._gateway, bench.talk = gateway, run.send_due
        run.engine = engine
        try:
            with _listening(run.tell):
                work, driven = asyncio.ensure_future(gateway.run()), asyncio.ensure_future(run.drive(played.fault))
                try:
                    await asyncio.wait((work, driven), return_when=asyncio.FIRST_COMPLETED)
                    if not driven.done():
                        driven.cancel()
                        await asyncio.wait((driven,))
                finally:
                    disk.set()
                    gateway.stop()
                    await work
                if gateway.ended_by is not None:
                    raise KeyboardInterrupt  # the service has replaced this handler while it ran
                return await driven
        finally:
            with saving:
                ended.set()
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
        """Warm up, inject the fault, and wait until the fault and its consequences are over."""
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
        """Let the pack send for a second of the bench, or until the fault is over; then close the second."""
        while self.now_s < end_s or (doing is not None and not doing.done() and self.now_s < end_s + 0.75):
            self.send_due()
            self.ears.pump()
            self.bystander.take(self.ears.drain())
            await asyncio.sleep(SLICE_S)
            if doing is not None and doing.done():
                break
        nowhere = np.full(self._cells, np.nan)  # the true cores of the drive belong to another start
        seen = self.bystander.close_second(self.now_s, nowhere, self._counts())
        self.record.seen.append(seen)

    def send_due(self) -> None:
        """Put the frames that are due on the bus."""
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
        names = ("dropped", "stale", "outages", "impostors", "sent", "limited", "misdated")
        counts = {name: getattr(c, name) for name in names}
        gateway = self.bench.gateway
        told = ("saves", "saves_failed", "jobs_failed", "reloads_refused")
        counts |= {name: getattr(gateway.tally, name) for name in told}
        counts["unread"] = int(bool(gateway.unread()))
        counts |= self.bench.counts
        counts |= {f"error_{name}": n for name, n in c.errors.items()}
        engine = self.engine
        return counts | dict(chain(engine.rejected.items(), engine.clock_counts.items()) if engine is not None else ())
