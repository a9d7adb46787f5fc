"""What a live bus costs: our port and the whole gateway against python-can's Notifier with cantools.

``python -m tests.benchmarks.bench_live [--json FILE]`` on a host without CAN: all above a datagram socket pair
(python-can through a bus of a few lines that parses as its own SocketCAN bus does). Under ``tests/canvm/canvm``, and
wherever there is a vcan0: all on that, python-can with its own SocketCAN bus. A process of its own sends 8,500
frames/s, evenly; each round runs every peer for three seconds; CPU time is that of the receiving process alone. Kernel
time stamps on. Three kinds of traffic:

* one frame of each message in turn; every signal is decoded, ours once a second as the engine does;
* the example pack's (60 cells) a hundred times as fast: the gateway uses every frame, estimates and sends;
* the same pack at its own pace among others' frames, which filters keep away from both where there is a vcan0.

Here python-can decodes all it gets, but estimates nothing.
"""

import argparse
import asyncio
import json
import os
import statistics
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from bms_gateway.bus.access import Access
from tests.benchmarks.bench_files import EXAMPLE, crowd, simulate
from tests.benchmarks.live_place import CAN, Place, cpu, long_queues, our_port, python_can

RATE = 8_500
SECONDS = 3.05  # three ticks
ROUNDS = 7
LOG_S = 60
DBC = EXAMPLE.parents[2] / "dbc" / "bms_gateway.dbc"
PEER = "Notifier + cantools"


def database():
    import cantools

    return cantools.database.load_file(DBC)


