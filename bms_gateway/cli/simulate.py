"""`simulate`: a virtual pack on a drive cycle, as a log of its traffic."""

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, say, writable, write_json
from bms_gateway.errors import UsageError, counted, did_you_mean
from bms_gateway.whole import whole_text

if TYPE_CHECKING:
    from bms_gateway.bus.virtual import Segment
    from bms_gateway.frames.batch import FrameBatch

LONGEST_S = 30 * 86_400  # five strings write 11 GB of log in that time
EXAMPLE = """\
  bms-gateway simulate --config gateway.toml --out drive.log --truth truth.csv --seed 7 --duration 5400
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("--config", metavar="CONFIG", required=True, help="gateway config; its model files are the pack")
    parser.option("--out", metavar="LOG", required=True, help="candump log to write (.log or .log.gz)")
    parser.option("--truth", metavar="CSV", help="also write the true core and surface of every cell, once a second")
    parser.option("--cycle", metavar="NAME", default="urban-assault", help="urban-assault (default), us06 or udds")
    parser.option("--seed", metavar="N", type=int, default=0, help="another seed is another pack and drive (default 0)")
    parser.option("--duration", metavar="S", type=float, default=1800.0, help="seconds to drive (default 1800)")
    parser.option("--json", metavar="FILE", help="write what was done as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Write log and truth."""
    from bms_gateway.bus.logfile import write_log
    from bms_gateway.bus.traffic import SECOND, Traffic
    from bms_gateway.bus.virtual import SENSOR_NOISE_K, VirtualPack
    from bms_gateway.config import load_config
    from bms_gateway.report.progress import progress
    from bms_gateway.thermal.cycles import CYCLES

    if args.cycle not in CYCLES:
        raise UsageError(f"simulate: --cycle {args.cycle}: no such cycle{did_you_mean(args.cycle, CYCLES)}")
    if not (math.isfinite(args.duration) and args.duration >= 1):
        raise UsageError(f"simulate: --duration {args.duration:g}: at least 1 second")
    if args.duration > LONGEST_S:
        raise UsageError(f"simulate: --duration {args.duration:g}: at most {LONGEST_S} seconds (30 days)")
    if args.seed < 0:
        raise UsageError(f"simulate: --seed {args.seed}: must not be negative")
    outputs = {"--out": args.out, "--truth": args.truth, "--json": args.json}
    writable(outputs)
    loaded = load_config(Path(args.config))
    distinct(outputs, loaded.files)
    plan = loaded.plan
    pack = VirtualPack(plan, args.seed, cycle=args.cycle)
    traffic = Traffic(plan, loaded.database, noise_K=SENSOR_NOISE_K, seed=args.seed)
    with _truth_file(args.truth) as truth, progress("simulating", args.duration) as advance:

        def drive() -> "Iterator[FrameBatch]":
            for segments in pack.segments(args.duration):
                time = segments[0].time_s
                yield traffic.between([s.series for s in segments], int(time[0]) * SECOND, int(time[-1]) * SECOND)
                if truth is not None:
                    _write_truth(truth, segments, last=time[-1] >= round(args.duration))
                advance(float(time[-1] - time[0]))

        frames = write_log(args.out, drive())
    cells = sum(s.model.cells for s in plan.strings)
    if args.json:
        numbers = {"frames": frames, "duration_s": float(round(args.duration)), "strings": len(plan.strings)}
        write_json(args.json, {"log": args.out, "truth": args.truth, "seed": args.seed, **numbers, "cells": cells})
    size = f"{counted(len(plan.strings), 'string')}, {counted(cells, 'cell')}"
    say(f"{args.out}: {counted(frames, 'frame')}, {args.duration:g} s, {size}", args.json)
    return 0


@contextmanager
def _truth_file(name: str | None) -> Iterator[TextIO | None]:
    if name is None:
        yield None
        return
    try:
        with whole_text(Path(name)) as f:
            f.write("time_s,string,cell,core_C,surface_C\n")
            yield f
    except OSError as e:
        raise UsageError(f"simulate: --truth {name}: cannot be written: {e.strerror}") from None


def _write_truth(f: TextIO, segments: "tuple[Segment, ...]", *, last: bool) -> None:
    """Yield the rows of one segment by time; its last instant is the first one of the next segment."""
    time = segments[0].time_s
    for i in range(len(time) if last else len(time) - 1):
        for s in segments:
            pairs = zip(s.core_C[i].tolist(), s.surface_C[i].tolist(), strict=True)
            f.writelines(f"{time[i]:.3f},{s.string.name},{k},{c:.4f},{t:.4f}\n" for k, (c, t) in enumerate(pairs, 1))
