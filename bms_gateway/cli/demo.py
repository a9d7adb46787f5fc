"""`demo`: the main job with no hardware, ending with the error against the simulated truth.

A virtual pack has other resistances than the model files and unknown start temperatures. It drives in real time on
`vcan0` if this interface exists, otherwise on an in-process bus as fast as the machine allows.
"""

import argparse
import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import note, say, writable, write_json
from bms_gateway.errors import BusError, UsageError

if TYPE_CHECKING:
    from bms_gateway.bus.traffic import Traffic
    from bms_gateway.bus.virtual import Segment, VirtualPack
    from bms_gateway.engine import Cells, Engine, Event
    from bms_gateway.frames.batch import FrameBatch
    from bms_gateway.thermal import Floats

SECOND = 1_000_000_000
CHANNEL = "vcan0"
LIVE_S, SIMULATED_S = 45.0, 2700.0  # live: long enough to find every core; simulated: long enough to identify twice
LONGEST_S = 86_400  # the true temperatures are kept in memory
UNKNOWN = 0.10  # R_e, R_c and R_u of each string differ from its model file by so much (relative sd)
EXAMPLE = """\
  bms-gateway demo
  bms-gateway demo --seed 7 --json -
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("--seed", type=int, default=1, metavar="N", help="another seed is another pack and drive (default 1)")
    parser.option("--seconds", type=float, metavar="S", help="how long to drive (default: 45 live, 2700 simulated)")
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


@dataclass
class Score:
    """Errors of the estimates, collected tick by tick.

    Attributes
    ----------
    errors, sds : list of ndarray (n,)
        Estimated minus true core, and the stated sd, of every tick in the last quarter of the drive.
    """

    since_s: float
    errors: "list[Floats]" = field(default_factory=list)
    sds: "list[Floats]" = field(default_factory=list)
    sent: int = 0


def run(args: argparse.Namespace) -> int:
    """Run the demo."""
    from bms_gateway.bus.traffic import Traffic
    from bms_gateway.bus.virtual import SENSOR_NOISE_K, VirtualPack
    from bms_gateway.config import load_config, shipped
    from bms_gateway.engine import Engine

    if args.seed < 0:
        raise UsageError(f"demo: --seed {args.seed}: must not be negative")
    writable({"--json": args.json})
    live = _has_vcan()
    seconds = args.seconds if args.seconds is not None else (LIVE_S if live else SIMULATED_S)
    if not (math.isfinite(seconds) and seconds >= 10):
        raise UsageError(f"demo: --seconds {seconds:g}: at least 10")
    if seconds > LONGEST_S:
        raise UsageError(f"demo: --seconds {seconds:g}: at most {LONGEST_S} (a day)")
    loaded = load_config(shipped("deploy/example/gateway.toml"))
    pack = VirtualPack(loaded.plan, args.seed, common=UNKNOWN)
    traffic = Traffic(loaded.plan, loaded.database, noise_K=SENSOR_NOISE_K, seed=args.seed)
    engine = Engine(loaded.plan, loaded.database)
    cells = sum(s.model.cells for s in loaded.plan.strings)
    where = f"{CHANNEL}, in real time" if live else "an in-process bus, as fast as it goes"
    say(
        f"{len(loaded.plan.strings)} strings, {cells} cells, sensors on the end cells, {seconds:.0f} s on {where}",
        args.json,
    )
    score = Score(0.75 * seconds)
    if live:
        _drive_live(engine, _frames(pack, traffic, seconds), _truth(pack, seconds), seconds, score)
    else:
        _drive_in_process(engine, pack, traffic, seconds, score)
    return _conclude(args, engine, pack, score, live)


def _has_vcan() -> bool:
    from bms_gateway.bus.replay import SocketCanSender

    try:
        SocketCanSender(CHANNEL).close()
    except BusError:
        return False
    return True


def _frames(pack: "VirtualPack", traffic: "Traffic", seconds: float) -> "Iterator[FrameBatch]":
    for segments in pack.segments(seconds):
        yield _traffic_of(segments, traffic)


def _traffic_of(segments: "tuple[Segment, ...]", traffic: "Traffic") -> "FrameBatch":
    time = segments[0].time_s
    return traffic.between([s.series for s in segments], int(time[0]) * SECOND, int(time[-1]) * SECOND)


def _truth(pack: "VirtualPack", seconds: float) -> "dict[str, Floats]":
    """Compute the true cores (K, n) of each string at whole seconds; the same seed gives the same pack and drive."""
    parts: dict[str, list[Floats]] = {}
    for segments in pack.segments(seconds):
        for s in segments:
            parts.setdefault(s.string.name, []).append(s.core_C[:-1])
    return {name: np.concatenate(p) for name, p in parts.items()}


def _drive_in_process(engine: "Engine", pack: "VirtualPack", traffic: "Traffic", seconds: float, score: Score) -> None:
    from bms_gateway.bus.in_process import MemoryBus
    from bms_gateway.engine import drain
    from bms_gateway.report.progress import progress
    from bms_gateway.report.show import live_view

    bus = MemoryBus()
    vehicle, gateway = bus.port(), bus.port()
    truth = _truth(pack, seconds)
    with progress("driving", seconds) as advance, live_view() as draw:
        for segments in pack.segments(seconds):
            frames = _traffic_of(segments, traffic)
            seconds_at = np.searchsorted(
                frames.time_ns, np.arange(segments[0].time_s[0], segments[0].time_s[-1]) * SECOND
            )
            for a, b in zip(seconds_at, [*seconds_at[1:], len(frames)], strict=True):
                vehicle.send(frames[int(a) : int(b)])
                engine.receive(gateway.drain(), now_ns=gateway.now_ns())
                _take(drain(engine), gateway.send, truth, lambda ns: ns / SECOND, score, draw)
                score.sent += len(vehicle.drain())
                advance(1.0)


def _take(
    events: "Iterator[Event]",
    send: "Callable[[FrameBatch], None]",
    truth: "dict[str, Floats]",
    pack_time: Callable[[int], float],
    score: Score,
    draw: Callable[[str], None],
) -> None:
    """Send the gateway's frames, score its estimates, and show the newest ones."""
    from bms_gateway.engine import Estimated, SendFrames

    tables: list[str] = []
    for event in events:
        if isinstance(event, SendFrames):
            send(event.batch)
        elif isinstance(event, Estimated):
            t = pack_time(event.time_ns)
            for cells in event.strings():
                true = _at(truth[cells.string], t)
                if true is None:
                    continue
                tables.append(_table(cells, true))
                if t >= score.since_s:
                    score.errors.append(cells.core - true)
                    score.sds.append(cells.core_sd)
    if tables:
        draw("\n\n".join(tables))


