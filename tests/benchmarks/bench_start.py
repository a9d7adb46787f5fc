"""Start of the service, and what it holds: `python -m tests.benchmarks.bench_start [--json FILE]`.

`run` with the example pack until it tells READY, in alternating rounds of fresh processes beside `import numpy`: CPU
time of all threads, from the start of the interpreter on; a socket pair stands in for the CAN socket. Then the same
with a DBC of the user's of 1,600 signals beside ours: parsed at the first start, read from its table at the next. All
with compiled bytecode, as after an installation. Then where the time goes, by room; resident memory at READY and after
twenty seconds of the pack's traffic; and what a fit of one window takes in the process of its own that it runs in, and
would take within the service.
"""

import argparse
import json
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "deploy" / "example"
ROUNDS = 9
PATIENCE_S = 120.0
NUMPY = "import numpy, sys; print('there', flush=True); sys.stdin.read()"
SERVICE = """
import socket, sys
from bms_gateway.cli import main, run
def port(loaded, engine):
    from bms_gateway.bus.access import Access
    from bms_gateway.bus.socketcan import SocketCanPort
    ours, run.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    return SocketCanPort.over(ours, Access(own=engine.sends))
run._port = port
sys.exit(main.main(["run", sys.argv[1]]))
"""
LIVE = """
import asyncio, gc, logging, os, signal, socket, threading
from pathlib import Path
from bms_gateway.bus.access import Access
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.config.load import load_config
from bms_gateway.service.live import Gateway
from tests.memory import peak_mib
ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
if not (vehicle := os.fork()):
    from tests.benchmarks.bench_workbench import feed
    ours.close()
    threading.Thread(target=lambda: [theirs.recv(100) for _ in iter(int, 1)], daemon=True).start()
    feed(theirs, 60.0)
    os._exit(0)
theirs.close()
engine = load_config(Path("deploy/example/gateway.toml")).engine()
asyncio.run(Gateway(engine, SocketCanPort.over(ours, Access(own=engine.sends))).run(seconds=20.0))
os.kill(vehicle, signal.SIGKILL)
os.waitpid(vehicle, 0)
print(peak_mib(), engine.frames)
"""
RECORD = """
import pickle, sys
from pathlib import Path
from bms_gateway.config.load import load_config
from bms_gateway.engine import Engine, StartJob
from tests.benchmarks.bench_workbench import traffic
loaded = load_config(Path("deploy/example/gateway.toml"))
engine, frames = Engine(loaded.plan, loaded.database), traffic(1500.0)
for k in range(0, len(frames), 5000):
    part = frames[k : k + 5000]
    engine.receive(part, now_ns=int(part.time_ns[-1]))
    while (event := engine.next_output()) is not None:
        if isinstance(event, StartJob):
            sys.stdout.buffer.write(pickle.dumps(event.job))
            sys.exit()
"""
WITHIN = """
import gc, logging, pickle, re, sys
from pathlib import Path
from bms_gateway.config.load import load_config
import bms_gateway.bus.socketcan, bms_gateway.service.live
from tests.memory import peak_mib
engine = load_config(Path("deploy/example/gateway.toml")).engine()
before, scipy = peak_mib(), "scipy" in sys.modules
pickle.load(sys.stdin.buffer).run()
print(before, peak_mib(), scipy or "scipy" in sys.modules)
"""
ASIDE = """
import io, sys
from bms_gateway.service.fit_process import work
from tests.memory import peak_mib
work(sys.stdin.buffer, io.BytesIO())
print(peak_mib())
"""


class Starts:
    """Fresh processes, watched until they are where they should be.

    Parameters
    ----------
    folder : Path
        For compiled bytecode, tables of DBC files and configs.
    """

    def __init__(self, folder: Path) -> None:
        self._told = str(folder / "notify")
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._listening.bind(self._told)
        self._listening.settimeout(PATIENCE_S)
        # Python itself, its libraries and ours, all from bytecode; the limit of threads is what the entry sets
        self.environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONDONTWRITEBYTECODE", "HOME")} | {
            "PYTHONPYCACHEPREFIX": str(folder / "bytecode"),
            "OPENBLAS_NUM_THREADS": "1",
            "CACHE_DIRECTORY": str(folder / "tables"),
            "PYTHONPATH": str(ROOT),
        }

    def numpy(self) -> float:
        """CPU time of an interpreter that has just imported numpy, s."""
        pipe = subprocess.PIPE
        with subprocess.Popen([sys.executable, "-c", NUMPY], env=self.environment, stdin=pipe, stdout=pipe) as p:
            assert p.stdout is not None
            p.stdout.readline()
            return cpu_s(p.pid)

    def service(self, config: Path, more: Mapping[str, str] | None = None) -> tuple[float, float]:
        """CPU time of the service that has just told READY, s, and its resident memory, MiB."""
        environment = self.environment | {"NOTIFY_SOCKET": self._told} | dict(more or {})
        words = [sys.executable, "-c", SERVICE, str(config)]
        with subprocess.Popen(words, env=environment, cwd=ROOT, stderr=subprocess.DEVNULL) as p:
            try:
                while b"READY=1" not in self._listening.recv(4096):
                    pass
                os.kill(p.pid, signal.SIGSTOP)
                found = re.search(r"VmRSS:\s*(\d+) kB", Path(f"/proc/{p.pid}/status").read_text())
                assert found
                return cpu_s(p.pid), int(found[1]) / 1024
            finally:
                p.kill()

    def run(self, code: str, given: bytes = b"", *words: str) -> bytes:
        """What some code writes, fed with some bytes."""
        done = subprocess.run(
            [sys.executable, *words, "-c", code],
            input=given,
            env=self.environment,
            cwd=ROOT,
            check=True,
            stdout=subprocess.PIPE,
        )
        return done.stdout


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, all threads, s."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((t / "schedstat").read_text().split()[0]) for t in tasks) / 1e9


