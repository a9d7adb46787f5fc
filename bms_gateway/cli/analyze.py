"""`analyze`: logged traffic through the engine that also runs live, as fast as the machine allows."""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser

if TYPE_CHECKING:
    from bms_gateway.bus.logfile import LogNotes
    from bms_gateway.engine import Engine
    from bms_gateway.frames.batch import FrameBatch
    from bms_gateway.report.csv_out import ResultFolder

EXAMPLE = """
  bms-gateway analyze drive.log.gz --config gateway.toml --out results
"""


def arguments(parser: Parser) -> None:
    """Declare the command's words."""
    parser.option("log", nargs="+", type=Path, metavar="LOG", help="logs in the order they were recorded")
    parser.option("--config", required=True, type=Path, help="the gateway's config")
    parser.option("--out", required=True, type=Path, metavar="DIR", help="folder for the results")


def run(args: argparse.Namespace) -> int:
    """Analyze the logs; results lie in the folder, a table of the strings goes to standard output."""
    from bms_gateway.bus.logfile import LogNotes, write_log
    from bms_gateway.config.load import load_config
    from bms_gateway.engine import Engine
    from bms_gateway.report.csv_out import ResultFolder

    loaded = load_config(args.config)
    engine = Engine(loaded.plan, loaded.database)
    notes = [LogNotes() for _ in args.log]
    span = _Span()
    with ResultFolder(args.out) as folder:
        batches = _batches(args.log, notes, span)
        write_log(args.out / "broadcast.log", _sent(engine, batches, folder), loaded.config.bus.channel)
        _conclude(engine, folder)
        folder.write_summary(frames=span.frames, duration_s=span.seconds, dropped=0, rejected=engine.rejected)
    _tell(args, engine, folder, notes, span)
    return 0


class _Span:
    """How many frames the logs held and how long they last."""

    def __init__(self) -> None:
        self.frames = 0
        self.first: int | None = None
        self.last = 0

    @property
    def seconds(self) -> float:
        return 0.0 if self.first is None else round((self.last - self.first) * 1e-9, 6)

    def note(self, batch: "FrameBatch") -> None:
        self.frames += len(batch)
        self.first = int(batch.time_ns[0]) if self.first is None else self.first
        self.last = max(self.last, int(batch.time_ns[-1]))


def _batches(logs: list[Path], notes: "list[LogNotes]", span: _Span) -> "Iterator[FrameBatch]":
    from bms_gateway.bus.logfile import read_log
    from bms_gateway.report.progress import progress

    for log, note in zip(logs, notes, strict=True):
        with progress(log.name, None) as advance:
            for batch in read_log(log, notes=note):
                if len(batch):
                    span.note(batch)
                    advance(len(batch))
                    yield batch


def _sent(engine: "Engine", batches: "Iterable[FrameBatch]", folder: "ResultFolder") -> "Iterator[FrameBatch]":
    """Frames that the service would have sent; everything else goes into the folder on the way."""
    from bms_gateway.engine import SendFrames, drive

    for event in drive(engine, batches):
        if isinstance(event, SendFrames):
            yield event.batch
        else:
            folder.write(event)


def _conclude(engine: "Engine", folder: "ResultFolder") -> None:
    """Put what the flags say at the end into the summary."""
    for s in engine.strings:
        summary = folder.strings.get(s.plan.name)
        if summary is None:
            continue
        growth = s.ageing.growth
        summary.resistance_growth_pct = round(100.0 * growth, 3) if growth == growth else None
        summary.flags = list(s.flags)


def _tell(
    args: argparse.Namespace, engine: "Engine", folder: "ResultFolder", notes: "list[LogNotes]", span: _Span
) -> None:
    from bms_gateway.cli.output import note
    from bms_gateway.report.show import number, text_table

    for log, n in zip(args.log, notes, strict=True):
        if n.broken:
            line, text = n.broken_at[0]
            note(f"{log}: {n.broken} broken lines passed over, the first at line {line}: {text!r}")
    if not engine.frames:
        note(f"none of the {span.frames} frames carries a signal of {args.config}: nothing was estimated")
    rows = []
    for s in engine.strings:
        sums = folder.strings.get(s.plan.name)
        by_name = {e.name: e for e in s.estimates}
        R_e = by_name["R_e"]
        rows.append(
            [
                s.plan.name,
                s.plan.model.cells,
                number(sums.max_core_C if sums else None),
                f"{1e3 * R_e.value:.3f} ± {1e3 * R_e.sd:.3f}",
                R_e.status,
                ", ".join(s.flags) or "none",
            ]
        )
    print(text_table(["string", "cells", "hottest core °C", "R_e mΩ", "status", "flags"], rows))
    if engine.rejected:
        print("rejected samples: " + ", ".join(f"{k} {v}" for k, v in sorted(engine.rejected.items())))
    print(f"{span.frames} frames, {span.seconds:.1f} s of traffic; results in {args.out}")
