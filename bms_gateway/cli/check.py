"""`check`: whether a config is valid, and whether the sensors of every string determine its cores."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.cli.store_place import store_problem

if TYPE_CHECKING:
    from bms_gateway.config.load import LoadedConfig
    from bms_gateway.engine.plan import StringPlan
    from bms_gateway.records.signal_use import Use
    from bms_gateway.thermal import StringModel

EXAMPLE = """\
  bms-gateway check gateway.toml
  bms-gateway check gateway.toml --json -
  bms-gateway check gateway.toml --log drive.log.gz       # what is used of each signal, and why not
"""

MOST_TOLD = 20


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("config", metavar="CONFIG", help="gateway config (TOML)")
    parser.option(
        "--log",
        action="append",
        default=[],
        type=Path,
        metavar="LOG",
        help="a log of the vehicle: shows what is used of each signal",
    )
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Check; 1 where a string is not observable, or a log shows that a signal is not used or contradicts another."""
    import numpy as np

    from bms_gateway.config.load import load_config
    from bms_gateway.records.once import given_once, in_order
    from bms_gateway.report.show import number, ranges, text_table
    from bms_gateway.sensors import determined_states, steady_core_sd

    writable({"--json": args.json})
    loaded = load_config(Path(args.config))
    distinct({"--json": args.json}, [*loaded.files, *args.log])
    given_once(args.log)
    in_order(args.log)
    plan = loaded.plan
    key = "store.path" if loaded.config.store.path is not None else "STATE_DIRECTORY"
    problem = store_problem(loaded.store, f"{args.config}: {key}")
    loaded.engine()  # a config of which no engine can be made would end the service
    strings: list[dict[str, Any]] = []
    for s in plan.strings:
        p, sensors = s.model.nominal, _sensed(s)
        rank = determined_states(p, sensors)
        sd = np.hypot(steady_core_sd(p, sensors, plan.disturbance), _rounded_K(loaded, s))
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
                "unknown_sd_per_10K": round(_unknown_per_10K(s.model), 2),
                "of_several": s.of_several,
                "heat_unseen_cells": [
                    k
                    for k in range(1, s.model.cells + 1)
                    if s.of_several or not {k - 1, k, k + 1}.intersection(sensors)
                ],
                "signals": {_label(*c.key): c.source or f"constant {c.constant:g}" for c in s.channels},
            }
        )
    if problem:
        note(f"{args.config}: {key}: {problem}: the state would not be kept here")
    uses, wrong = _uses(loaded, args.log) if args.log else ({}, [])
    lost = [signal for signal, use in uses.items() if use.lost]
    blind = [s["name"] for s in strings if not s["observable"]]
    cut = [use.key for use in uses.values() if use.cut]
    if args.json:
        bus = loaded.config.bus
        document = {
            "ok": not (blind or lost or wrong or cut),
            "config": args.config,
            "channel": bus.channel,
            "transmit": plan.transmit,
        }
        store = {"store": str(loaded.store) if loaded.store else None, "store_problem": problem}
        used: dict[str, Any] = {}
        if args.log:
            used = {"signals": {signal: use.document() for signal, use in uses.items()}, "contradictions": wrong}
        write_json(args.json, document | store | {"strings": strings} | used)
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
    if args.log:
        _tell(uses, wrong, args.json)
    _say_what_sd_means(strings, args.json)
    unsound = ["signals contradict each other or the model"] if wrong else []
    unsound += [f"a part of {key} is refused" for key in cut]
    return _conclude(args, strings, lost, unsound)


def _rounded_K(loaded: "LoadedConfig", string: "StringPlan") -> float:
    """Sd by the steps of the string's coarsest thermocouple; no filter removes this error from a slow surface."""
    mine = [c for c in string.channels if c.quantity == "surface" and c.signal]
    steps = [abs(c.scale) * loaded.database.resolve(c.signal or "").resolution for c in mine]
    return float(max(steps, default=0.0) / 12**0.5)