def users_dbc() -> str:
    """A DBC of 80 messages of 20 signals."""
    lines = ['VERSION ""', "BS_:", "BU_: V"]
    for m in range(80):
        lines.append(f"BO_ {256 + m} V{m}: 40 V")
        lines += [f' SG_ s{m}_{k} : {16 * k}|16@1+ (0.01,-100) [-100|500] "degC" V' for k in range(20)]
    return "\n".join(lines) + "\n"


def by_room(starts: Starts, config: Path) -> dict[str, float]:
    """Time of imports until READY, by room of ours and by library, ms; the least of three looks."""
    best: dict[str, int] = {}
    code = SERVICE.replace(
        "sys.exit(", "import bms_gateway.service.live as live; live.notify = lambda *x: sys.exit()\nsys.exit("
    )
    for _ in range(3):
        words = [sys.executable, "-X", "importtime", "-c", code, str(config)]
        told = subprocess.run(
            words, env=starts.environment, cwd=ROOT, capture_output=True, text=True, check=False
        ).stderr
        for own, name in re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)$", told, re.M):
            best[name] = min(best.get(name, 1 << 40), int(own))
    rooms: dict[str, float] = {}
    for name, us in best.items():
        first, *rest = name.split(".")
        room = f"{first}.{rest[0]}" if first == "bms_gateway" and rest else "pydantic" if first in PYDANTIC else first
        room = (
            room
            if first in ("bms_gateway", "numpy", "asyncio", "scipy", "cantools", "can") or room == "pydantic"
            else "others"
        )
        rooms[room] = rooms.get(room, 0.0) + us / 1e3
    return dict(sorted(rooms.items(), key=lambda x: -x[1]))


PYDANTIC = {"pydantic", "pydantic_core", "annotated_types", "typing_extensions", "typing_inspection"}


def spread(values: list[float], digits: int = 3) -> str:
    """Median, with least and most."""
    return f"{statistics.median(values):.{digits}f} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def main() -> None:
    """Print all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bms-gateway-start-") as name:
        folder = Path(name)
        for file in EXAMPLE.glob("*.toml"):
            text = file.read_text()
            (folder / file.name).write_text(text)
            (folder / f"users-{file.name}").write_text(
                text.replace("# dbc = [", "dbc = [").replace("my_vehicle", "users")
            )
        (folder / "users.dbc").write_text(users_dbc())
        own, users = folder / "gateway.toml", folder / "users-gateway.toml"
        assert '\ndbc = ["users.dbc"]' in users.read_text()
        starts = Starts(folder)
        cold = {"CACHE_DIRECTORY": str(folder / "users.dbc" / "nowhere")}
        cases = {
            "until READY": lambda: starts.service(own),
            "with a user's DBC, parsed": lambda: starts.service(users, cold),
            "with a user's DBC, again": lambda: starts.service(users),
        }
        starts.numpy()
        for case in cases.values():
            case()
        rounds: dict[str, list[float]] = {"import numpy": []} | {case: [] for case in cases}
        memory: dict[str, list[float]] = {case: [] for case in cases}
        for _ in range(args.rounds):
            rounds["import numpy"].append(starts.numpy())
            for title, case in cases.items():
                cpu, resident = case()
                rounds[title].append(cpu)
                memory[title].append(resident)
        ratios = {t: [a / b for a, b in zip(rounds[t], rounds["import numpy"], strict=True)] for t in cases}
        print(f"import numpy: {spread(rounds['import numpy'])} s CPU")
        for title in cases:
            print(
                f"{title}: {spread(rounds[title])} s CPU, {spread(ratios[title], 2)} × import numpy; "
                f"{spread(memory[title], 1)} MiB resident"
            )
        rooms = by_room(starts, own)
        print("imports until READY, ms: " + ", ".join(f"{room} {ms:.1f}" for room, ms in rooms.items()))
        peak, frames = starts.run(LIVE).split()
        print(f"live, 60 cells: peak {float(peak):.1f} MiB resident after {int(frames)} frames")
        job = starts.run(RECORD)
        before, after, scipy = starts.run(WITHIN, job).split()
        aside = float(starts.run(ASIDE, job))
        print(f"a window's fit: {aside:.1f} MiB in its own process while it works; within the service ", end="")
        print(f"{float(before):.1f} → {float(after):.1f} MiB; scipy loaded: {scipy.decode()}")
        if args.json:
            found = {"rounds": {t: {"cpu_s": r} for t, r in rounds.items()}, "ratio": ratios["until READY"]}
            found |= {"ratios": ratios, "resident_mib": memory, "rooms_ms": rooms}
            found |= {"live_mib": float(peak), "fit_mib": aside, "fit_within_mib": [float(before), float(after)]}
            args.json.write_text(json.dumps(found))


if __name__ == "__main__":
    main()
