"""Start of the service, and what it holds while live: `python -m tests.benchmarks.bench_start [--json FILE]`.

All that `run` does until it could tell READY: its imports, DBC, config and engine of the example pack. Beside it, in
alternating rounds of fresh processes, `import numpy` alone; CPU time of each process, and time of the wall. Then the
greatest resident memory of a process that runs the gateway's own loop for some seconds above a socket pair, fed with
the pack's traffic by another process.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROUNDS = 7
NUMPY = "import numpy"
READY = """
import logging
from pathlib import Path
from bms_gateway.cli.run import engine_of
from bms_gateway.config.load import load_config
import bms_gateway.bus.socketcan, bms_gateway.service.live
engine_of(load_config(Path("deploy/example/gateway.toml")), None, logging.getLogger())
"""
LIVE = """
import asyncio, logging, os, signal, socket, threading
from pathlib import Path
from bms_gateway.bus.socketcan import SocketCanPort
from bms_gateway.cli.run import engine_of
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
engine = engine_of(load_config(Path("deploy/example/gateway.toml")), None, logging.getLogger())
asyncio.run(Gateway(engine, SocketCanPort.over(ours, own=engine.sends)).run(seconds=20.0))
os.kill(vehicle, signal.SIGKILL)
os.waitpid(vehicle, 0)
print(peak_mib(), engine.frames)
"""


def one(code: str) -> tuple[float, float]:
    """CPU time and time of the wall of a fresh interpreter that runs some code, s."""
    before, began = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
    wall, after = time.perf_counter() - began, os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return used, wall


def main() -> None:
    """Print both, and the ratio round by round."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    codes = {"import numpy": NUMPY, "until READY": READY}
    for code in codes.values():
        one(code)
    rounds: dict[str, list[tuple[float, float]]] = {name: [] for name in codes}
    for _ in range(ROUNDS):
        for name, code in codes.items():
            rounds[name].append(one(code))
    found = {name: {"cpu_s": [c for c, _ in r], "wall_s": [w for _, w in r]} for name, r in rounds.items()}
    for name, f in found.items():
        cpu, wall = sorted(f["cpu_s"]), sorted(f["wall_s"])
        print(
            f"{name}: {statistics.median(cpu):.3f} s CPU ({cpu[0]:.3f} to {cpu[-1]:.3f}), "
            f"{statistics.median(wall):.3f} s ({wall[0]:.3f} to {wall[-1]:.3f})"
        )
    ratio = [r / n for r, n in zip(found["until READY"]["cpu_s"], found["import numpy"]["cpu_s"], strict=True)]
    print(f"until READY / import numpy: {statistics.median(ratio):.2f} ({min(ratio):.2f} to {max(ratio):.2f})")
    done = subprocess.run([sys.executable, "-c", LIVE], check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    peak, frames = done.stdout.split()
    print(f"live, 60 cells: peak {float(peak):.1f} MiB resident after {frames} frames")
    if args.json:
        args.json.write_text(json.dumps({"rounds": found, "ratio": ratio, "live_mib": float(peak)}))


if __name__ == "__main__":
    main()
