"""`diagnose`: which physical effect a model lacks, by measurements."""

import argparse
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import command_line, say, write_json

EXAMPLE = """\
  bms-gateway diagnose bench.csv --model string_1.toml
  bms-gateway diagnose bench.csv --model string_1.toml --html report.html --json diagnosis.json
  bms-gateway diagnose drive.log.gz --model string_1.toml --config gateway.toml --string string_1

several tables are records of one cell type: they share its physics, each has its own start and cooling
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_measurement_arguments(parser)
    parser.option("--html", metavar="FILE", help="write the report as one page that works offline")
    parser.option("--json", metavar="FILE", help="write the diagnosis as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Diagnose; exit status 0 for every verdict, an error for records that are too short for a verdict."""
    from bms_gateway.library.modelling import diagnose
    from bms_gateway.report.examine import long_enough, usable
    from bms_gateway.report.progress import share_of

    model = given_model(args)
    records = given_measurements(args, model)
    with share_of("diagnosing") as tell:
        found = diagnose(model, records, tell)
    told = found.told
    if args.html:
        from bms_gateway.diagnosis.compare import compare
        from bms_gateway.report.details import details_of
        from bms_gateway.report.html import write_diagnosis

        core = told.core if len(usable(records, told.findings)) == len(records) else None
        details = details_of(told, model, records, lambda: compare(model, records, core))
        write_diagnosis(Path(args.html), told, details, command=command_line("diagnose"))
    if args.json:
        write_json(args.json, found.document())
    say(str(found), args.json)
    if told.diagnosis is None:
        long_enough(told.findings)
    return 0
