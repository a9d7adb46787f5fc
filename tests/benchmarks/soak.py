"""Soak: `python -m tests.benchmarks.soak files [--hours 24]` and `… soak vcan [--minutes 20]` (root, a real vcan0).

`files`: simulated hours of five strings amid a full 1 Mbit/s bus of other frames through the engine, as `analyze`
does it; the memory of the process must not grow after the first tenth, which is the first hour at least: until then
windows of twenty minutes fill up and are fitted for the first time. Beside what the process has of the system it tells
what is held when the allocator has given back all it can: the rest is free. `vcan`: real minutes at full load on vcan0
through the service's own loop, with a fault of the bus every 30 s; memory flat, every fault recovered from. Status 1
where that does not hold.
"""

import argparse
import ctypes
import gc
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from bms_gateway.bus.traffic import SECOND, Traffic
from bms_gateway.bus.virtual import SENSOR_NOISE_K, VirtualPack
from bms_gateway.chaos.bus_faults import bus_scenarios
from bms_gateway.chaos.live import RealTimeBench
from bms_gateway.config import load_config, shipped
from bms_gateway.engine import Engine, Estimated, drive
from bms_gateway.frames.batch import FrameBatch
from tests.chaos.bench import config

FULL_LOAD = 8_000  # frames/s of eight bytes: a full 1 Mbit/s bus
GROWTH_MIB = 8.0  # of a process in which nothing piles up: the allocator's scatter
SETTLED_H, SHORTEST_H = 1.0, 2.0
"""By then every window has been filled and fitted three times; of less than two hours there is nothing to tell."""
CYCLE_S = 30.0
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


def files(hours: float) -> int:
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
    return 0 if max(growth, more) <= GROWTH_MIB else 1


def vcan(minutes: float) -> int:
    """Run the part on a real interface."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = load_config(config(Path(folder)))
    bench = RealTimeBench(loaded.plan, loaded.database, "vcan0")
    scenarios = [s for s in bus_scenarios("vcan0") if not s.scenario.unfit]
    end, failed, tried, memory = time.monotonic() + 60.0 * minutes, 0, 0, []
    while time.monotonic() < end:
        begun = time.monotonic()
        chosen = scenarios[tried % len(scenarios)]
        outcome = bench.run(chosen.scenario, chosen.fault, small_buffer=chosen.small_buffer, load=FULL_LOAD)
        tried += 1
        failed += not outcome.holds
        memory.append(resident_mib())
        print(
            f"{chosen.scenario.name:20} {outcome.seen}; recovered {outcome.recovered_s} s; {memory[-1]:.1f} MiB",
            flush=True,
        )
        time.sleep(max(0.0, CYCLE_S - (time.monotonic() - begun)))
    growth = max(memory[1:], default=memory[0]) - memory[0]
    print(f"{minutes:g} minutes, {tried} faults, {failed} failed; memory grew by {growth:.1f} MiB")
    return 1 if failed or growth > GROWTH_MIB else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("files", "vcan"))
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--minutes", type=float, default=20.0)
    args = parser.parse_args()
    if args.part == "files" and args.hours < SHORTEST_H:
        parser.error(f"--hours {args.hours:g}: at least {SHORTEST_H:g}, the first hour only fills the windows")
    return files(args.hours) if args.part == "files" else vcan(args.minutes)


if __name__ == "__main__":
    sys.exit(main())
