"""A gateway with the real engine behind it, over a bus in the process, in time of its own."""

from dataclasses import replace

import numpy as np

from bms_gateway.bus.in_process import MemoryBus
from bms_gateway.engine import Engine
from bms_gateway.frames.batch import FrameBatch
from bms_gateway.frames.own_dbc import input_messages
from bms_gateway.health.alerts import AlertSettings
from bms_gateway.service.live import Gateway
from bms_gateway.service.watch import Watch
from tests.engine.packs import database, plan, traffic

S = 1_000_000_000


class Pack:
    """Two strings of four cells; `drive` brings the engine forward by seconds of traffic, without an event loop."""

    def __init__(self, seconds=40, settings=None):
        settings = settings or AlertSettings()
        self.engine = Engine(replace(plan(2), alerts=settings), database())
        self.bus = MemoryBus()
        self.port = self.bus.port()
        self.gateway = Gateway(self.engine, self.port)
        self.watch = Watch(self.gateway, lambda: self.engine, channel="can0", settings=settings)
        self.frames = traffic(seconds)
        self.start = int(self.frames.time_ns[0]) // S
        self.at = 0
        self.ids = {name: database().message(name).can_id for k in (1, 2) for name in input_messages(k)}
        self.changes = []
        self.watch.alerts.begin(float(self.start))
        self.watch.listeners.append(self.changes.append)

    def limit(self, core_max_C):
        """Another limit of the cores from now on, as no service has it."""
        self.engine.alerting.limits.core.limit = core_max_C

    def drive(self, seconds, without=()):
        """Seconds of traffic without some messages; alerts are looked at once a second, in bus time."""
        for _ in range(seconds):
            t = self.start + self.at
            f = self.frames
            chosen = (f.time_ns // S == t) & ~np.isin(f.can_id, [self.ids[name] for name in without])
            frames = FrameBatch(f.time_ns[chosen], f.can_id[chosen], f.length[chosen], f.data[chosen])
            self.port.counters.received += len(frames)
            self.engine.receive(frames, now_ns=(t + 1) * S)
            self.engine.handle_timer(now_ns=(t + 1) * S)
            self.gateway.put_out()
            self.at += 1
            self.watch.look(float(t))
        return self.watch.alerts.line
