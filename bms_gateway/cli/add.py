"""`add`: add an effect of the catalogue to a model, if the measurements support it."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import command_line, note, say, write_json
from bms_gateway.errors import UsageError

if TYPE_CHECKING:
    from bms_gateway.diagnosis.adding import Addition, Wanted
    from bms_gateway.diagnosis.record import Record
    from bms_gateway.thermal import StringModel

EXAMPLE = """\
  bms-gateway add entropic_heat --model string_1.toml --data bench.csv --out string_1b.toml
  bms-gateway add cell_cooling:3 --model string_1.toml --data bench.csv --out string_1b.toml --html added.html
  bms-gateway add resistance_temperature entropic_heat --model cell.toml --data cell.csv --out cell_b.toml

EFFECT is a name of the catalogue, EFFECT:CELL where it sits on one cell (without CELL the best place is found);
exit status 1: the measurements speak against it, nothing is written; --force writes it all the same, and says so there
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("effect", nargs="+", metavar="EFFECT[:CELL]", help="what to add; several are judged together")
    add_measurement_arguments(parser, "--data")
    parser.option("--out", metavar="M2", required=True, help="model file to write (TOML)")
    parser.option("--cell", type=int, metavar="K", help="the cell that it sits on; the same as EFFECT:K")
    parser.option("--force", action="store_true", help="add it although the measurements speak against it")
    parser.option("--html", metavar="FILE", help="write before and after as one page that works offline")
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Add; 1 where the measurements speak against it."""
    from bms_gateway.config.model_file import write_model
    from bms_gateway.diagnosis.adding import check_signals
    from bms_gateway.report.add_text import add_document, add_text
    from bms_gateway.report.added import added_report, heading
    from bms_gateway.report.examine import findings_and_notes, sound

    model = given_model(args)
    wants = _wanted(args, model)
    records = given_measurements(args, model)
    findings, notes = findings_and_notes(model, records)
    sound(findings)
    check_signals(wants, records)
    addition = _added(model, records, wants)
    report = added_report(addition, records, findings, notes, out=str(args.out), force=args.force)
    if report.written:
        write_model(addition.model, Path(args.out), heading(report, args.effect))
    if args.html:
        from bms_gateway.report.html import write_addition

        write_addition(Path(args.html), report, addition, command_line("add"))
    if args.json:
        write_json(args.json, add_document(report))
    if not report.written:
        note(f"not added: {report.names}: {addition.refused} (--force adds it all the same)")
        return 1
    say(add_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def _wanted(args: argparse.Namespace, model: "StringModel") -> "list[Wanted]":
    from bms_gateway.diagnosis.adding import wanted

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
    from bms_gateway.diagnosis.adding import add_effects
    from bms_gateway.report.progress import share_of

    with share_of("adding") as tell:
        return add_effects(model, records, wants, tell)
