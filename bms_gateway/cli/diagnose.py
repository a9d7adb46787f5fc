"""`diagnose`: which physical effect a model lacks, by measurements."""

import argparse
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements
from bms_gateway.cli.output import distinct, say, writable, write_json

if TYPE_CHECKING:
    from bms_gateway.diagnose.diagnosis import Diagnosis
    from bms_gateway.diagnose.record import Record
    from bms_gateway.report.diagnosis_text import Told
    from bms_gateway.thermal import StringModel

EXAMPLE = """\
  bms-gateway diagnose bench.csv --model string_1.toml
  bms-gateway diagnose bench.csv --model string_1.toml --html report.html --json diagnosis.json
  bms-gateway diagnose drive.log.gz --model string_1.toml --config gateway.toml --string string_1
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_measurement_arguments(parser)
    parser.option("--html", metavar="FILE", help="write the report as one page that works offline")
    parser.option("--json", metavar="FILE", help="write the diagnosis as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Diagnose; every verdict is a success."""
    from bms_gateway.config.model_file import read_model
    from bms_gateway.report.diagnosis_text import diagnosis_document, diagnosis_text

    outputs = {"--html": args.html, "--json": args.json}
    writable(outputs)
    distinct(outputs, [args.model, *args.table, *([args.config] if args.config else [])])
    model = read_model(args.model)
    records = given_measurements(args, model)
    told = examine(model, records)
    if args.json:
        write_json(args.json, diagnosis_document(told))
    say(diagnosis_text(told), args.json)
    return 0


def examine(model: "StringModel", records: "list[Record]") -> "Told":
    """Check the records, and diagnose with those of which something can be learnt."""
    from bms_gateway.diagnose.checks import check_record
    from bms_gateway.report.diagnosis_text import Told

    findings = tuple((r.source, f) for r in records for f in check_record(r, model))
    notes = tuple((r.source, text) for r in records for text in r.notes)
    sources = tuple(r.source for r in records)
    stopped = {source for source, f in findings if f.severity == "stop"}
    usable = [r for r in records if r.source not in stopped]
    if not usable:
        why = " ".join(dict.fromkeys(f.sentence for _, f in findings if f.severity == "stop"))
        return Told(None, f"Nothing can be said from these data. {why}", sources, findings, notes)
    diagnosis = _diagnosed(model, usable)
    return Told(diagnosis, diagnosis.sentence, sources, findings, notes)


def _diagnosed(model: "StringModel", records: "list[Record]") -> "Diagnosis":
    from bms_gateway.diagnose.diagnosis import diagnose
    from bms_gateway.report.progress import share_of

    with share_of("diagnosing") as tell:
        return diagnose(model.unfitted, records, progress=tell)
