"""Every performance benchmark with its peer, and goal by goal what was reached: `python -m tests.benchmarks.all`.

``[--json FILE] [--only PART,PART] [--from FILE]``. The parts run one after the other, each in processes of its own;
what they print goes to standard error, the table to standard output. Figures are medians with least and greatest of
the alternating rounds, as each benchmark says; a ratio is taken round by round. A goal that no benchmark measures
stands there as such. ``--from`` prints the table of figures that ``--json`` wrote, and runs nothing.

Absolute times belong to this machine and to whatever else it does meanwhile: the load is printed with them.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
Figures = Mapping[str, Any]


@dataclass(frozen=True)
class Goal:
    """One line of the table.

    Attributes
    ----------
    part : str
        Of `PARTS`; empty where nothing measures it, and `why` says so.
    most, least : float, optional
        What the median may be at most, or must be at least.
    figures : callable
        From what the part wrote to the figures of its rounds.
    """

    what: str
    unit: str
    part: str = ""
    figures: Callable[[Figures], Sequence[float]] = lambda _found: ()
    most: float | None = None
    least: float | None = None
    why: str = ""


PARTS: dict[str, tuple[str, ...]] = {
    "live": ("bench_live", "--json"),
    "latency": ("bench_latency", "--seconds", "30", "--json"),
    "files": ("bench_files", "--json"),
    "canplayer": ("bench_canplayer", "--json"),
    "fleet": ("bench_fleet", "--json"),
    "memory": ("bench_files", "--memory", "--json"),
    "ticks": ("bench_ticks", "--json"),
    "diagnosis": ("bench_diagnosis_time", "--json"),
    "placement": ("bench_placement", "--json"),
    "start": ("bench_start", "--json"),
    "workbench": ("bench_workbench",),
}
LAST_LINE = ("ticks", "placement", "workbench")
"""Parts that print their figures as the last line."""
DECODING, WHOLE, PEER, CROWDED = "port + table decode", "whole gateway, crowded", "python-can + cantools", "crowded"


def live(of: str, column: int) -> Callable[[Figures], list[float]]:
    """One column of our rounds: CPU time per frame, share of a core."""
    return lambda found: [r[column] for r in found["rounds"][of]]


def latency(of: str) -> Callable[[Figures], list[float]]:
    """Median, 99th of a hundred and greatest: the goal is held against the one in the middle."""

    def figures(found: Figures) -> list[float]:
        first = sorted(found[of]["first_ms"])
        return [statistics.median(first), first[min(len(first) - 1, int(0.99 * len(first)))], first[-1]]

    return figures


def added(found: Figures) -> list[float]:
    """The most that fits of windows add to the usual latency."""
    return [max(found["fitting"]["first_ms"]) - statistics.median(found["quiet"]["first_ms"])]


def frames_per_second(found: Figures) -> list[float]:
    """Frames of a full bus's log per second, from text to the text of our frames."""
    log = found[CROWDED]
    return [log["frames"] / s for s in log["seconds"]["analyze"]]


def over_peer(found: Figures) -> list[float]:
    """How many times the peer's reading and decoding takes what our whole analysis does."""
    seconds = found[CROWDED]["seconds"]
    return [p / s for p, s in zip(seconds[PEER], seconds["analyze"], strict=True)]


def tick(cells: int, of: str = "estimators") -> Callable[[Figures], list[float]]:
    """Least, median and greatest of a tick's time: the whole tick, or the observers alone."""
    return lambda found: [found[str(cells)][of][k] for k in ("min_us", "median_us", "max_us")]


def growth(found: Figures) -> list[float]:
    """Exponent of the whole tick's time from 1,000 to 10,000 cells."""
    return [math.log10(found["10000"]["estimators"]["median_us"] / found["1000"]["estimators"]["median_us"])]


def slowest_diagnosis(found: Figures) -> list[float]:
    """The log that takes longest."""
    return max((f["cpu_s"] for f in found.values()), key=statistics.median)


