"""`place`: where to put surface sensors, so that the least certain core is known best."""

import argparse

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import say, write_json
from bms_gateway.cli.string_options import add_string_arguments, given_string
from bms_gateway.errors import UsageError, counted

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
    from bms_gateway.library.placing import placed_on
    from bms_gateway.report.progress import progress

    if args.sensors is None and args.wanted is None:
        raise UsageError("--sensors M is needed, how many to place, or --wanted SD, how well to know every core")
    if args.wanted is not None and not 0.0 < args.wanted <= 1e3:
        raise UsageError(f"--wanted {args.wanted:g}: a standard deviation in K, above 0")
    asked = given_string(args)
    n = asked.parameters.cells
    if args.sensors is not None and not 1 <= args.sensors <= n:
        raise UsageError(f"--sensors {args.sensors}: a string of {counted(n, 'cell')} takes 1 to {n}")
    with progress("placing", None) as advance:
        advance(1)
        found = placed_on(asked, args.sensors, args.wanted)
    if args.json:
        write_json(args.json, found.document())
    say(str(found), args.json)
    return 0 if found.reached else 1
