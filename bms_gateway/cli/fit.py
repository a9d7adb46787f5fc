"""`fit`: batch identification of a string model from measurements."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import say, write_json
from bms_gateway.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bms_gateway.diagnose.checks import Finding
    from bms_gateway.diagnose.record import Record

EXAMPLE = """\
  bms-gateway fit bench.csv --model string_1.toml --out fitted.toml
  bms-gateway fit fan.csv still_air.csv --model cell.toml --out fitted.toml
  bms-gateway fit bench.csv --model cell.toml --out calibrated.toml --calibrate

several tables are records of one cell type: they share its physics, each has its own start and cooling (R_u);
--calibrate uses the columns core_K_C too: what it tells of the cell stays known to later fits and diagnoses
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_measurement_arguments(parser)
    parser.option("--out", metavar="M2", required=True, help="model file to write (TOML)")
    parser.option("--calibrate", action="store_true", help="use the thermocouples in the cores too (core_K_C)")
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Fit, and write the model."""
    from bms_gateway.config.model_file import write_model
    from bms_gateway.diagnose.calibrate import changes, channel_errors, fitted_model, identify
    from bms_gateway.diagnose.detect import absorbed
    from bms_gateway.diagnose.diagnosis import errors
    from bms_gateway.report.examine import findings_and_notes
    from bms_gateway.report.fit_text import FitReport, fit_document, fit_text
    from bms_gateway.report.progress import progress

    model = given_model(args)
    records = given_measurements(args, model)
    findings, notes = findings_and_notes(model, records)
    sound(findings)
    if args.calibrate:
        _with_cores(records)
    with progress("fitting", None) as advance:
        advance(1)
        found = identify(model, records, core=args.calibrate)
    report = FitReport(
        args.out,
        tuple(r.source for r in records),
        args.calibrate,
        changes(found.fit),
        absorbed(found.fit).combinations,
        channel_errors(found.seen),
        errors(found.seen),
        found.model_error_K,
        findings,
        notes,
    )
    how = "calibrated with the core on" if args.calibrate else "fitted to"
    write_model(
        fitted_model(found.fit, model, calibrated=args.calibrate), Path(args.out), f"{how} {', '.join(report.sources)}"
    )
    if args.json:
        write_json(args.json, fit_document(report))
    say(fit_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def sound(findings: "Sequence[tuple[str, Finding]]") -> None:
    """Refuse records of which nothing can be learnt.

    Raises
    ------
    DataError
    """
    for source, f in findings:
        if f.severity == "stop":
            raise DataError(f"{source}: {f.sentence}")


def long_enough(findings: "Sequence[tuple[str, Finding]]") -> None:
    """Refuse records that are too short even to be compared.

    Raises
    ------
    DataError
    """
    sound([(source, f) for source, f in findings if f.kind == "too_short"])


def _with_cores(records: "list[Record]") -> None:
    for r in records:
        if not len(r.core.y):
            raise DataError(
                f"{r.source}: --calibrate needs a thermocouple in a core: no column core_1_C, nor of another cell"
            )
