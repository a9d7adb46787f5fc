"""`place`: where to put surface sensors, so that the least certain core is known best."""

import argparse

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import say, write_json
from bms_gateway.cli.string_options import add_string_arguments, given_string
from bms_gateway.errors import UsageError

EXAMPLE = """\
  bms-gateway place --cells 12 --sensors 4
  bms-gateway place --cells 12 --sensors 2 --condition natural --json -
  bms-gateway place --model string_1.toml --wanted 0.5

--wanted tells how many sensors it takes, and places as many where --sensors is not given; exit status 1 where even a
sensor on every cell is not enough
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    add_string_arguments(parser)
    parser.option("--sensors", metavar="M", type=int, help="how many sensors to place")
    parser.option("--wanted", metavar="SD", type=float, help="standard deviation that no core should exceed, K")


def run(args: argparse.Namespace) -> int:
    """Place sensors; exit status 1 if the wanted standard deviation cannot be reached."""
    from bms_gateway.report.progress import progress
    from bms_gateway.report.sensors_text import PlaceReport, place_document, place_text
    from bms_gateway.sensors.placement import PlacementProblem, observable_sets

    if args.sensors is None and args.wanted is None:
        raise UsageError("--sensors M is needed, how many to place, or --wanted SD, how well to know every core")
    if args.wanted is not None and not 0.0 < args.wanted <= 1e3:
        raise UsageError(f"--wanted {args.wanted:g}: a standard deviation in K, above 0")
    asked = given_string(args)
    n = asked.parameters.cells
    if args.sensors is not None and not 1 <= args.sensors <= n:
        raise UsageError(f"--sensors {args.sensors}: a string of {n} cells takes 1 to {n}")
    with progress("placing", None) as advance:
        advance(1)
        problem = PlacementProblem(asked.parameters, asked.disturbance)
        enough = None if args.wanted is None else problem.fewest(args.wanted)
        count = args.sensors if enough is None or args.sensors is not None else max(1, len(enough.sensors))
        placements = problem.best(count)
        exact, paper = observable_sets(asked.parameters, count)
    report = PlaceReport(
        placements, exact, paper, args.wanted, enough, asked.condition, asked.disturbance, asked.origin
    )
    if args.json:
        write_json(args.json, place_document(report))
    say(place_text(report), args.json)
    return 0 if enough is None or enough.worst_sd <= args.wanted else 1