def _conclude(args: argparse.Namespace, strings: list[dict[str, Any]], lost: list[str], unsound: list[str]) -> int:
    """Print the faults of the config, or that it is sound; return the exit status."""
    from bms_gateway.report.show import ranges

    blind = [s["name"] for s in strings if not s["observable"]]
    if blind:
        remedy = "add surface sensors, or change the condition if cells do touch or share coolant"
        say(f"not observable: {', '.join(blind)}: {remedy}", args.json)
        return 1
    for one in strings:
        if one["heat_unseen_cells"]:
            cells = ranges(one["heat_unseen_cells"])
            far = "a worse cooled cell reads alike" if one["of_several"] else "two or more cells away from every sensor"
            say(f"{one['name']}: unexplained heat of cells {cells} cannot be seen: {far}", args.json)
    if lost:
        shown = ", ".join(lost[:5]) + (f" and {len(lost) - 5} more" if len(lost) > 5 else "")
        say(f"not used: {shown}", args.json)
        return 1
    if unsound:
        say(f"not sound: {', '.join(unsound)}", args.json)
        return 1
    say(f"{args.config}: sound", args.json)
    return 0


def _unknown_per_10K(model: "StringModel") -> float:
    """Give the sd, K, that the uncertainty of R_e and R_c adds to a core that is 10 K above its surface."""
    spread = [model.priors[name].rel_sd or 0.0 for name in ("R_e", "R_c") if name in model.priors]
    return float(10.0 * sum(x**2 for x in spread) ** 0.5)


def _say_what_sd_means(strings: list[dict[str, Any]], json_target: str | None) -> None:
    """Print, once for equal strings, that the bands of `analyze` begin wider than the sd of the table."""
    by_value: dict[float, list[str]] = {}
    for one in strings:
        by_value.setdefault(one["unknown_sd_per_10K"], []).append(one["name"])
    for value, names in by_value.items():
        if value > 0:
            shown = names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}"
            say(
                f"{shown}: the worst core sd is that of a model whose parameters are known. Before they are "
                f"identified, the uncertainty of R_e and R_c adds {value:.2g} K of sd to a core that is 10 K above its "
                "surface",
                json_target,
            )


def _uses(loaded: "LoadedConfig", logs: list[Path]) -> "tuple[dict[str, Use], list[str]]":
    """Let the engine read the logs; give the use of each signal, and the contradictions between signals.

    The estimates are not needed, so simple models are used.
    """
    from dataclasses import replace

    from bms_gateway.bus.logfile import LogNotes
    from bms_gateway.cli.logged_frames import logged_frames
    from bms_gateway.engine import Engine
    from bms_gateway.errors import DataError
    from bms_gateway.records.courses import Courses
    from bms_gateway.records.signal_use import contradictions, signal_use
    from bms_gateway.records.span import Span

    plain = tuple(replace(s, identify="off", model=replace(s.model, effects=())) for s in loaded.plan.strings)
    plan = replace(loaded.plan, transmit=False, strings=plain)
    engine = Engine(plan, loaded.database, whole=True)
    courses = Courses(engine, loaded.database)
    span = Span()
    for batch in logged_frames(logs, [LogNotes() for _ in logs], span):
        engine.receive(batch, now_ns=int(batch.time_ns.max()))
        while (event := engine.next_output()) is not None:
            courses.take(event)
    if not span.frames:
        raise DataError(f"{', '.join(str(log) for log in logs)}: no data frames")
    stated = {s.name for s in loaded.config.string if s.signals is not None}
    wrong = [*contradictions(plan, engine.inputs), *courses.contradictions()]
    return signal_use(plan, loaded.database, engine, stated), wrong


def _tell(uses: "dict[str, Use]", wrong: list[str], json_target: str | None) -> None:
    from bms_gateway.records.signal_use import advice
    from bms_gateway.report.signals_text import signals_table

    say(signals_table({signal: use.document() for signal, use in uses.items()}), json_target)
    told = [*wrong, *advice(uses)]
    for line in told[:MOST_TOLD]:
        say(line, json_target)
    if len(told) > MOST_TOLD:
        say(f"… and {len(told) - MOST_TOLD} more (--json tells all)", json_target)


def _sensed(string: "StringPlan") -> tuple[int, ...]:
    """List the cells with a sensor; for a reading of several cells, the cell that stands for them."""
    from bms_gateway.engine.statistics import stand_in

    own = {c.cell for c in string.channels if c.quantity == "surface" and c.cell is not None}
    several = {stand_in(c.statistic, c.among) for c in string.channels if c.statistic is not None}
    return tuple(sorted(own | several))


def _label(quantity: str, cell: int | None) -> str:
    return quantity if cell is None else f"{quantity}_{cell}"
