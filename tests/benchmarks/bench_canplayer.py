"""A log with estimates against a log only played: `analyze` and `canplayer -t` on one candump file, in frames/s.

``tests/canvm/canvm python -m tests.benchmarks.bench_canplayer [--json FILE] [--rounds N]``, or without canvm where
there is a vcan0 and can-utils is installed. `canplayer -t` reads the log and puts every frame on vcan0 as fast as it
can, where nobody listens; it decodes and estimates nothing. `analyze` is the whole command: start of the interpreter,
reading, decoding, estimates, tables written. The log is the example pack's minute among other traffic of a full
1 Mbit/s bus. Whole processes, in alternating rounds, by the wall and by CPU time. System calls are dear under canvm
(about five times), and canplayer makes one a frame: on bare iron the distance is smaller.
"""

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests.benchmarks.bench_files import CROWDED_S, EXAMPLE, FULL_BUS, crowd, simulate
from tests.benchmarks.live_place import channel
from tests.benchmarks.rounds import ROUNDS

FRAMES = FULL_BUS * CROWDED_S


def once(words):
    """Seconds of the wall and of CPU that a command takes."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return {"wall_s": wall, "cpu_s": used}


def measure(folder, rounds):
    """Both commands, in turn."""
    quiet, log = folder / "quiet.log", folder / "crowded.log"
    simulate(quiet, CROWDED_S)
    crowd(quiet, log)
    interface = log.read_text().split(maxsplit=2)[1]
    ours = [sys.executable, "-m", "bms_gateway", "analyze", log, "--config", EXAMPLE, "--out", folder / "out"]
    theirs = ["canplayer", "-t", "-I", log, f"{channel()}={interface}"]
    found = {"analyze": [], "canplayer": []}
    for number in range(rounds + 1):
        for name, words in (("analyze", ours), ("canplayer", theirs)):
            shutil.rmtree(folder / "out", ignore_errors=True)
            took = once(words)
            if number:  # the first round fills caches
                found[name].append(took)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    if channel() is None or shutil.which("canplayer") is None:
        sys.exit("needs vcan0 and can-utils: tests/canvm/canvm python -m tests.benchmarks.bench_canplayer")
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), args.rounds)
    print(f"{FRAMES} frames, {args.rounds} alternating rounds")
    for name, rounds in found.items():
        for kind in ("wall_s", "cpu_s"):
            rates = sorted(FRAMES / took[kind] for took in rounds)
            spread = f"{statistics.median(rates):,.0f} (min {rates[0]:,.0f}, max {rates[-1]:,.0f})"
            print(f"{name:10} {kind:8} {spread} frames/s")
    ratios = {}
    for kind in ("wall_s", "cpu_s"):
        pairs = zip(found["canplayer"], found["analyze"], strict=True)
        ratios[kind] = ratio = sorted(theirs[kind] / ours[kind] for theirs, ours in pairs)
        print(
            f"canplayer -t / analyze, {kind}: {statistics.median(ratio):.2f} (min {ratio[0]:.2f}, max {ratio[-1]:.2f})"
        )
    if args.json:
        args.json.write_text(json.dumps({"frames": FRAMES, "rounds": found, "ratios": ratios}))


if __name__ == "__main__":
    main()
