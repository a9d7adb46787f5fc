"""`acknowledge`: end alarms that stay until a person has looked at the string."""

import argparse
import os
from pathlib import Path

from bms_gateway.cli.main import DEFAULT_CONFIG, Parser
from bms_gateway.errors import ConfigError, UsageError, did_you_mean
from bms_gateway.records.recent_signals import STATE_DIRECTORY

EXAMPLE = """
  bms-gateway acknowledge all --reason "string_1 cooled and looked at"
  bms-gateway acknowledge string_1 --reason "cell 3 exchanged"
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("string", metavar="STRING", help="string whose alarms may end; all: every string")
    parser.option("--reason", required=True, metavar="TEXT", help="what was checked or repaired; kept in the journal")
    parser.option(
        "--config", type=Path, default=DEFAULT_CONFIG, help=f"the gateway's config (default {DEFAULT_CONFIG})"
    )


def run(args: argparse.Namespace) -> int:
    """Tell the service that a person has looked at its alarms; persistent faults raise them again."""
    import time

    from bms_gateway.config.load import load_config
    from bms_gateway.store.requests import Acknowledgement, ask, one_line

    reason = one_line(args.reason)
    if not reason:
        raise UsageError("acknowledge: --reason TEXT: the next person wants to know what was checked or repaired")
    loaded = load_config(args.config)
    names = [s.name for s in loaded.plan.strings]
    if args.string not in ("all", *names):
        raise UsageError(f"acknowledge: there is no string '{args.string}'{did_you_mean(args.string, [*names, 'all'])}")
    store = loaded.store or STATE_DIRECTORY
    if loaded.store is None and not os.path.lexists(store):
        raise ConfigError(
            f"{args.config}: [store] has no path, and no service is installed that keeps its state in {store}: "
            "there is nothing to acknowledge"
        )
    ask(store, Acknowledgement(None if args.string == "all" else args.string, reason, time.time_ns()))
    print("recorded: a running service acts on it within seconds, a stopped one when it starts")
    return 0
