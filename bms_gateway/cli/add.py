"""`add`: add an effect of the catalogue to a model, if the measurements support it."""

import argparse
from dataclasses import replace
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import command_line, note, say, write_json
from bms_gateway.errors import UsageError

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
    from bms_gateway.diagnosis.adding import asked_for
    from bms_gateway.library.modelling import add
    from bms_gateway.report.add_text import add_document, add_text
    from bms_gateway.report.added import heading
    from bms_gateway.report.progress import share_of

    model = given_model(args)
    words = _words(args)
    asked_for(words, model)  # report a wrong name before the tables are read
    records = given_measurements(args, model)
    with share_of("adding") as tell:
        found = add(model, records, *words, force=args.force, progress=tell)
    report = replace(found.report, out=str(args.out))
    if report.written:
        write_model(found.model, Path(args.out), heading(report, args.effect))
    if args.html:
        from bms_gateway.report.html import write_addition

        write_addition(Path(args.html), report, found.addition, command_line("add"))
    if args.json:
        write_json(args.json, add_document(report))
    if not report.written:
        note(f"not added: {report.names}: {found.addition.refused} (--force adds it all the same)")
        return 1
    say(add_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def _words(args: argparse.Namespace) -> list[str]:
    words: list[str] = list(args.effect)
    if args.cell is None:
        return words
    if len(words) > 1 or ":" in words[0]:
        raise UsageError("add: --cell goes with one EFFECT; write EFFECT:CELL for each")
    return [f"{words[0]}:{args.cell}"]
