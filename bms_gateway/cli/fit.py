"""`fit`: batch identification of a string model from measurements."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements, given_model
from bms_gateway.cli.output import say, write_json
from bms_gateway.errors import ConfigError, DataError, UsageError

if TYPE_CHECKING:
    from bms_gateway.diagnosis.record import Record

EXAMPLE = """\
  bms-gateway fit bench.csv --model string_1.toml --out fitted.toml
  bms-gateway fit fan.csv still_air.csv --model cell.toml --out fitted.toml
  bms-gateway fit bench.csv --model cell.toml --out calibrated.toml --calibrate
  bms-gateway fit commissioning.csv --model string_1.toml --out string_1b.toml --cells

several tables are records of one cell type: they share its physics, each has its own start and cooling (R_u);
--calibrate uses the columns core_K_C too: what it tells of the cell stays known to later fits and diagnoses

--cells tells the cells of one string apart: R_e of each, from all surfaces that the table has (surface_K_C, also of
cells that the vehicle does not sense) and from the cells' voltages where it has them (cell_voltage_K_V). Sense every
surface once, at commissioning, for an hour of driving with a moving inlet; the model written keeps its own sensors, and
run and analyze estimate with each cell's own numbers. [cells] of --config says what the voltages are worth; where the
run is a log, the config's model lists every sensed cell
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_measurement_arguments(parser)
    parser.option("--out", metavar="M2", required=True, help="model file to write (TOML)")
    parser.option("--calibrate", action="store_true", help="use the thermocouples in the cores too (core_K_C)")
    parser.option(
        "--cells", action="store_true", help="find R_e of each cell of the string, from one table with more sensors"
    )
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Fit, and write the model."""
    from bms_gateway.config.model_file import write_model
    from bms_gateway.library.modelling import fit
    from bms_gateway.report.core_text import file_heading
    from bms_gateway.report.fit_text import fit_document, fit_text
    from bms_gateway.report.progress import progress

    if args.cells:
        return _cells(args)
    model = given_model(args)
    records = given_measurements(args, model)
    if args.calibrate:
        _with_cores(records)
    with progress("fitting", None) as advance:
        advance(1)
        found = fit(model, records, calibrate=args.calibrate)
    report = replace(found.report, out=args.out)
    how = "calibrated with the core on" if args.calibrate else "fitted to"
    write_model(found.model, Path(args.out), file_heading(f"{how} {', '.join(report.sources)}", report.core))
    if args.json:
        write_json(args.json, fit_document(report))
    say(fit_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def _cells(args: argparse.Namespace) -> int:
    """Find R_e of each cell, and write the model with these numbers."""
    from bms_gateway.config import load_config
    from bms_gateway.config.model_file import write_model
    from bms_gateway.diagnosis.cells_apart import sensed_everywhere, tell_apart
    from bms_gateway.identify.cell_kept import kept
    from bms_gateway.identify.cell_prior import CellSettings
    from bms_gateway.report.cells_text import CellsReport, cells_document, cells_text
    from bms_gateway.report.examine import findings_and_notes, sound
    from bms_gateway.report.progress import progress
    from bms_gateway.thermal import Disturbance

    if args.calibrate:
        raise UsageError("--cells and --calibrate cannot be used together; calibrate a cell first, then use --cells")
    if len(args.table) > 1:
        raise UsageError(f"--cells takes one table, the commissioning run; {len(args.table)} are given")
    model = given_model(args)
    try:
        everywhere = sensed_everywhere(model)
    except ConfigError as e:
        raise ConfigError(f"{args.model}: {e}") from None
    records = given_measurements(args, everywhere)
    findings, notes = findings_and_notes(everywhere, records)
    sound(findings)
    settings, disturbance = CellSettings(), Disturbance()
    if args.config:
        plan = load_config(args.config).plan
        settings, disturbance = plan.cells, plan.disturbance
    with progress("telling the cells apart", None) as advance:
        advance(1)
        result, more = tell_apart(model, records[0], settings, disturbance)
    source = records[0].source
    report = CellsReport(args.out, source, result, settings, findings, (*notes, *((source, text) for text in more)))
    write_model(kept(model, result.fit, result.resistance), Path(args.out), f"cells told apart by {source}")
    if args.json:
        write_json(args.json, cells_document(report))
    say(cells_text(report), args.json)
    say(f"\n{args.out}: written", args.json)
    return 0


def _with_cores(records: "list[Record]") -> None:
    for r in records:
        if not len(r.core.y):
            raise DataError(
                f"{r.source}: --calibrate needs a thermocouple in a core: no column core_1_C, or of another cell"
            )