def traffic(db):
    """One frame of every message that the pack sends, in turn."""
    messages = [m for m in db.messages if "BMS" in m.senders]
    wire = []
    for k in range(8 * len(messages)):
        m = messages[k % len(messages)]
        payload = bytes((k * 37 + j * 11) % 200 for j in range(m.length))
        if m.is_multiplexed():
            mux = next(s for s in m.signals if s.is_multiplexer)
            tree = next(e for e in m.signal_tree if isinstance(e, dict))
            value = sorted(tree[mux.name])[k % len(tree[mux.name])]
            number = bytearray(payload)
            for bit in range(mux.length):
                at = mux.start + bit
                number[at // 8] = number[at // 8] & ~(1 << at % 8) | (value >> bit & 1) << at % 8
            payload = bytes(number)
        wire.append(CAN.pack(m.frame_id | (0x80000000 if m.is_extended_frame else 0), len(payload), payload))
    return b"".join(wire)


def frame_file(log, to):
    """Write the frames of a log as a frame file; gives their identifiers."""
    from bms_gateway.bus.canframe import to_wire
    from bms_gateway.bus.logfile import read_log
    from bms_gateway.frames.batch import FrameBatch

    frames = FrameBatch.concat(list(read_log(log)))
    to.write_bytes(b"".join(to_wire(frames)))
    return frames.can_id


def write_traffic(folder):
    """Write the frame files of the three kinds of traffic."""
    kinds = {name: folder / f"{name}.frames" for name in ("messages", "pack", "crowded")}
    kinds["messages"].write_bytes(traffic(database()))
    quiet, log = folder / "pack.log", folder / "crowded.log"
    simulate(quiet, LOG_S)
    crowd(quiet, log)
    frame_file(quiet, kinds["pack"])
    frame_file(log, kinds["crowded"])
    return kinds


async def port(place, decode):
    """Our port as the service uses it: drained by a timer, all signals decoded at the tick, once a second."""
    from bms_gateway.frames.batch import FrameBatch

    port = our_port(place)
    loop = asyncio.get_running_loop()
    pending, count, tick = [], 0, time.monotonic() + 1.0
    timer = loop.call_later(port.gather_s, lambda: drain())

    def drain():
        nonlocal count, tick, timer
        pending.append(port.drain())
        count += len(pending[-1])
        if time.monotonic() >= tick:
            tick += 1.0
            if decode is not None:
                decode(FrameBatch.concat(pending))
            pending.clear()
        timer = loop.call_later(port.gather_s, drain)

    start = cpu()
    await asyncio.sleep(SECONDS)
    used = cpu() - start
    timer.cancel()
    port.close()
    return used, count


def engine():
    """Engine of the example pack."""
    from bms_gateway.config import load_config
    from bms_gateway.engine import Engine

    loaded = load_config(EXAMPLE)
    return Engine(loaded.plan, loaded.database)


def passed(received, *, crowded):
    """Frames on the bus: filters keep most of a crowded one's from who counts."""
    return RATE * SECONDS if crowded else received


async def gateway(place, *, crowded=False):
    """The service's own loop with the engine behind it: filters, estimates, frames out."""
    from bms_gateway.service.live import Gateway

    estimator = engine()
    port = our_port(place, Access(estimator.can_ids.tolist(), own=estimator.sends))
    port.drain()  # what came while the engine was made
    start, before = cpu(), port.counters.received
    await Gateway(estimator, port).run(seconds=SECONDS)
    used, received = cpu() - start, port.counters.received - before
    port.close()
    return used, passed(received, crowded=crowded)


async def notifier(place, db, wanted=None):
    """python-can's Notifier on the event loop, cantools in the listener."""
    import can

    bus = python_can(place, wanted)
    known = {m.frame_id: m for m in db.messages}
    count = 0

    def listen(message):
        nonlocal count
        count += 1
        found = known.get(message.arbitration_id)
        if found is not None:  # its socket is bound before its filters are set: some others come in between
            found.decode(message.data, decode_choices=False)

    listening = can.Notifier(bus, [listen], loop=asyncio.get_running_loop())
    start = cpu()
    await asyncio.sleep(SECONDS)
    used = cpu() - start
    listening.stop()
    bus.shutdown()
    return used, passed(count, crowded=wanted is not None)


def sends(name):
    """Whether that peer puts frames on the bus."""
    return name.startswith("whole gateway")


def table_decoder(db):
    """The gateway's own decoder of every signal of the traffic."""
    from bms_gateway.frames.database import Database
    from bms_gateway.frames.decode import decode

    signals = [f"{m.name}.{s.name}" for m in db.messages if "BMS" in m.senders for s in m.signals]
    table = Database.load({"bms_gateway.dbc": DBC.read_text()}).compile(signals)
    return lambda batch: decode(table, batch)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    args = parser.parse_args()
    with long_queues(), tempfile.TemporaryDirectory() as folder:
        measure(write_traffic(Path(folder)), args.rounds, args.json)


def measure(kinds, rounds, json_file):
    db = database()
    table = table_decoder(db)
    ours = engine()
    wanted = sorted(set(ours.can_ids.tolist()))
    peers = {
        "port alone": ("messages", lambda p: port(p, None)),
        PEER: ("messages", lambda p: notifier(p, db)),
        "port + table decode": ("messages", lambda p: port(p, table)),
        f"{PEER}, pack": ("pack", lambda p: notifier(p, db)),
        "whole gateway, pack": ("pack", gateway),
        f"{PEER}, crowded": ("crowded", lambda p: notifier(p, db, wanted)),
        "whole gateway, crowded": ("crowded", lambda p: gateway(p, crowded=True)),
    }
    results = {name: [] for name in peers}
    for _ in range(rounds):
        for name, (kind, run) in peers.items():
            # what nobody reads is in the way of what follows it
            place = Place(kinds[kind], RATE, hear=ours.sends if sends(name) else None)
            used, count = asyncio.run(run(place))
            place.stop()
            results[name].append((used / count * 1e6, used / SECONDS * 100, count / SECONDS))
    where = place.channel or "socketpair"
    print(f"on {where}, {rounds} alternating rounds of {SECONDS:.0f} s at {RATE} frames/s")
    print(f"{'':30}{'µs CPU/frame':>26}{'% of a core (min…max)':>26}{'frames/s':>10}")
    for name, rows in results.items():
        *figures, rate = zip(*rows, strict=True)
        spreads = [f"{statistics.median(f):.2f} ({min(f):.2f}…{max(f):.2f})" for f in figures]
        print(f"{name:30}{spreads[0]:>26}{spreads[1]:>26}{statistics.median(rate):10.0f}")
    ratios = {}
    for name, rows in results.items():
        if name.startswith(PEER):
            continue
        kind = peers[name][0]
        peer = PEER if kind == "messages" else f"{PEER}, {kind}"
        ratio = sorted(p[0] / r[0] for p, r in zip(results[peer], rows, strict=True))
        ratios[name] = ratio
        print(f"{peer} / {name}: {statistics.median(ratio):.1f} (min {ratio[0]:.1f}, max {ratio[-1]:.1f})")
    if json_file:
        json_file.write_text(json.dumps({"place": where, "rounds": results, "ratios": ratios}))


if __name__ == "__main__":
    main()
