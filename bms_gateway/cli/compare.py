"""`compare`: measured and free-running model side by side."""

import argparse

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements
from bms_gateway.cli.output import distinct, say, writable, write_json

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
    from bms_gateway.config.model_file import read_model
    from bms_gateway.diagnose.checks import check_record
    from bms_gateway.diagnose.compare import compare
    from bms_gateway.report.comparison_text import comparison_document, comparison_text

    outputs = {"--html": args.html, "--json": args.json}
    writable(outputs)
    distinct(outputs, [args.model, *args.table, *([args.config] if args.config else [])])
    model = read_model(args.model)
    records = given_measurements(args, model)
    findings = [(r.source, f) for r in records for f in check_record(r, model)]
    notes = [(r.source, text) for r in records for text in r.notes]
    comparison = compare(model, records)
    if args.json:
        write_json(args.json, comparison_document(comparison, findings, notes))
    say(comparison_text(comparison, findings, notes), args.json)
    return 0
