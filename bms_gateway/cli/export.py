"""`export`: the gateway's recent decoded signals as a table."""

import argparse
import time
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import UsageError, counted
from bms_gateway.records.recent_signals import STATE_DIRECTORY, Stretch, given_span, state_directory, write_recent

EXAMPLE = """\
  bms-gateway export --last 2h --out drive.csv --config /etc/bms-gateway/gateway.toml --string string_1
  bms-gateway compare drive.csv --model string_1.toml
  bms-gateway diagnose drive.csv --model string_1.toml

works while the service runs, and after; a row for every instant at which a signal of the string came
"""
SHORT_S, SHORT = 5.0, 0.05
"""Time, s, and share of the span that was asked for, by which a table may be shorter without a warning."""
OLD_S = 60.0
"""Age of the newest signal, s, from which on a warning is printed."""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option(
        "--last", metavar="SPAN", required=True, help="how much, back from the newest signal: 90s, 30min, 2h, 1d"
    )
    parser.option("--out", metavar="TABLE.csv", required=True, help="table to write, as compare and diagnose read it")
    parser.option("--string", metavar="NAME", help="string, where the gateway has several")
    parser.option("--config", metavar="C", type=Path, help="the gateway's config: its [store] says where the record is")
    parser.option(
        "--store", metavar="DIR", type=Path, help=f"the gateway's state directory (default: {STATE_DIRECTORY})"
    )
    parser.option("--json", metavar="FILE", help="write what was done as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Write the table."""
    from bms_gateway.engine.engine import CLOCK_SET_NS

    seconds = given_span(args.last)
    if args.out == "-":
        raise UsageError("export: --out -: the table is a file; name it, such as TABLE.csv")
    outputs = {"--out": args.out, "--json": args.json}
    writable(outputs)
    distinct(outputs, [args.config] if args.config else [])
    if args.store is not None and args.config is not None:
        raise UsageError("export: --store and --config both say where to look: give one of them")
    directory = state_directory(args.config, args.store, "export")
    w = write_recent(Path(args.out), directory, Stretch(seconds), args.string, "export", note)
    if args.json:
        told = {"table": args.out, "string": w.string, "rows": w.rows, "from_s": w.first_s, "to_s": w.last_s}
        write_json(args.json, told)
    minutes = (w.last_s - w.first_s) / 60.0
    if seconds - 60.0 * minutes > max(SHORT_S, SHORT * seconds):
        note(f"of {args.last} only {minutes:.1f} min are recorded")
    if (age_s := time.time() - w.last_s) > OLD_S and 1e9 * w.last_s > CLOCK_SET_NS:
        note(f"the newest signal came {age_s / 60.0:.1f} min ago; later ones wait for a save, or the bus is silent")
    say(f"{args.out}: {counted(w.rows, 'row')}, {minutes:.1f} min of {w.string}: {', '.join(w.columns)}", args.json)
    return 0
