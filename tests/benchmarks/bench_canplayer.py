"""A log with estimates against a log only played: `analyze` and `canplayer -t` on one candump file, in frames/s.

``tests/canvm/canvm python -m tests.benchmarks.bench_canplayer [--json FILE] [--rounds N]``, or without canvm where
there is a vcan0: `canplayer -t` (of can-utils) reads the log and puts every frame on vcan0 as fast as it can, where
nobody listens; it decodes and estimates nothing. `analyze` is the whole command: start of the interpreter, reading,
decoding, estimates, tables written. The log is the example pack's minute among other traffic of a full 1 Mbit/s bus.
Whole processes, in alternating rounds, by the wall and by CPU time.

System calls are dear under canvm (about five times) and canplayer makes one a frame, so there the figures flatter us.
Where there is no CAN at all, a C compiler given, canplayer's CAN socket is `/dev/null` instead: the least that it can
cost, since a real send does more. What it costs on a kernel with CAN on bare iron lies between the two.
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
NO_CAN = """
#include <fcntl.h>
#include <net/if.h>
#include <stdarg.h>
#include <sys/socket.h>
#include <unistd.h>
int socket(int family, int type, int protocol) { return open("/dev/null", O_WRONLY); }
int bind(int fd, const struct sockaddr *to, socklen_t size) { return 0; }
int setsockopt(int fd, int level, int name, const void *value, socklen_t size) { return 0; }
int ioctl(int fd, unsigned long request, ...) {
    va_list more;
    va_start(more, request);
    va_arg(more, struct ifreq *)->ifr_ifindex = 1;
    va_end(more);
    return 0;
}
ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t n) {
    return write(fd, data, size);
}
"""


def without_can(folder):
    """Compile what stands in for a CAN socket; gives the environment that puts it before canplayer."""
    library = folder / "no_can.so"
    words = ["cc", "-shared", "-fPIC", "-O2", "-w", "-o", library, "-x", "c", "-"]
    subprocess.run(words, input=NO_CAN, text=True, check=True)
    return {**os.environ, "LD_PRELOAD": str(library)}


def once(words, environment=None):
    """Seconds of the wall and of CPU that a command takes."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env=environment)
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
    theirs = ["canplayer", "-t", "-I", log, f"vcan0={interface}"]
    environment = None if channel() else without_can(folder)
    found = {"analyze": [], "canplayer": []}
    for number in range(rounds + 1):
        shutil.rmtree(folder / "out", ignore_errors=True)
        took = {"analyze": once(ours), "canplayer": once(theirs, environment)}
        if number:  # the first round fills caches
            for name, figures in took.items():
                found[name].append(figures)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    if shutil.which("canplayer") is None:
        sys.exit("needs canplayer: apt-get install can-utils")
    if channel() is None and shutil.which("cc") is None:
        sys.exit("needs vcan0 (tests/canvm/canvm python -m tests.benchmarks.bench_canplayer) or a C compiler")
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), args.rounds)
    place = channel() or "/dev/null"
    print(f"{FRAMES} frames, canplayer to {place}, {args.rounds} alternating rounds")
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
        args.json.write_text(json.dumps({"place": place, "frames": FRAMES, "rounds": found, "ratios": ratios}))


if __name__ == "__main__":
    main()