def _at(truth: "Floats", t: float) -> "Floats | None":
    """Read the true cores at `t` seconds of the pack's time, on a straight line between whole seconds."""
    k = math.floor(t)
    if not 0 <= k < len(truth) - 1:
        return None
    between: Floats = truth[k] + (t - k) * (truth[k + 1] - truth[k])
    return between


def _table(cells: "Cells", true: "Floats") -> str:
    from bms_gateway.report.show import cells_table

    return cells_table(cells, true)


def _drive_live(
    engine: "Engine",
    frames: "Iterator[FrameBatch]",
    truth: "dict[str, Floats]",
    seconds: float,
    score: Score,
) -> None:
    import time

    from bms_gateway.bus.access import Access
    from bms_gateway.bus.replay import SocketCanSender, replay
    from bms_gateway.bus.socketcan import SocketCanPort
    from bms_gateway.report.show import live_view
    from bms_gateway.service.live import Gateway

    port = SocketCanPort(CHANNEL, Access(engine.can_ids.tolist(), own=engine.sends))
    sender = SocketCanSender(CHANNEL)
    batches = list(frames)  # the traffic is made beforehand, so that the bus does not wait for the simulation
    began = time.time_ns()
    first = int(batches[0].time_ns[0])
    vehicle = threading.Thread(target=replay, args=(batches, sender), daemon=True)
    with live_view() as draw:
        gateway = Gateway(
            engine,
            port,
            watch=lambda e: _take(
                iter([e]), _already_sent, truth, lambda ns: (ns - began + first) / SECOND, score, draw
            ),
        )
        vehicle.start()
        try:
            gateway.serve(seconds=seconds)
        finally:
            port.close()
    vehicle.join()
    sender.close()
    score.sent = port.counters.sent


def _already_sent(_batch: "FrameBatch") -> None:
    """Ignore frames that the gateway itself has put on the bus."""


def _conclude(args: argparse.Namespace, engine: "Engine", pack: "VirtualPack", score: Score, live: bool) -> int:
    from bms_gateway.report.show import number, text_table

    errors, sds = np.array(score.errors), np.array(score.sds)
    seen = np.isfinite(errors)
    if not seen.any():
        note("no estimate came out: the machine was too busy, or the bus did not carry the traffic")
        return 1
    rmse = float(np.sqrt(np.mean(np.square(errors[seen]))))
    worst = float(np.max(np.abs(errors[seen])))
    inside = float(np.mean(np.abs(errors[seen]) <= 2.0 * sds[seen]))
    rows, strings = [], []
    for s, true in zip(engine.strings, pack.parameters, strict=True):
        for e in s.estimates:
            if e.name in ("R_e", "R_c", "R_u"):
                factor = 1e3 if e.name == "R_e" else 1.0
                truth = float(np.mean(getattr(true, e.name)))
                row = {"string": s.plan.name, "name": e.name, "estimate": e.value * factor, "sd": e.sd * factor}
                strings.append(row | {"true": truth * factor, "status": e.status})
                value = f"{number(e.value * factor, 3)} ± {number(e.sd * factor, 3)}"
                unit = "mΩ" if e.name == "R_e" else "K/W"
                rows.append([s.plan.name, f"{e.name} {unit}", value, number(truth * factor, 3), e.status])
    say(text_table(["string", "parameter", "estimate", "truth", "status"], rows, left=2), args.json)
    say(
        f"{score.sent} frames broadcast. Core temperature over the last quarter of the drive: RMSE {rmse:.2f} K, "
        f"worst cell and moment {worst:.2f} K off, {100 * inside:.0f} % within twice the stated sd",
        args.json,
    )
    if args.json:
        document = {"live": live, "core_rmse_K": rmse, "core_worst_K": worst, "within_2_sd": inside}
        write_json(args.json, document | {"frames_sent": score.sent, "parameters": strings})
    return 0
