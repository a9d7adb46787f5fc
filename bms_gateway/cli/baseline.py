"""`baseline`: the baseline against which growth of R_e is measured; show it, or renew it after a cell was replaced."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import DEFAULT_CONFIG, Parser
from bms_gateway.errors import ConfigError, UsageError, clipped, did_you_mean, whole_number
from bms_gateway.records.recent_signals import STATE_DIRECTORY

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bms_gateway.config.load import LoadedConfig
    from bms_gateway.engine.plan import StringPlan
    from bms_gateway.health import Ageing, StringHealth

EXAMPLE = """
  bms-gateway baseline --show
  bms-gateway baseline --reset string_1:3 --reason "cell 3 replaced, order 4711"
  bms-gateway baseline --reset string_1 --reason "new module"
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("--reset", metavar="STRING[:CELL]", help="make a new baseline of a string, or of one cell")
    parser.option("--reason", metavar="TEXT", help="why; kept in the history")
    parser.option("--show", action="store_true", help="list baseline, growth and history of every string")
    parser.option(
        "--config", type=Path, default=DEFAULT_CONFIG, help=f"the gateway's config (default {DEFAULT_CONFIG})"
    )
    parser.option("--json", metavar="FILE", help="with --show: write it as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Ask the service for a new baseline, or show the present ones."""
    from bms_gateway.config.load import load_config

    if args.show == (args.reset is not None):
        raise UsageError("baseline: give either --show or --reset STRING[:CELL] --reason TEXT")
    if args.reset is not None and not (args.reason and args.reason.strip()):
        raise UsageError("baseline: --reset needs --reason TEXT: who services the vehicle next wants to know why")
    loaded = load_config(args.config)
    store = loaded.store or STATE_DIRECTORY
    if loaded.store is None and not os.path.lexists(store):
        raise ConfigError(
            f"{args.config}: [store] has no path, and no service is installed that keeps its state in {store}: "
            "there is no baseline"
        )
    return _show(args, loaded, store) if args.show else _reset(args, loaded, store)


def _target(word: str, loaded: "LoadedConfig") -> "tuple[StringPlan, int | None]":
    """Find the string and cell that a word names."""
    name, colon, cell = word.partition(":")
    strings = {s.name: s for s in loaded.plan.strings}
    if name not in strings:
        raise UsageError(f"baseline: there is no string '{name}'{did_you_mean(name, list(strings))}")
    n = strings[name].model.cells
    if not colon:
        return strings[name], None
    number = whole_number(cell)
    if number is None or not 1 <= number <= n:
        raise UsageError(f"baseline: '{clipped(cell, 60)}' is no cell of {name}; valid: 1 to {n}")
    return strings[name], number


def _reset(args: argparse.Namespace, loaded: "LoadedConfig", store: Path) -> int:
    import time

    from bms_gateway.store.requests import BaselineReset, ask, one_line

    string, cell = _target(args.reset, loaded)
    reason = one_line(args.reason)
    ask(store, BaselineReset(string.name, cell, reason, time.time_ns()))
    what = string.name if cell is None else f"cell {cell} of {string.name}"
    print(
        f"recorded: a new baseline of {what}; a running service makes it within seconds, a stopped one when it starts"
    )
    return 0


def _show(args: argparse.Namespace, loaded: "LoadedConfig", store: Path) -> int:
    from bms_gateway.cli.output import say, write_json

    state = _stored(store)
    found = {s.name: _health(s, state) for s in loaded.plan.strings}
    if args.json:
        write_json(args.json, {name: _document(health) for name, health in found.items()})
    for name, health in found.items():
        say("\n".join(_lines(name, health)), args.json)
    return 0


def _stored(store: Path) -> "Mapping[str, Any]":
    """Read the newest stored state; empty if there is none. No file is changed: the service may be saving."""
    from bms_gateway.cli.output import note
    from bms_gateway.store import StateStore

    found = StateStore(store).look()
    if found.state is None and found.problems:
        raise found.problems[0]
    for problem in found.problems:
        note(str(problem))
    return found.state or {}


def _health(string: "StringPlan", state: "Mapping[str, Any]") -> "StringHealth":
    """Give the stored health of a string; without a stored one, that of a new string."""
    from bms_gateway.engine.plausible import fitting
    from bms_gateway.engine.string_estimator import health_of

    health = health_of(string)
    with fitting():
        kept = state.get("estimators", {}).get("strings", {}).get(string.name, {}).get("health")
        if kept is not None:
            health.restore(kept)
    return health


def _document(h: "StringHealth") -> dict[str, object]:
    """Give baselines and history as a document for machines."""
    cells = {} if h.cells is None else {str(k): _growth(a) for k, a in enumerate(h.cells.ageing, start=1)}
    return {
        "commissioned": h.commissioned,
        "baseline_mohm": 1e3 * h.baseline if h.commissioned else None,
        "growth_pct": _growth(h.ageing),
        "cells_growth_pct": cells,
        "flags": [{"code": c.code, "level": c.level, "text": c.text, "cell": c.cell} for c in h.conditions()],
        "history": [
            {"time_ns": t, "R_e_mohm": 1e3 * R, "growth_pct": 100 * g, "sd_pct": 100 * sd} for t, R, g, sd, _ in
            h.history.rows
        ],
        "events": [{"time_ns": t, "text": text} for t, text in h.history.events],
    }  # fmt: skip


def _growth(ageing: "Ageing") -> float | None:
    return round(100.0 * ageing.growth, 3) if ageing.growth == ageing.growth else None


def _lines(name: str, h: "StringHealth") -> list[str]:
    """Give baselines and history as lines for people."""
    from datetime import UTC, datetime

    from bms_gateway.store.requests import one_line

    def day(t: int) -> str:
        try:
            return datetime.fromtimestamp(t * 1e-9, UTC).strftime("%Y-%m-%d")
        except (ValueError, OverflowError, OSError):
            return "of no day "

    if h.commissioned:
        lines = [f"{name}: baseline R_e {1e3 * h.baseline:.3f} mOhm at 25 °C; {h.ageing.sentence()}"]
    else:
        lines = [f"{name}: no baseline yet: R_e has not been identified for long enough"]
    for k, a in enumerate(h.cells.ageing if h.cells is not None else (), start=1):
        if a.growth == a.growth:
            lines.append(f"  cell {k}: {100 * a.growth:+.1f} ± {100 * a.growth_sd:.1f} %")
    # any owner of the state may have written its texts
    lines += [f"  {day(t)}  {one_line(text, 400)}" for t, text in h.history.events]
    step = max(1, len(h.history.rows) // 12)
    for t, R, g, sd, _ in h.history.rows[::-step][::-1]:
        lines.append(f"  {day(t)}  R_e {1e3 * R:.3f} mOhm  {100 * g:+.1f} ± {100 * sd:.1f} %")
    return lines
