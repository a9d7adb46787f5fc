"""Sources of frames for the live page: a port that only listens, or a log that is read ahead."""

import threading
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from bms_gateway.bus.logfile import read_log
from bms_gateway.bus.port import Counters, Link, Port
from bms_gateway.engine import Engine, drain
from bms_gateway.errors import GatewayError
from bms_gateway.frames.batch import EXTENDED, FrameBatch
from bms_gateway.workbench.live_estimates import Watch, bits_on_wire

SECOND = 1_000_000_000


class Listening:
    """A port that counts frames and never sends one."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.bits = 0
        self.counters: Counters = port.counters
        self.link: Link = port.link

    def traffic(self) -> dict[str, Any]:
        """Return the traffic so far, in the form for `Watch`."""
        c = self._port.counters
        return {"received": c.received, "dropped": c.dropped, "bits": self.bits, "link": self._port.link.value}

    @property
    def gather_s(self) -> float:
        """As for the port."""
        return self._port.gather_s

    @property
    def emptied(self) -> bool:
        """As for the port."""
        return self._port.emptied

    def fileno(self) -> int:
        """Descriptor of the port."""
        return self._port.fileno()

    def now_ns(self) -> int:
        """Bus time."""
        return self._port.now_ns()

    def drain(self) -> FrameBatch:
        """Return the arrived frames, and count them."""
        frames = self._port.drain()
        self.link = self._port.link
        if len(frames):
            self.bits += bits_on_wire(frames.can_id, frames.length, EXTENDED)
        return frames

    def send(self, frames: FrameBatch) -> None:
        """Send nothing."""

    def pump(self) -> float | None:
        """Reconnect if needed."""
        wait = self._port.pump()
        self.link = self._port.link
        return wait

    def close(self) -> None:
        """Close the bus."""
        self._port.close()


class Playback:
    """Runs the engine through logs, ahead of the tabs that show them.

    Parameters
    ----------
    logs : sequence of Path
    """

    def __init__(self, logs: Iterable[Path]) -> None:
        self._logs = list(logs)
        self._frames = self._bits = 0

    def traffic(self) -> dict[str, Any]:
        """Return what was read so far, in the form for `Watch`."""
        return {"received": self._frames, "dropped": 0, "bits": self._bits, "link": "log"}

    def start(self, engine: Engine, watch: Watch) -> None:
        """Begin; errors of a log are shown on the page."""
        threading.Thread(target=self._run, args=(engine, watch), daemon=True).start()

    def _run(self, engine: Engine, watch: Watch) -> None:
        try:
            for batch in self._seconds():
                engine.receive(batch, now_ns=int(batch.time_ns.max()))
                for event in drain(engine):
                    watch.take(event)
            if not engine.frames:
                watch.problem = f"{', '.join(map(str, self._logs))}: no frame carries a signal of the config"
        except GatewayError as e:
            watch.problem = " ".join(str(e).split())
        watch.whole = True

    def _seconds(self) -> Iterator[FrameBatch]:
        """Divide the log at whole seconds, so that each tick is processed separately."""
        for log in self._logs:
            for batch in read_log(log):
                second = batch.time_ns // SECOND
                edges = [0, *(np.flatnonzero(np.diff(second)) + 1).tolist(), len(batch)]
                for a, b in pairwise(edges):
                    part = batch[a:b]
                    if len(part):
                        self._frames += len(part)
                        self._bits += bits_on_wire(part.can_id, part.length, EXTENDED)
                        yield part
