"""The bench for faults of sensors, frames and clocks: bus time advances in steps, as fast as the machine allows.

Every tenth of a second of bus time, the pack's frames are put on the bus, the gateway's port is drained into the
engine, and the frames of the engine are sent and read by another node. The bus is an interface or lies in this process;
port, bus clock, engine and frames are those of the service. Faults that need real time (outages of the interface,
queues) run on the live bench.
"""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bms_gateway.bus.access import Access
from bms_gateway.bus.clock import BusClock
from bms_gateway.bus.in_process import MemoryBus, MemoryPort
from bms_gateway.bus.port import Port
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.bus.traffic import SECOND
from bms_gateway.chaos.observed_run import Bystander, Line, Record
from bms_gateway.chaos.scenario import STEADY, Outcome, Scenario, is_sound, judge
from bms_gateway.chaos.simulated_pack import Drive, Incident, Second
from bms_gateway.engine import Engine, Notice, Plan, SendFrames, drain
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database
from bms_gateway.service.turns import SETTLE_NS
from bms_gateway.store import StateStore, Trial

SLICE_NS = SECOND // 10
LONG_S = 180  # only this much of a longer rest is run step by step; afterwards the engine sleeps
SAVE_S = 60  # as the service saves
USED = {"state", "state.previous", "state.trying", "state.new"}


class EndedError(Exception):
    """Stands for a bug that ends the service."""


class Bus:
    """The vehicle, the gateway's port and a bystander that listens to the gateway, on one bus.

    Parameters
    ----------
    channel : str or None
        A SocketCAN interface; None: a bus inside this process.
    engine : Engine
        Its identifiers set the filters and what may be sent.
    """

    def __init__(self, channel: str | None, engine: Engine) -> None:
        self._vehicle: MemoryPort | SocketCanSender
        self._gateway: Port
        self._bystander: Port
        if channel is None:
            bus = MemoryBus()
            self._vehicle, self._gateway, self._bystander = bus.port(), bus.port(), bus.port()
        else:
            self._vehicle = SocketCanSender(channel)
            # Bus time passes faster than the clock here, so the rate may be higher too.
            self._gateway = SocketCanPort(channel, Access(engine.can_ids.tolist(), own=engine.sends, rate=1e6))
            self._bystander = SocketCanPort(channel, Access(engine.sends))

    def put(self, frames: FrameBatch) -> None:
        """Send frames of the vehicle; the bystander ignores them."""
        self._vehicle.send(frames)
        self._bystander.drain()

    def take(self) -> FrameBatch:
        """Give what the gateway's port has received."""
        return self._gateway.drain()

    def answer(self, frames: FrameBatch) -> None:
        """Send frames of the gateway, through its port."""
        now = np.full(len(frames), self._gateway.now_ns(), np.int64)
        self._gateway.send(FrameBatch(now, frames.can_id, frames.length, frames.data))
        while self._gateway.pump() is not None:
            pass

    def overhear(self) -> FrameBatch:
        """Give what the bystander has received."""
        return self._bystander.drain()

    def close(self) -> None:
        """Leave the bus."""
        for end in (self._vehicle, self._gateway, self._bystander):
            end.close()


class SteppedBench:
    """Runs scenarios in steps of bus time.

    Parameters
    ----------
    plan, database
        Of the gateway's config.
    channel : str or None
        Interface; None: a bus in this process.
    seed : int
        Of the simulated pack.
    """

    def __init__(self, plan: Plan, database: Database, channel: str | None = None, seed: int = 0) -> None:
        self._plan, self._database, self._channel, self.seed = plan, database, channel, seed

    def run(self, scenario: Scenario) -> Outcome:
        """Run one scenario from a fresh start to its recovery."""
        return judge(scenario, self.record(scenario))

    def engine(self) -> Engine:
        """Make the gateway's engine anew."""
        return Engine(self._plan, self._database)

    def bystander(self) -> Bystander:
        """Make a node that listens to the bus."""
        return Bystander(self._plan, self._database)

    def record(self, scenario: Scenario) -> Record:
        """Run one scenario and return its record."""
        injection = scenario.injection
        record = Record(scenario.warm_s, scenario.warm_s + scenario.lasts_s)
        fault_s = record.start_s, record.end_s
        seconds = int(record.end_s + scenario.recovers_s + STEADY)
        drive = Drive(
            self._plan,
            self._database,
            self.seed,
            incident=Incident(
                changes=injection.values,
                fault_s=fault_s,
                rest_s=(0.0, np.inf) if injection.rests else fault_s if injection.parked else None,
                fault=None if injection.pack is None else replace(injection.pack, during_s=fault_s),
            ),
            cycle=injection.cycle,
        )
        engine = self.engine()
        bus = Bus(self._channel, engine)
        try:
            with TemporaryDirectory(prefix="bms-gateway-chaos-") as folder:
                run = _Run(self, scenario, record, engine, bus, Path(folder))
                for k, second in enumerate(drive.seconds(seconds)):
                    run.second(k, second)
                    if run.recovered:
                        break
        finally:
            bus.close()
        return record


