"""`observability`: how well surface sensors determine the cores of a string."""

import argparse

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import say, write_json
from bms_gateway.cli.string_options import add_string_arguments, given_sensors, given_string

EXAMPLE = """\
  bms-gateway observability --cells 12 --sensors 1,12
  bms-gateway observability --cells 12 --sensors 3,6,9,12 --condition no-conduction --json -
  bms-gateway observability --model string_1.toml --noise 0.3

without --sensors: those of the model, or one on every cell; 1-3,12 and none are understood too
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_string_arguments(parser)
    parser.option("--sensors", metavar="CELLS", help="cells whose surface is measured, counted from 1, as in 1,5")


def run(args: argparse.Namespace) -> int:
    """Tell ranks and core uncertainty of one set of sensors."""
    from bms_gateway.report.sensors_text import observability_document, observability_text
    from bms_gateway.sensors.observability import observability

    asked = given_string(args)
    p = asked.parameters
    every = tuple(range(1, p.cells + 1))
    if args.sensors is not None:
        sensors = given_sensors(args.sensors, p.cells)
    else:
        sensors = every if asked.sensors is None else asked.sensors
    found = observability(p, sensors, asked.disturbance)
    if args.json:
        write_json(args.json, observability_document(found, sensors, asked.condition))
    text = observability_text(found, sensors, asked.condition, asked.disturbance, asked.origin)
    say(text, args.json)
    return 0
