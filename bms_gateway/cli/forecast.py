"""`forecast`: forecast of the cores after a log, and the score of earlier forecasts within the log."""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.errors import DataError, UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bms_gateway.bus.logfile import LogNotes
    from bms_gateway.engine import Engine
    from bms_gateway.engine.forecast_result import Foreseen
    from bms_gateway.observe.ahead import Ahead
    from bms_gateway.records.span import Span
    from bms_gateway.report.forecast_score import Row, Scorer, Truth
    from bms_gateway.thermal import Floats

EXAMPLE = """
  bms-gateway forecast drive.log.gz --config gateway.toml
  bms-gateway forecast drive.log.gz --config gateway.toml --profile hill.csv --truth truth.csv --json -
"""
COLUMNS = (
    *("time_s", "string", "cell", "horizon_s", "load", "load_A", "core_C", "core_sd_K", "centre_C", "centre_sd_K"),
    *("surface_C", "surface_sd_K", "came_C", "quality"),
)
FINEST_S = 10.0
DAY_S = 86_400.0
"""A truth that begins later than this after its log has another clock."""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("log", nargs="+", type=Path, metavar="LOG", help="logs in the order they were recorded")
    parser.option("--config", required=True, type=Path, help="the gateway's config")
    parser.option(
        "--profile",
        type=Path,
        metavar="TABLE",
        help="what comes after the log: CSV or Parquet with time_s, current_A and perhaps coolant_inlet_C; its first "
        "row is now",
    )
    parser.option("--current", type=float, metavar="A", help="a constant current after the log, discharge positive")
    parser.option(
        "--truth",
        type=Path,
        metavar="CSV",
        help="true cores to score against: of simulate --truth, or a table with core_K_C of a config with one string; "
        "without it later estimates",
    )
    parser.option("--every", type=float, default=30.0, metavar="S", help="score a forecast every so many seconds (30)")
    parser.option("--out", metavar="CSV", help="write every forecast that was scored, and what came")
    parser.option("--json", metavar="FILE", help="write the result as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Run the engine over the logs, score its forecasts, and print the last one."""
    from bms_gateway.bus.logfile import LogNotes
    from bms_gateway.cli.output import distinct, note, say, writable, write_json
    from bms_gateway.config.load import load_config
    from bms_gateway.engine import Engine
    from bms_gateway.records.once import given_once
    from bms_gateway.records.span import Span, expect_estimates
    from bms_gateway.report.forecast_score import Scorer
    from bms_gateway.report.forecast_text import last_lines, row_text, score_lines

    _sound(args)
    outputs = {"--out": args.out, "--json": args.json}
    writable(outputs)
    loaded = load_config(args.config)
    distinct(outputs, [*loaded.files, *args.log, *(p for p in (args.profile, args.truth) if p is not None)])
    given_once(args.log)
    plan, plans = replace(loaded.plan, transmit=False), _profile(args)
    engine, span, notes = Engine(plan, loaded.database), Span(), [LogNotes() for _ in args.log]
    engine.foresee()
    truth = None
    if args.truth is not None:
        truth = _truth(args.truth, {s.name: s.model.cells for s in plan.strings}, span)
    scorer = Scorer(tuple(s.name for s in plan.strings), round(args.every * 1e9), truth)
    rows: list[str] = []
    last = None
    for event, judged in _driven(args, engine, scorer, span, notes):
        last = event or last
        if args.out:
            rows += map(row_text, judged)
    expect_estimates(args.log, args.config, engine, span)
    if last is None or all(f is None for f in last.forecasts):
        raise DataError(f"{args.log[0]}: no forecast: at least ten seconds of which something is known are needed")
    document = _document(engine, last, scorer, None if plans is None else _planned(last, *plans), args)
    if args.out:
        _write(args.out, rows)
    if args.json:
        write_json(args.json, document)
    for log, n in zip(args.log, notes, strict=True):
        if n.broken:
            note(f"{log}: {n.broken} damaged lines skipped, the first at line {n.broken_at[0][0]}")
    for line in (*last_lines(document), *score_lines(document)):
        say(line, args.json)
    return 0


def _driven(
    args: argparse.Namespace, engine: "Engine", scorer: "Scorer", span: "Span", notes: "list[LogNotes]"
) -> "Iterator[tuple[Foreseen | None, list[Row]]]":
    """Run the engine over the logs: yield each forecast, and the rows that can be judged by then."""
    from bms_gateway.cli.logged_frames import logged_frames
    from bms_gateway.engine import Foreseen, drive

    for event in drive(engine, logged_frames(args.log, notes, span)):
        judged = list(scorer.take(event))
        if isinstance(event, Foreseen):
            yield event, judged
    yield None, list(scorer.finish())


def _sound(args: argparse.Namespace) -> None:
    """Refuse meaningless numbers.

    Raises
    ------
    UsageError
    """
    if args.profile is not None and args.current is not None:
        raise UsageError("forecast: --profile and --current both say what comes: give one of them")
    if args.current is not None and not abs(args.current) <= 1e5:
        raise UsageError(f"forecast: --current {args.current:g}: valid: -100000 to 100000 A")
    if not (math.isfinite(args.every) and args.every >= FINEST_S and args.every % FINEST_S == 0.0):
        raise UsageError(f"forecast: --every {args.every:g}: valid: multiples of {FINEST_S:g} s, as 10 or 60")


def _profile(args: argparse.Namespace) -> "tuple[Any, Any, Any] | None":
    """Give currents, squares and inlets (NaN: as now) of the coming ten-second steps; None without a profile."""
    import numpy as np

    from bms_gateway.observe.ahead import ENDS, STEP_S
    from bms_gateway.report.forecast_tables import read_profile

    steps = ENDS[-1]
    if args.current is not None:
        return np.full(steps, args.current), np.full(steps, args.current**2), np.full(steps, np.nan)
    if args.profile is None:
        return None
    time, current, inlet = read_profile(args.profile)
    time = time - time[0]
    edges = np.arange(steps + 1) * STEP_S
    fine = np.unique(np.concatenate((edges, time[(time >= 0.0) & (time <= edges[-1])])))
    at = np.maximum(np.searchsorted(time, fine[:-1], side="right") - 1, 0)  # a row is valid until the next one
    length, of = np.diff(fine), np.minimum((fine[:-1] / STEP_S).astype(int), steps - 1)

    def mean(x: Any) -> Any:
        return np.bincount(of, length * x[at], minlength=steps) / STEP_S

    return mean(current), mean(current**2), mean(inlet)


def _planned(last: "Foreseen", current: Any, square: Any, inlet: Any) -> "dict[int, tuple[Ahead, int]]":
    """Forecast of each string, by its number, under the profile."""
    import numpy as np

    from bms_gateway.observe.forecast_start import Profile

    found = {}
    for origin in last.origins:
        S = len(origin.members)
        held = np.where(np.isnan(inlet)[:, None], origin.standing.inlet, inlet[:, None])
        wide, squares = (np.repeat(x[:, None], S, axis=1) for x in (current, square))
        ahead = origin.outlook.under(origin.standing, origin.coming, Profile(wide, squares, held))
        found.update({i: (ahead, j) for j, i in enumerate(origin.members)})
    return found


def _document(
    engine: "Engine",
    last: "Foreseen",
    scorer: "Scorer",
    planned: "dict[int, tuple[Ahead, int]] | None",
    args: argparse.Namespace,
) -> dict[str, Any]:
    from bms_gateway.report.forecast_text import of_plan, of_string

    strings = {}
    for i, s in enumerate(engine.strings):
        strings[s.plan.name] = of_string(last.forecasts[i], s.quality)
        if planned is not None and i in planned:
            limit = engine.plan.alerts.core_max_C
            strings[s.plan.name]["planned"] = of_plan(*planned[i], limit, last.forecasts[i])
    return {
        "time_s": last.time_ns / 1e9,
        "limit_C": engine.plan.alerts.core_max_C,
        "strings": strings,
        "score": {
            "against": "truth" if args.truth is not None else "later estimates",
            "every_s": args.every,
            "strings": scorer.document(),
        },
    }


def _truth(path: Path, cells: dict[str, int], span: "Span") -> "Truth":
    """Read the true cores; their time is that of the log, or counts from the log's first frame."""
    import numpy as np

    from bms_gateway.report.forecast_tables import read_truth

    found = read_truth(path, tuple(cells), cells)

    def cores(name: str, at_ns: int, n: int) -> "Floats":
        if name not in found:
            return np.full(n, np.nan)
        time, core = found[name]
        first_s, t = span.first_ns * 1e-9, at_ns * 1e-9
        if time[-1] < first_s or time[0] > first_s + DAY_S:
            t -= first_s - time[0]
        if not time[0] <= t <= time[-1]:
            return np.full(n, np.nan)
        return np.array([np.interp(t, time, c) for c in core.T])

    return cores


def _write(name: str, rows: list[str]) -> None:
    from bms_gateway.whole import whole_text

    try:
        with whole_text(Path(name)) as file:
            file.write("\n".join([",".join(COLUMNS), *rows]) + "\n")
    except OSError as e:
        raise UsageError(f"--out {name}: cannot be written: {e.strerror}") from None
