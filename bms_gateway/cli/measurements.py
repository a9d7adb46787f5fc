"""Arguments of commands that compare, fit and diagnose measurements."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, needs_plotly, writable

if TYPE_CHECKING:
    from bms_gateway.diagnosis.record import Record
    from bms_gateway.thermal import StringModel


def add_measurement_arguments(parser: Parser, option: str | None = None) -> None:
    """Declare `TABLE... --model M [--config C] [--string NAME] [--columns NAME=COLUMN]`.

    Parameters
    ----------
    parser : Parser
    option : str, optional
        Option that names a table, if the command's positional arguments are something else.
    """
    name, how = ((option,), {"action": "append", "required": True}) if option else ((), {"nargs": "+"})
    parser.option(
        *name,
        dest="table",
        **how,
        type=Path,
        metavar="TABLE",
        help="measurements of one string: CSV, Parquet or MF4; with --config also a CAN log. Several: one record each",
    )
    parser.option("--model", type=Path, metavar="M", required=True, help="string model (TOML)")
    parser.option("--config", type=Path, metavar="C", help="gateway config: which signals of a log carry what")
    parser.option("--string", metavar="NAME", help="string that a log is read for, where the config has several")
    parser.option(
        "--columns",
        metavar="NAME=COLUMN",
        action="append",
        default=[],
        help="a table's own name of a column, once per column, or several separated by commas; "
        "a minus before COLUMN changes the sign",
    )


def given_model(args: argparse.Namespace) -> "StringModel":
    """Read the model, after checking that the results can be written and drawn and overwrite no input."""
    from bms_gateway.config.model_file import read_model

    outputs = {f"--{name}": getattr(args, name, None) for name in ("out", "html", "json")}
    writable(outputs)
    distinct(outputs, [args.model, *args.table, *([args.config] if args.config else [])])
    if outputs["--html"]:
        needs_plotly()
    return read_model(args.model)


def given_measurements(args: argparse.Namespace, model: "StringModel") -> "list[Record]":
    """Read the files that the arguments of `add_measurement_arguments` name."""
    from bms_gateway.records.read import read_measurements
    from bms_gateway.report.table import parse_columns

    columns = parse_columns(args.columns)
    return read_measurements(args.table, model=model, config=args.config, string=args.string, columns=columns)
