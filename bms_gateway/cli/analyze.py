"""`analyze`: logged traffic through the engine that also runs live, as fast as the machine allows."""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.errors import counted

if TYPE_CHECKING:
    from bms_gateway.bus.logfile import LogNotes
    from bms_gateway.engine import Engine, Event
    from bms_gateway.frames.batch import FrameBatch
    from bms_gateway.records.courses import Courses
    from bms_gateway.records.signal_use import Use
    from bms_gateway.records.span import Span
    from bms_gateway.report.csv_out import ResultFolder

EXAMPLE = """
  bms-gateway analyze drive.log.gz --config gateway.toml --out results
"""


MOST_TOLD = 10


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("log", nargs="+", type=Path, metavar="LOG", help="logs in the order they were recorded")
    parser.option("--config", required=True, type=Path, help="the gateway's config")
    parser.option(
        "--out", required=True, metavar="DIR", help="folder for the results; files of an earlier run are deleted"
    )
    parser.option("--json", metavar="FILE", help="write the summary as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Analyze the logs; results lie in the folder, a table of the strings goes to standard output."""
    from bms_gateway.bus.logfile import LogNotes, write_frames
    from bms_gateway.cli.logged_frames import logged_frames
    from bms_gateway.cli.output import distinct, folder_for, say, writable, write_json
    from bms_gateway.config.load import load_config
    from bms_gateway.engine import Engine, drive
    from bms_gateway.records.courses import Courses
    from bms_gateway.records.once import given_once, in_order
    from bms_gateway.records.signal_use import advice, contradictions, signal_use
    from bms_gateway.records.span import Span, expect_estimates
    from bms_gateway.report.csv_out import FILES, ResultFolder

    out = folder_for("analyze", args.out, "the results")
    writable({"--json": args.json})
    loaded = load_config(args.config)
    distinct({"--json": args.json} | {f"--out {file}": out / file for file in FILES}, [*loaded.files, *args.log])
    given_once(args.log)
    in_order(args.log)
    engine = Engine(loaded.plan, loaded.database)
    courses = Courses(engine, loaded.database)
    notes = [LogNotes() for _ in args.log]
    span = Span()
    with ResultFolder(out, {s.name: s.model.cells for s in loaded.plan.strings}) as folder:
        batches = logged_frames(args.log, notes, span)
        with folder.create("broadcast.log") as file:
            write_frames(file, _sent(drive(engine, batches), folder, courses), loaded.config.bus.channel)
        expect_estimates(args.log, args.config, engine, span)
        _conclude(engine, folder)
        broken = sum(n.broken for n in notes)
        stated = {s.name for s in loaded.config.string if s.signals is not None}
        uses = signal_use(loaded.plan, loaded.database, engine, stated)
        summary = folder.write_summary(
            frames=span.frames,
            duration_s=round(engine.duration_s, 6) if engine.clock_faults else span.seconds,
            dropped=0,
            rejected=engine.rejected | ({"broken_line": broken} if broken else {}),
            signals={signal: use.document() for signal, use in uses.items()},
        )
    if args.json:
        write_json(args.json, summary)
    wrong = [*contradictions(loaded.plan, engine.inputs), *courses.contradictions()]
    _note(args, engine, notes)
    _tell(args, engine, folder, span, [*wrong, *advice(uses)], uses)
    frames, seconds = sum(n.frames for n in notes), summary["duration_s"]
    say(f"{counted(frames, 'frame')}, {seconds:.1f} s of traffic; results in {args.out}", args.json)
    return 0


def _sent(events: "Iterable[Event]", folder: "ResultFolder", courses: "Courses") -> "Iterator[FrameBatch]":
    """Yield the frames that the service would have sent, and write all other results into the folder."""
    from bms_gateway.engine import SendFrames

    for event in events:
        if isinstance(event, SendFrames):
            yield event.batch
        elif not courses.take(event):
            folder.write(event)


def _conclude(engine: "Engine", folder: "ResultFolder") -> None:
    """Add the flags at the end of the logs to the summary."""
    for s in engine.strings:
        summary = folder.strings[s.plan.name]
        growth = s.ageing.growth
        summary.resistance_growth_pct = round(100.0 * growth, 3) if growth == growth else None
        summary.flags = list(s.flags)


def _note(args: argparse.Namespace, engine: "Engine", notes: "list[LogNotes]") -> None:
    """Report faults of the logs."""
    from bms_gateway.bus.backwards import how_to_sort
    from bms_gateway.cli.output import note

    for log, n in zip(args.log, notes, strict=True):
        if n.broken:
            line, text = n.broken_at[0]
            note(f"{log}: {n.broken} damaged lines skipped, the first at line {line}: {text!r}")
    if engine.clock_faults:
        one = len(args.log) == 1 and "back" in engine.clock_faults
        sort = f"; if its parts are in the wrong order, {how_to_sort(args.log[0])}" if one else ""
        note(f"the time stamps of these logs are wrong: {engine.clock_faults}; time_s only goes forward{sort}")
    for name, missing in engine.unheard.items():
        note(f"{name}: never received {missing}")


def _tell(
    args: argparse.Namespace,
    engine: "Engine",
    folder: "ResultFolder",
    span: "Span",
    told: list[str],
    uses: "dict[str, Use]",
) -> None:
    """Print the results: the strings, the hottest core, the alerts, the faults of each signal, the refused samples."""
    from bms_gateway.cli.output import say
    from bms_gateway.records.refused_samples import refused_samples
    from bms_gateway.records.signal_use import channel_of
    from bms_gateway.report.hottest import hottest_sentence

    say(_table(engine, folder, span.first_ns), args.json)
    known = list(folder.hottest.values())
    if known:
        top = max(known, key=lambda h: h.rank)
        say(hottest_sentence(top, span.first_ns, channel_of(uses, top.string, top.cell)), args.json)
    for text in _standing(engine, args.out):
        say(text, args.json)
    for text in told[:MOST_TOLD]:
        say(text, args.json)
    if len(told) > MOST_TOLD:
        more = f"bms-gateway check {args.config} --log {args.log[0]}"
        say(f"… and {len(told) - MOST_TOLD} more; {more} tells all", args.json)
    for text in refused_samples(uses, engine.rejected):
        say(text, args.json)


def _standing(engine: "Engine", out: str) -> "Iterator[str]":
    """Print the alerts that are raised at the end."""
    standing = engine.alerts.raised
    for c in standing[:MOST_TOLD]:
        where = "" if c.string is None else f"{c.string}: "
        yield f"{c.severity.name} at the end: {where}{c.text}"
    if len(standing) > MOST_TOLD:
        yield f"… and {len(standing) - MOST_TOLD} more alerts: {out}/alerts.jsonl"


def _table(engine: "Engine", folder: "ResultFolder", start_ns: int) -> str:
    """Write a row per string."""
    from bms_gateway.report.show import number, text_table

    rows = []
    for s in engine.strings:
        by_name = {e.name: e for e in s.estimates}
        R_e = by_name["R_e"]
        h = folder.hottest.get(s.plan.name)
        rows.append(
            [
                s.plan.name,
                s.plan.model.cells,
                *(
                    ("–", "–", "–")
                    if h is None
                    else (f"{h.core_C:.2f} ± {h.core_sd_K:.2f}", h.cell, f"{(h.time_ns - start_ns) * 1e-9:.0f}")
                ),
                number((folder.strings[s.plan.name].hottest or {}).get("centre_C")),
                f"{1e3 * R_e.value:.3f} ± {1e3 * R_e.sd:.3f}",
                R_e.status,
                ", ".join(s.flags) or "none",
            ]
        )
    headers = [
        "string",
        "cells",
        "hottest core °C ± 1 sd",
        "cell",
        "at s",
        "hottest point °C",
        "R_e mΩ ± 1 sd",
        "status",
        "flags",
    ]
    return text_table(headers, rows)
