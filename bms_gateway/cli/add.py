"""`add`: an effect of the catalogue becomes part of a model, if measurements speak for it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import UsageError

if TYPE_CHECKING:
    from bms_gateway.diagnose.adding import Addition, Wanted
    from bms_gateway.diagnose.checks import Finding
    from bms_gateway.diagnose.record import Record
    from bms_gateway.identify.map_fit import MapFit
    from bms_gateway.report.add_text import AddReport, Side
    from bms_gateway.thermal import Floats, StringModel

EXAMPLE = """\
  bms-gateway add entropic_heat --model string_1.toml --data bench.csv --out string_1b.toml
  bms-gateway add cell_cooling:3 --model string_1.toml --data bench.csv --out string_1b.toml
  bms-gateway add resistance_temperature entropic_heat --model cell.toml --data cell.csv --out cell_b.toml

EFFECT is a name of the catalogue, EFFECT:CELL where it sits on one cell (without CELL the best place is found);
exit status 1: the measurements speak against it, nothing is written; --force writes it all the same, and says so there
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("effect", nargs="+", metavar="EFFECT[:CELL]", help="what to add; several are judged together")
    parser.option("--model", type=Path, metavar="M", required=True, help="string model (TOML)")
    parser.option(
        "--data",
        type=Path,
        metavar="TABLE",
        action="append",
        required=True,
        help="measurements to fit: CSV or Parquet, with --config also a CAN log; may be given several times",
    )
    parser.option("--out", metavar="M2", required=True, help="model file to write (TOML)")
    parser.option("--cell", type=int, metavar="K", help="the cell that it sits on; the same as EFFECT:K")
    parser.option("--force", action="store_true", help="add it although the measurements speak against it")
    parser.option("--config", type=Path, metavar="C", help="gateway config: which signals of a log carry what")
    parser.option("--string", metavar="NAME", help="string that a log is read for, where the config has several")
    parser.option(
        "--columns",
        metavar="NAME=COLUMN",
        action="append",
        default=[],
        help="a table's own name of a column, as in compare",
    )
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Add; 1 where the measurements speak against it."""
    from bms_gateway.cli.fit import sound
    from bms_gateway.cli.measurements import read_measurements
    from bms_gateway.config.model_file import read_model, write_model
    from bms_gateway.diagnose.adding import check_signals
    from bms_gateway.diagnose.calibrate import fitted_model
    from bms_gateway.report.add_text import add_document, add_text
    from bms_gateway.report.examine import findings_and_notes
    from bms_gateway.report.table import parse_columns

    outputs = {"--out": args.out, "--json": args.json}
    writable(outputs)
    distinct(outputs, [args.model, *args.data, *([args.config] if args.config else [])])
    model = read_model(args.model)
    wants = _wanted(args, model)
    columns = parse_columns(args.columns)
    records = read_measurements(args.data, model=model, config=args.config, string=args.string, columns=columns)
    findings, notes = findings_and_notes(model, records)
    sound(findings)
    check_signals(wants, records)
    addition = _added(model, records, wants)
    report = _report(args, addition, findings, notes)
    if report.written:
        heading = f"{' '.join(args.effect)} added, fitted to {', '.join(report.sources)}"
        if report.forced:
            heading += f"\nadded by force, though: {addition.refused}"
        write_model(fitted_model(addition.after, model, doubt=addition.doubt), Path(args.out), heading)
    if args.json:
        write_json(args.json, add_document(report))
    if not report.written:
        note(f"not added: {report.names}: {addition.refused} (--force adds it all the same)")
        return 1
    say(add_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def _wanted(args: argparse.Namespace, model: "StringModel") -> "list[Wanted]":
    from bms_gateway.diagnose.adding import wanted

    words = list(args.effect)
    if args.cell is not None:
        if len(words) > 1 or ":" in words[0]:
            raise UsageError("add: --cell goes with one EFFECT; write EFFECT:CELL for each")
        words = [f"{words[0]}:{args.cell}"]
    found = [wanted(word, model) for word in words]
    twice = next((w.key for i, w in enumerate(found) if w.key in [x.key for x in found[:i]]), None)
    if twice:
        raise UsageError(f"add: {twice} is there twice")
    return found


def _added(model: "StringModel", records: "list[Record]", wants: "list[Wanted]") -> "Addition":
    from bms_gateway.diagnose.adding import add_effects
    from bms_gateway.report.progress import share_of

    with share_of("adding") as tell:
        return add_effects(model, records, wants, tell)


def _report(
    args: argparse.Namespace,
    addition: "Addition",
    findings: "tuple[tuple[str, Finding], ...]",
    notes: "tuple[tuple[str, str], ...]",
) -> "AddReport":
    from bms_gateway.diagnose.calibrate import changes
    from bms_gateway.report.add_text import AddReport

    return AddReport(
        str(args.out),
        addition.added,
        not addition.refused or args.force,
        bool(addition.refused) and args.force,
        addition.refused,
        addition.remark,
        addition.log_odds,
        _side(addition.seen[0], addition.core_K[0]),
        _side(addition.seen[1], addition.core_K[1]),
        addition.tail_K,
        changes(addition.after),
        tuple(m.source for m in addition.after.problem.records),
        findings,
        notes,
    )


def _side(fit: "MapFit", core_K: "Floats") -> "Side":
    from bms_gateway.diagnose.calibrate import channel_errors
    from bms_gateway.diagnose.diagnosis import errors
    from bms_gateway.report.add_text import Side

    return Side(errors(fit), channel_errors(fit), core_K)
