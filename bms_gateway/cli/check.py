"""`check`: tells whether a config is sound and whether the cores of every string can be told from its sensors."""

import argparse
import os
from pathlib import Path
from typing import Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json

EXAMPLE = """\
  bms-gateway check gateway.toml
  bms-gateway check gateway.toml --json -
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("config", metavar="CONFIG", help="gateway config (TOML)")
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Check; 1 where a string is not observable."""
    from bms_gateway.config import load_config
    from bms_gateway.report.show import number, ranges, text_table
    from bms_gateway.sensors import determined_states, steady_core_sd

    writable({"--json": args.json})
    loaded = load_config(Path(args.config))
    distinct({"--json": args.json}, loaded.files)
    plan = loaded.plan
    strings: list[dict[str, Any]] = []
    for s in plan.strings:
        p, sensors = s.model.nominal, s.model.sensors
        rank = determined_states(p, sensors)
        sd = steady_core_sd(p, sensors, plan.disturbance)
        worst = int(sd.argmax())
        strings.append(
            {
                "name": s.name,
                "number": s.number,
                "cells": s.model.cells,
                "sensors": list(sensors),
                "condition": s.model.condition,
                "states": 2 * s.model.cells,
                "exact_rank": rank,
                "observable": rank == 2 * s.model.cells,
                "core_sd_K": [round(float(x), 4) for x in sd],
                "worst_cell": worst + 1,
                "worst_core_sd_K": round(float(sd[worst]), 4),
                "signals": {_label(c.quantity, c.cell): c.signal or f"constant {c.constant:g}" for c in s.channels},
            }
        )
    problem = _unstorable(loaded.store)
    if problem:
        note(f"{args.config}: store.path: {problem}: the state would not be kept here")
    blind = [s["name"] for s in strings if not s["observable"]]
    if args.json:
        bus = loaded.config.bus
        document = {"ok": not blind, "config": args.config, "channel": bus.channel, "transmit": plan.transmit}
        store = {"store": str(loaded.store) if loaded.store else None, "store_problem": problem}
        write_json(args.json, document | store | {"strings": strings})
    rows = [
        [
            s["name"],
            ranges(s["sensors"]) or "–",
            s["condition"],
            s["cells"],
            f"{s['exact_rank']}/{s['states']}",
            "yes" if s["observable"] else "NO",
            s["worst_cell"],
            number(s["worst_core_sd_K"]),
        ]
        for s in strings
    ]
    headers = ["string", "sensors", "condition", "cells", "exact rank", "observable", "worst cell", "worst core sd K"]
    say(text_table(headers, rows, left=3), args.json)
    if blind:
        remedy = "add surface sensors, or change the condition if cells do touch or share coolant"
        say(f"not observable: {', '.join(blind)}: {remedy}", args.json)
        return 1
    say(f"{args.config}: sound", args.json)
    return 0


def _unstorable(store: Path | None) -> str | None:
    """Tell why no state can be kept in a directory, if so; one that is not there yet is made by the service."""
    if store is None:
        return None
    there = next(p for p in (store.absolute(), *store.absolute().parents) if os.path.lexists(p))
    if not there.is_dir():
        return f"{there} is no directory"
    return None if os.access(there, os.W_OK | os.X_OK) else f"{there} cannot be written by this user"


def _label(quantity: str, cell: int | None) -> str:
    return quantity if cell is None else f"{quantity}_{cell}"