GOALS = (
    Goal("8,500 frames/s received, decoded: CPU per frame", "µs", "live", live(DECODING, 0), most=3.0),
    Goal("… of a core", "%", "live", live(DECODING, 1), most=3.0),
    Goal("… Notifier + cantools over it", "x", "live", lambda f: f["ratios"][DECODING], least=7.0),
    Goal("whole gateway, 60 cells, full bus: CPU per frame", "µs", "live", live(WHOLE, 0), most=3.0),
    Goal("… of a core", "%", "live", live(WHOLE, 1), most=3.0),
    Goal("… Notifier + cantools over it", "x", "live", lambda f: f["ratios"][WHOLE], least=7.0),
    Goal("our first frame after the deadline: p99 (p50 … max)", "ms", "latency", latency("quiet"), most=10.0),
    Goal("… while windows are fitted", "ms", "latency", latency("fitting"), most=10.0),
    Goal("… the most that fits add", "ms", "latency", added, most=10.0),
    Goal("candump file with estimates, full bus", "frames/s", "files", frames_per_second, least=1e6),
    Goal("python-can + cantools, no estimates, over it", "x", "files", over_peer, least=8.0),
    Goal("canplayer -t over analyze, wall", "x", "canplayer", lambda f: f["ratios"]["wall_s"], least=1.0),
    Goal(
        "fleet: one worker over two, wall", "x", "fleet", lambda f: list(f["one_worker_over_two"].values()), least=1.7
    ),
    *(
        Goal(f"{'whole tick' if of == 'estimators' else of}, {n:,} cells", "µs", "ticks", tick(n, of), most=most)
        for of in ("estimators", "observers")
        for n, most in ((60, 60.0), (1_000, 120.0), (10_000, 800.0))
    ),
    Goal("whole tick: growth from 1,000 to 10,000 cells", "exponent", "ticks", growth, most=1.0),
    Goal("diagnosis, 12 cells x 1 h, slowest of three", "s CPU", "diagnosis", slowest_diagnosis, most=3.0),
    Goal("placement of 4 on 12, all 495", "s CPU", "placement", lambda f: [f["exhaustive_s"]["ours"]], most=0.6),
    Goal("start to READY", "s CPU", "start", lambda f: f["rounds"]["until READY"]["cpu_s"], most=0.3),
    Goal("start to READY over import numpy", "x", "start", lambda f: f["ratio"], most=3.0),
    Goal("live: resident memory", "MiB", "start", lambda f: [f["live_mib"]], most=80.0),
    Goal("analyze 10 h: peak memory", "MiB", "memory", lambda f: [f["10h"]["peak_mib"]], most=120.0),
    Goal("… over that of 1 h", "x", "memory", lambda f: [f["10h"]["peak_mib"] / f["1h"]["peak_mib"]], most=1.1),
    Goal("workbench: first picture, 12 cells x 1 h", "s", "workbench", lambda f: f["first_picture_s"], most=0.5),
    Goal("workbench: zoom to a minute, 60 cells x 10 h", "s", "workbench", lambda f: f["long_zoom_s"], most=0.3),
    Goal("workbench: rows of that minute seen", "rows", "workbench", lambda f: f["long_zoom_rows"], least=60.0),
    Goal("workbench live, 60 cells: of a core", "%", "workbench", lambda f: [f["live"]["with_page_pct"]], most=5.0),
    Goal("workbench live: pictures a second", "1/s", "workbench", lambda f: [f["live"]["pictures_per_s"]], least=2.0),
)


def measured(part: str) -> Figures | None:
    """Run a part; None where it failed, which it has said itself."""
    module, *options = PARTS[part]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figures.json"
        words = [sys.executable, "-m", f"tests.benchmarks.{module}", *options]
        if part not in LAST_LINE:
            words.append(str(file))
        print(f"\n== {part}: {' '.join(words[2:])}", file=sys.stderr, flush=True)
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, env=environment) as process:
            assert process.stdout is not None
            last = ""
            for line in process.stdout:
                sys.stderr.write(line)
                last = line.strip() or last
        if process.returncode:
            return None
        found: Figures = json.loads(last if part in LAST_LINE else file.read_text())
        return found


def line(goal: Goal, found: Mapping[str, Figures | None]) -> dict[str, Any]:
    """Judge a goal by its median."""
    told: dict[str, Any] = {"goal": goal.what, "unit": goal.unit, "most": goal.most, "least": goal.least}
    if not goal.part or found.get(goal.part) is None:
        why = goal.why or ("its benchmark failed" if goal.part in found else "not run this time")
        return {**told, "verdict": "not measured", "why": why}
    try:
        figures = sorted(goal.figures(found[goal.part] or {}))
    except KeyError as e:
        return {**told, "verdict": "not measured", "why": f"no figure {e} here"}
    middle = statistics.median(figures)
    reached = middle <= goal.most if goal.most is not None else middle >= (goal.least or 0.0)
    return {
        **told,
        "median": middle,
        "min": figures[0],
        "max": figures[-1],
        "rounds": len(figures),
        "verdict": "reached" if reached else "not reached",
    }


def number(x: float) -> str:
    """Three digits are enough."""
    return f"{x:,.0f}" if abs(x) >= 100 else f"{x:.3g}"


def show(lines: Sequence[Mapping[str, Any]]) -> None:
    """Print the table."""
    print(f"{'goal':51}{'limit':>20}{'median (min … max)':>36}   verdict")
    for x in lines:
        limit = f"≤ {number(x['most'])}" if x["most"] is not None else f"≥ {number(x['least'])}"
        if "median" in x:
            spread = f" ({number(x['min'])} … {number(x['max'])})" if x["max"] != x["min"] else ""
            figure, why = number(x["median"]) + spread, ""
        else:
            figure, why = "–", f": {x['why']}"
        print(f"{x['goal']:51}{limit + ' ' + x['unit']:>20}{figure:>36}   {x['verdict']}{why}")
    counts = [sum(x["verdict"] == v for x in lines) for v in ("reached", "not reached", "not measured")]
    print(f"{counts[0]} reached, {counts[1]} not reached, {counts[2]} not measured")


def main() -> int:
    """Run, print and write; 1 where a benchmark failed, whatever it found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, metavar="FILE", help="write figures and table there")
    parser.add_argument("--only", default=",".join(PARTS), metavar="PARTS", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--from", dest="given", type=Path, metavar="FILE", help="figures written before: run nothing")
    args = parser.parse_args()
    chosen = args.only.split(",")
    if unknown := [p for p in chosen if p not in PARTS]:
        parser.error(f"no such part: {', '.join(unknown)}; valid: {', '.join(PARTS)}")
    found: dict[str, Figures | None]
    if args.given:
        found = json.loads(args.given.read_text())["figures"]
        load = None
    else:
        load = os.getloadavg()[0]
        found = {part: measured(part) for part in PARTS if part in chosen}
        print(f"load of {len(os.sched_getaffinity(0))} processors before: {load:.1f}, after: {os.getloadavg()[0]:.1f}")
    lines = [line(goal, found) for goal in GOALS]
    show(lines)
    if args.json:
        args.json.write_text(json.dumps({"load_before": load, "goals": lines, "figures": found}, indent=1) + "\n")
    return 1 if None in found.values() else 0


if __name__ == "__main__":
    sys.exit(main())
