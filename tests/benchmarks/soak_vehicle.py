"""The vehicle of a soak: a process of its own that puts a full bus of a simulated pack's frames on an interface.

The pack's current and voltage come as often as fills the bus, everything else at its usual cycle, so that the gateway
wants every frame: all of them are sound, with alive counter and check sum. What is wrong with them while a fault lasts
is done here too, by the injections of `bms_gateway.chaos`. A second is made while the one before it is on the bus.
"""

import ctypes
import multiprocessing
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bms_gateway.bus.traffic import SECOND
from bms_gateway.chaos.real_time import Vehicle
from bms_gateway.chaos.scenario import Injection
from bms_gateway.chaos.simulated_pack import Drive, Incident
from bms_gateway.engine.plan import Plan
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.database import Database

SLICE_S = 0.01
MOST_LATE_S = 0.3
"""A machine that gives the vehicle no time for longer makes the drive pause: what was due by then would come
faster than a bus carries, and without it alive counters would jump, which is a fault that nobody injected."""
NOTHING = -1


class Told(ctypes.Structure):
    """What both processes see: the first three are written by the one that breaks things."""

    _fields_ = (
        ("fault", ctypes.c_int),
        ("hushed", ctypes.c_bool),
        ("over", ctypes.c_bool),
        ("begun_s", ctypes.c_double),
        ("sent", ctypes.c_int64),
        ("unsent", ctypes.c_int64),
        ("pauses", ctypes.c_int64),
        ("paused_s", ctypes.c_double),
    )


class FullBus:
    """A pack's traffic at a rate, from a process of its own.

    Parameters
    ----------
    plan, database
        Of the gateway's config.
    rate : float, frames/s
    seconds : int
    injections : sequence of Injection
        What `fault` chooses from by its index.
    channel : str

    Attributes
    ----------
    told : Told
        `sent` frames; `unsent` while the interface was away or the pack said nothing; times and seconds by which the
        drive `paused` because this machine is too slow.
    truth : ndarray (seconds + 1, cells of all strings)
        Cores, °C, at whole seconds since the beginning; NaN where not driven yet.
    """

    def __init__(
        self, plan: Plan, database: Database, rate: float, seconds: int, injections: Sequence[Injection], channel: str
    ) -> None:
        cells = sum(s.model.cells for s in plan.strings)
        context: Any = multiprocessing.get_context("fork")
        self.told: Told = context.RawValue(Told)
        self.told.fault = NOTHING
        shared = context.RawArray("d", (seconds + 1) * cells)
        self.truth = np.frombuffer(shared, np.float64).reshape(seconds + 1, cells)
        self.truth[:] = np.nan
        self._injections, self._channel, self._seconds = injections, channel, seconds
        keys = {key for i in injections for key in i.values}
        changes = {key: lambda t, v, key=key: self._shown(key, t, v) for key in keys}
        fast = _at_rate(plan, database, rate)
        self._drive = Drive(plan, fast, incident=Incident(changes, (0.0, np.inf)))
        self._process = context.Process(target=self._run)
        self._process.start()  # before this process has threads

    @property
    def now_s(self) -> float:
        """Time of the drive, s: real time less its pauses."""
        return time.monotonic() - self.told.begun_s

    def start(self) -> None:
        """Begin to drive."""
        self.told.begun_s = time.monotonic()

    def stop(self) -> None:
        self.told.over = True
        self._process.join()

    def _shown(self, key, t, value):
        change = self._injections[self.told.fault].values.get(key) if self.told.fault != NOTHING else None
        return value if change is None else change(t, value)

    def _run(self) -> None:
        vehicle, rng, told = Vehicle(self._channel), np.random.default_rng(0), self.told
        while not told.begun_s and not told.over:
            time.sleep(SLICE_S)
        for second, made in enumerate(self._drive.seconds(self._seconds, at_once=1), 1):
            self.truth[second] = made.truth
            frames, at = made.frames, 0
            while at < len(frames) and not told.over:
                now = self.now_s
                late = now - int(frames.time_ns[at]) / SECOND
                if late > MOST_LATE_S:
                    told.pauses, told.paused_s = told.pauses + 1, told.paused_s + late
                    told.begun_s += late
                    continue
                end = int(np.searchsorted(frames.time_ns, round(now * SECOND)))
                if end > at:
                    self._send(vehicle, frames[at:end], rng)
                    at = end
                time.sleep(SLICE_S)
            if told.over:
                break
        vehicle.close()

    def _send(self, vehicle: Vehicle, frames: FrameBatch, rng: np.random.Generator) -> None:
        told = self.told
        change = self._injections[told.fault].frames if told.fault != NOTHING else None
        if change is not None:
            frames = change(frames, rng)
        if not told.hushed and vehicle.send(frames):
            told.sent += len(frames)
        else:
            told.unsent += len(frames)


def _at_rate(plan: Plan, database: Database, rate: float) -> Database:
    """The database with the messages of current so frequent that all of them come to a rate."""
    signals = [c.signal for s in plan.strings for c in s.channels if c.quantity == "current" and c.signal]
    names = {database.resolve(signal).message for signal in signals}
    cycle_ns = round(SECOND * len(names) / rate)
    messages = []
    for m in database.messages.values():
        if m.name in names:
            often = {name: replace(s, cycle_ns=cycle_ns) for name, s in m.signals.items()}
            m = replace(m, cycle_ns=cycle_ns, signals=often)
        messages.append(m)
    return Database(messages)
