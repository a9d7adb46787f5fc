"""Soak: `python -m tests.benchmarks.soak files [--hours 24]`, and in the guest that has a vcan0
`tests/canvm/canvm -t 3600 python -m tests.benchmarks.soak vcan [--minutes 20]`; both take `--json FILE`.

`files`: simulated hours of five strings amid a full 1 Mbit/s bus of other frames through the engine, as `analyze`
does it; the memory of the process must not grow after the first tenth, which is the first hour at least: until then
windows of twenty minutes fill up and are fitted for the first time. Beside what the process has of the system it tells
what is held when the allocator has given back all it can: the rest is free. `vcan`: real minutes at full load on vcan0,
the service a process of its own, with a fault every 30 s (`soak_vcan`). Status 1 where that does not hold.
"""

import argparse
import ctypes
import gc
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bms_gateway.bus.traffic import SECOND, Traffic
from bms_gateway.bus.virtual import SENSOR_NOISE_K, VirtualPack
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.frames.batch import FrameBatch
from tests.benchmarks.soak_vcan import GROWTH_MIB, vcan

FULL_LOAD = 8_000  # frames/s of eight bytes: a full 1 Mbit/s bus
BUSY = 8_500  # frames/s of eight bytes on vcan0
SETTLED_H, SHORTEST_H = 1.0, 2.0
"""By then every window has been filled and fitted three times; of less than two hours there is nothing to tell."""
STRANGE = np.arange(0x400, 0x440, dtype=np.uint32)


def resident_mib() -> float:
    """Memory of this process now."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def held_mib() -> float:
    """Memory of this process after glibc has given back what is free."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return resident_mib()


def full_bus(hours: float) -> Iterator[FrameBatch]:
    """Traffic of five strings, filled up with frames of others, some seconds at a time."""
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    pack = VirtualPack(loaded.plan, 0)
    traffic = Traffic(loaded.plan, loaded.database, noise_K=SENSOR_NOISE_K)
    rng = np.random.default_rng(0)
    for segments in pack.segments(3600.0 * hours):
        start, stop = (int(segments[0].time_s[k]) for k in (0, -1))
        own = traffic.between([s.series for s in segments], start * SECOND, stop * SECOND)
        for t in range(start, stop, 10):
            mine = own[slice(*np.searchsorted(own.time_ns, [t * SECOND, (t + 10) * SECOND]).tolist())]
            n = 10 * FULL_LOAD - len(mine)
            others = FrameBatch(
                np.sort(rng.integers(t * SECOND, (t + 10) * SECOND, n)),
                rng.choice(STRANGE, n),
                np.full(n, 8, np.uint8),
                rng.integers(0, 256, (n, 8), np.uint8),
            )
            both = FrameBatch.concat([mine, others])
            order = np.argsort(both.time_ns, kind="stable")
            yield FrameBatch(both.time_ns[order], both.can_id[order], both.length[order], both.data[order])


def files(hours: float, json_file: Path | None) -> int:
    """Run the simulated part."""
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    engine = Engine(loaded.plan, loaded.database)
    frames = ticks = 0
    told, memory = 0.0, 0.0
    flat: list[float] = []
    held: list[float] = []
    begun = time.monotonic()

    def counted() -> Iterator[FrameBatch]:
        nonlocal frames
        for batch in full_bus(hours):
            frames += len(batch)
            yield batch

    events = drive(engine, counted())
    while True:
        event = next(events, None)
        if event is None:
            break
        ticks += isinstance(event, Estimated)
        hour = engine.duration_s / 3600.0
        if hour >= told:
            memory = resident_mib()
            took = time.monotonic() - begun
            print(
                f"{hour:6.1f} h  {frames:12} frames  {frames / max(took, 1e-9):10.0f} frames/s  {memory:7.1f} MiB",
                flush=True,
            )
            told += hours / 20.0
            if hour >= max(SETTLED_H, hours / 10.0):
                flat.append(memory)
                held = held or [held_mib()]
    took = time.monotonic() - begun
    held.append(held_mib())
    growth, more = max(flat) - flat[0], held[1] - held[0]
    rate = frames / took
    print(
        f"{hours:g} simulated hours, {frames} frames, {ticks} estimates of strings in {took:.0f} s: "
        f"{rate:.0f} frames/s with the making of the traffic, {rate / FULL_LOAD:.0f} times real time; "
        f"memory grew by {growth:.1f} MiB after the first tenth, what is held of it went from {held[0]:.1f} to "
        f"{held[1]:.1f} MiB; rejected {dict(sorted(engine.rejected.items()))}"
    )
    holds = max(growth, more) <= GROWTH_MIB
    if json_file:
        found = {
            "hours": hours,
            "frames": frames,
            "took_s": took,
            "growth_MiB": growth,
            "held_MiB": held,
            "holds": holds,
        }
        json_file.write_text(json.dumps(found, indent=1))
    return 0 if holds else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("files", "vcan"))
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument(
        "--settle", type=float, default=22.0, help="minutes before those of vcan0 (default: %(default)g)"
    )
    parser.add_argument("--rate", type=float, default=BUSY, metavar="FRAMES/S", help="of vcan0 (default: %(default)g)")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    if args.part == "files" and args.hours < SHORTEST_H:
        parser.error(f"--hours {args.hours:g}: at least {SHORTEST_H:g}, the first hour only fills the windows")
    if args.part == "files":
        return files(args.hours, args.json)
    return vcan(args.minutes, args.settle, args.rate, args.json)


if __name__ == "__main__":
    sys.exit(main())
