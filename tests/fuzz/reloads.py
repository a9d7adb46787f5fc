"""A service on a real interface that is told to read its config again, whatever is in its files by then.

The program itself, as `bms-gateway run`, on an interface on which a simulated pack talks; who listens on the bus tells
whether estimates went on, the service's own lines and systemd's protocol what became of each reload.
"""

import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from bms_gateway.bus.access import Access
from bms_gateway.bus.replay import SocketCanSender
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.bus.traffic import SECOND
from bms_gateway.chaos.simulated_pack import Drive
from bms_gateway.config import load_config
from bms_gateway.config.load import LoadedConfig
from tests.config.files import write
from tests.fuzz.configs import lay, spoilt
from tests.fuzz.targets import LONGEST

ROOT = Path(__file__).resolve().parents[2]
RUN = (
    "import sys\nfrom bms_gateway.service.journal import Throttle\nThrottle.filter = lambda *_: True\n"  # all lines
    "from bms_gateway.cli.main import main\nsys.exit(main(['run', sys.argv[1]]))"
)
PATIENCE_S = 120.0  # a reload gives up after 25 s; a guest on a busy machine may stand still for longer
LOOK_S = 0.02
DRIVE_S = 120
OUTCOME = re.compile(r"(?:INFO|ERROR) +(reloaded|not reloaded, going on as before: \S.*)$", re.MULTILINE)
PEAK = re.compile(r"VmHWM:\s*(\d+) kB")


@dataclass
class Found:
    """What came of the reloads.

    Attributes
    ----------
    taken, refused : int
    slowest_s : float
        From SIGHUP until the service was ready again, of the slowest; all of them in `seconds`.
    peak_MiB, child_MiB : float
        Most memory that the service, and a child that reads a config, ever held.
    gap_s : float
        Longest time between two frames of the gateway.
    """

    taken: int = 0
    refused: int = 0
    seconds: list[float] = field(default_factory=list)
    peak_MiB: float = 0.0
    child_MiB: float = 0.0
    gap_s: float = 0.0

    @property
    def slowest_s(self) -> float:
        return max(self.seconds)

    def __str__(self) -> str:
        return (
            f"{len(self.seconds)} reloads: {self.taken} taken, {self.refused} refused, no traceback, no exit; slowest "
            f"{self.slowest_s:.1f} s, in the middle {float(np.median(self.seconds)):.1f} s; most memory of the service "
            f"{self.peak_MiB:.0f} MiB, of a child that reads {self.child_MiB:.0f} MiB; "
            f"the gateway's frames were never further apart than {self.gap_s:.1f} s"
        )


class Reloads:
    """The service, and what happens around it; a context.

    Parameters
    ----------
    folder : Path
        For its files.
    channel : str
    """

    def __init__(self, folder: Path, channel: str = "vcan0") -> None:
        self._folder, self._channel = folder, channel
        self._told = folder / "stderr"
        self._over = threading.Event()
        self._threads: list[threading.Thread] = []
        self.found = Found()

    def __enter__(self) -> Self:
        folder = self._folder
        path = write(folder)
        loaded = load_config(path)
        self._sender, self._sends = SocketCanSender(self._channel), tuple(loaded.engine().sends)
        self._ears = SocketCanPort(self._channel, Access(self._sends))
        self._notified = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._notified.bind(str(folder / "notify"))
        self._notified.settimeout(PATIENCE_S)
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": str(folder / "notify"),
            "STATE_DIRECTORY": str(folder),
            "CACHE_DIRECTORY": str(folder / "tables"),
        }
        with self._told.open("wb") as err:
            words = [sys.executable, "-c", RUN, str(path)]
            self.process = subprocess.Popen(words, env=environment, cwd=ROOT, stderr=err)
        self._ready()
        for work in (lambda: self._talk(loaded), self._listen, self._watch):
            self._threads.append(threading.Thread(target=work, daemon=True))
            self._threads[-1].start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(PATIENCE_S)
        self.process.kill()
        self.process.wait()
        for thing in (self._notified, self._sender, self._ears):
            thing.close()

    def spoil(self, count: int, rng: random.Random) -> Found:
        """Reload spoilt files one after the other.

        Raises
        ------
        AssertionError
            The service ended, or said what is not one line; the file that did it is kept as ``fuzz-NAME``.
        """
        for _ in range(count):
            name, content = spoilt(rng)
            lay(self._folder, name, content)
            try:
                self.reload()
            except BaseException:
                Path(f"fuzz-{name}").write_bytes(content)
                raise
        return self.found

    def restore(self) -> None:
        """Put sound files back."""
        write(self._folder)

    def reload(self) -> str:
        """Send SIGHUP; returns the line of what came of it."""
        before, began = self._told.stat().st_size, time.monotonic()
        self.process.send_signal(signal.SIGHUP)
        self._ready()
        self.found.seconds.append(time.monotonic() - began)
        said = self._told.read_bytes()[before:].decode(errors="replace")
        assert "Traceback" not in said, said
        lines = OUTCOME.findall(said)
        assert len(lines) == 1, said
        assert len(lines[0]) < LONGEST, said
        taken = lines[0] == "reloaded"
        self.found.taken += taken
        self.found.refused += not taken
        return lines[0]

    def stop(self) -> int:
        """End the service as systemd does; its status."""
        self.process.terminate()
        return self.process.wait(PATIENCE_S)

    def _ready(self) -> None:
        while b"READY=1" not in self._notified.recv(4096):
            assert self.process.poll() is None, self._told.read_text()

    def _talk(self, loaded: LoadedConfig) -> None:
        """Be the pack, for ever."""
        made = [s.frames for s in Drive(loaded.plan, loaded.database).seconds(DRIVE_S)]
        began, second = time.monotonic(), 0
        while not self._over.is_set():
            frames, base_s = made[second % DRIVE_S], second % DRIVE_S
            for tenth in range(10):
                a, b = np.searchsorted(frames.time_ns, [round((base_s + t / 10) * SECOND) for t in (tenth, tenth + 1)])
                self._over.wait(max(0.0, began + second + tenth / 10 - time.monotonic()))
                self._sender.send(frames[a:b])
            second += 1

    def _listen(self) -> None:
        last_ns: int | None = None
        while not self._over.wait(0.1):
            self._ears.pump()
            for at in np.sort(self._ears.drain().time_ns).tolist():
                if last_ns is not None:
                    self.found.gap_s = max(self.found.gap_s, (at - last_ns) / SECOND)
                last_ns = at

    def _watch(self) -> None:
        """Note the peak of the service and of each child; one that is watched until it ends is told to some ms."""
        own = Path(f"/proc/{self.process.pid}")
        while not self._over.wait(LOOK_S):
            with suppress(OSError):
                self.found.peak_MiB = max(self.found.peak_MiB, _peak_MiB(own))
                for task in (own / "task").iterdir():
                    for child in (task / "children").read_text().split():
                        self.found.child_MiB = max(self.found.child_MiB, _peak_MiB(Path("/proc", child)))


def _peak_MiB(process: Path) -> float:
    found = PEAK.search((process / "status").read_text())
    return int(found[1]) / 1024 if found else 0.0
