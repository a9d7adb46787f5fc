"""`doctor`: what this computer lacks to run the gateway, and the command that adds it."""

import argparse
import re
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.errors import UsageError

EXAMPLE = """
  bms-gateway doctor
  bms-gateway doctor --config /etc/bms-gateway/gateway.toml
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("--interface", metavar="NAME", help="CAN interface; default: that of the config, else can0")
    parser.option("--config", type=Path, metavar="CONFIG", help="gateway config: its interface and its store")
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Check the computer; 1 if something is missing."""
    from dataclasses import asdict

    from bms_gateway.cli.output import distinct, say, writable, write_json
    from bms_gateway.report.show import text_table
    from bms_gateway.service.doctor import examine, state_folder

    writable({"--json": args.json})
    if args.interface is not None and not re.fullmatch(r"[A-Za-z0-9_.:-]{1,15}", args.interface):
        # users paste the printed commands into a shell
        raise UsageError(f"--interface {args.interface!r}: an interface has a name of 1 to 15 letters and digits: can0")
    channel, store = args.interface or "can0", None
    if args.config is not None:
        from bms_gateway.config.load import load_config

        loaded = load_config(args.config)
        distinct({"--json": args.json}, loaded.files)
        channel, store = args.interface or loaded.config.bus.channel, loaded.store
    found = list(examine(channel))
    if store is not None:
        found.append(state_folder(store))
    missing = [f for f in found if f.state == "missing"]
    if args.json:
        write_json(args.json, {"ok": not missing, "interface": channel, "found": [asdict(f) for f in found]})
    say(text_table(["", "state", "found"], [[f.name, f.state, f.what] for f in found], left=3), args.json)
    for f in found:
        if f.command is not None:
            say(f"{f.name}: {f.command}", args.json)
    say(f"{len(missing)} missing" if missing else "nothing is missing", args.json)
    return 1 if missing else 0