class _Run:
    """State of one run."""

    def __init__(
        self,
        bench: SteppedBench,
        scenario: Scenario,
        record: Record,
        engine: Engine,
        bus: Bus,
        folder: Path,
    ) -> None:
        self.scenario, self.record, self.bus, self.bystander = scenario, record, bus, bench.bystander()
        self.engine: Engine | None = engine
        self.fresh = bench.engine
        self._store = StateStore(folder)
        self._stopped = False
        self._rng = np.random.default_rng([bench.seed, 0xFA])
        self._steady_ns = 0
        self._wall_off_ns = round(scenario.injection.epoch_s * 1e9)
        self._clock = BusClock(lambda: self._steady_ns + self._wall_off_ns, lambda: self._steady_ns)
        self._sound = 0
        self._stepped = False

    @property
    def recovered(self) -> bool:
        """Whether all is as before the fault, for long enough."""
        return self._sound >= STEADY

    def second(self, k: int, second: Second) -> None:
        """Go through bench time k…k + 1 s."""
        injection, record = self.scenario.injection, self.record
        during = record.start_s <= k < record.end_s
        if during and not self._stepped:
            self._wall_off_ns += round(injection.wall_s * 1e9)
            self._stepped = True
        if injection.restart:
            if k == record.start_s - SAVE_S:
                self._save(k)
            self._restart(k, during)
        if during and injection.parked:
            if k - record.start_s > LONG_S and k < record.end_s - 1:
                return  # the engine sleeps: nothing happens while the clocks go on
            self._step((k + 1) * SECOND, during=True)
        else:
            self._slices(k, second.frames, during)
        seen = self.bystander.close_second(k + 1.0, second.truth, self._counts())
        record.seen.append(seen)
        if k >= record.end_s:
            self._sound = self._sound + 1 if is_sound(seen, record.before()) else 0

    def _slices(self, k: int, frames: FrameBatch, during: bool) -> None:
        injection = self.scenario.injection
        edges = np.searchsorted(frames.time_ns, k * SECOND + SLICE_NS * np.arange(11)).tolist()
        for i in range(10):
            part = frames[edges[i] : edges[i + 1]]
            if during and injection.frames is not None:
                part = injection.frames(part, self._rng)
            if len(part):
                self.bus.put(part)
            self._step(k * SECOND + (i + 1) * SLICE_NS, during)

    def _step(self, steady_ns: int, during: bool) -> None:
        """Advance the time to `steady_ns`, and let the gateway do what is due."""
        before, self._steady_ns = self._steady_ns, steady_ns
        self._clock.begin()
        arrived = self.bus.take()
        if self.engine is None:
            return
        now = self._clock.now_ns()
        if len(arrived):
            span = min(steady_ns - before, SLICE_NS)
            wall = steady_ns + self._wall_off_ns - span + span * np.arange(1, len(arrived) + 1) // (len(arrived) + 1)
            if during and self.scenario.injection.stamps is not None:
                wall = self.scenario.injection.stamps(wall, self._rng)
            time_ns = self._clock.to_bus(wall)
            self.engine.receive(FrameBatch(time_ns, arrived.can_id, arrived.length, arrived.data), now_ns=now)
        self.engine.handle_timer(now_ns=now - SETTLE_NS)
        for event in drain(self.engine):
            if isinstance(event, SendFrames):
                self.bus.answer(event.batch)
            elif isinstance(event, Notice):
                self.record.lines.append(Line(steady_ns / SECOND, event.code, event.text))
        self.bystander.take(self.bus.overhear())

    def _save(self, k: int) -> None:
        if self.engine is not None and (problem := self._store.save(self.engine.snapshot(), wall_ns=k)) is not None:
            raise problem

    def _restart(self, k: int, during: bool) -> None:
        injection = self.scenario.injection
        if during and not self._stopped:
            self._save(k)
            if injection.stored is not None:
                injection.stored(self._store.directory)
            self.engine, self._stopped = None, True
        elif self._stopped and self.engine is None and (injection.ends or not during):
            self._start()

    def _start(self) -> None:
        """Start as the service does; with `ends`, the service ends again at once if it finds a state."""
        trial, engine = Trial(self._store.directory, "bench"), self.fresh()

        def use(state: dict[str, Any]) -> None:
            nonlocal engine
            engine = self.fresh()
            engine.restore(state)

        found = self._store.load(use, trial)
        if self.scenario.injection.ends and found.state is not None:
            with suppress(EndedError), trial.noting():
                raise EndedError("the first tick is too much for it")
            return
        trial.over()
        self.engine = engine if found.state is not None else self.fresh()
        self._clock = BusClock(lambda: self._steady_ns + self._wall_off_ns, lambda: self._steady_ns)

    def _counts(self) -> dict[str, int]:
        aside = sum(file.name not in USED for file in self._store.directory.iterdir())
        counts = {"clock_steps": self._clock.steps, "misdated": self._clock.misdated, "set_aside": aside}
        if self.engine is not None:
            counts |= self.engine.rejected | self.engine.clock_counts
        return counts
