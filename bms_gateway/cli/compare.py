"""`compare`: measured and free-running model side by side."""

import argparse
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import command_line, say, write_json

EXAMPLE = """\
  bms-gateway compare bench.csv --model string_1.toml
  bms-gateway compare bench.csv --model string_1.toml --html report.html --json comparison.json
  bms-gateway compare cell.csv --model cell.toml --columns time_s=t_s --columns current_A=-I_A
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_measurement_arguments(parser)
    parser.option("--html", metavar="FILE", help="write the comparison as one page that works offline")
    parser.option("--json", metavar="FILE", help="write the comparison as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Compare."""
    from bms_gateway.library.modelling import compare

    model = given_model(args)
    found = compare(model, given_measurements(args, model))
    if args.html:
        from bms_gateway.report.html import Aside, write_comparison

        comparison = found.comparison
        aside = Aside(comparison.sources, found.findings, found.notes, command_line("compare"))
        write_comparison(Path(args.html), comparison, aside)
    if args.json:
        write_json(args.json, found.document())
    say(str(found), args.json)
    return 0
