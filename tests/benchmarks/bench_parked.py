"""A parked string: minutes to the alert of a short when frames are rare, and false alarms of parked strings.

`python -m tests.benchmarks.bench_parked [--seeds N] [--first S] [--life HOURS] [--json F]`

Temperatures: strings of `heat_case` at rest, of which the watch hears `burst` seconds of frames every `every` seconds.
The bus sleeps after a minute without frames, as the engine lets it. `least_min` is the time from the onset to the
second step of ten seconds with a reading, before which nothing is told.

Seeds below 8000 were used while settings were chosen.
"""

import argparse
import json
import os
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from tests.benchmarks.heat_case import CELLS, SENSORS, Case, Made, make, model, with_seeds

FIRST_SEED = 8000
SILENT_S = 60
RHYTHMS = ((1, 1), (5, 1), (30, 1), (60, 1), (300, 1), (300, 20), (3600, 1), (3600, 20))
"""Frames for so many seconds (second) every so many seconds (first)."""


def follow(
    made: list[Made], every: int, burst: int, *, restarts: bool = False
) -> list[list[tuple[int, str, int | None]]]:
    """Watch parked strings that speak rarely; by string (s, code, cell) of each alert.

    With `restarts` the computer is off while the bus sleeps, and goes on from what was stored.
    """
    S, case = len(made), made[0].case
    new = lambda: HeatWatch([model(case.pack)] * S, 1.0)  # noqa: E731
    watch, told = new(), [[] for _ in made]
    current, inlet, y = (np.stack([getattr(x, k) for x in made]) for k in ("current", "inlet", "y"))
    silence, never, none = np.full(S, np.nan), np.full((S, CELLS), np.nan), np.zeros((S, CELLS))
    heard = 0
    for k in range(case.seconds):
        speaks = k % every < burst
        if k - heard >= SILENT_S and not speaks:
            continue
        if k - heard > SILENT_S:
            gap = float(k - heard - SILENT_S)
            if restarts:
                state = json.loads(json.dumps(watch.snapshot()))
                watch = new()
                watch.restore(state)
            watch.pass_time(gap, unseen=restarts)
        if speaks:
            heard = k
            tick = current[:, k] ** 2, current[:, k], inlet[:, k], y[:, k], none
        else:
            tick = silence, silence, silence, never, none
        for s, f in watch.add((k + 1) * 10**9, HeatTick(*tick)) or ():
            if f.level:
                told[s].append((k + 1, f.code, f.cell))
    return told


def least_s(case: Case, every: int, burst: int) -> float:
    """Seconds from the onset to the end of the second step of ten seconds that has readings."""
    heard = [k for k in range(case.seconds) if k >= case.at and k % every < burst]
    steps = sorted({k // 10 for k in heard})
    return 10.0 * (steps[1] + 1) - case.at if len(steps) > 1 else np.inf


def score(case: Case, seeds: range, every: int, burst: int, *, restarts: bool = False) -> dict[str, object]:
    """Figures of one row; the onset falls anywhere between two frames."""
    first, early, place, least = [], 0, 0, []
    near = {k + d for k in SENSORS if abs(k - case.cell) <= 1 for d in (-1, 0, 1)}
    at = case.at + int(np.random.default_rng(seeds.start).integers(0, max(every, 10)))
    for told in follow(make(with_seeds(replace(case, at=at), seeds)), every, burst, restarts=restarts):
        early += any(t <= at for t, _, _ in told)
        good = next((a for a in told if a[0] > at and a[1] == "unexplained_heat"), None)
        first.append((good[0] - at) / 60.0 if good else np.inf)
        place += bool(good) and good[2] in near
    least = least_s(replace(case, at=at), every, burst) / 60.0
    return {
        "pack": case.pack,
        "cell": case.cell,
        "W": case.size,
        "every_s": every,
        "burst_s": burst,
        "restarts": restarts,
        "strings": len(first),
        "found": int(np.isfinite(first).sum()),
        "median_min": round(float(np.median(first)), 1),
        "p90_min": round(float(np.quantile(first, 0.9, method="higher")), 1),
        "least_min": round(least, 1),
        "group_right": place,
        "before": early,
    }


def life(hours: float, first: int) -> dict[str, object]:
    """False alarms of parked strings with nothing wrong, by code."""
    counts: dict[str, int] = {}
    seen, seed, seconds, batch = 0.0, first, 8 * 3600, 24
    kinds = [(p, r, step) for r in RHYTHMS[2:] for p in ("small", "liquid") for step in (0.1, 0.5)]
    while seen < hours:
        pack, (every, burst), step = kinds[(seed // batch) % len(kinds)]
        case = Case(pack, 0, seconds, "rest", at=seconds, step=step)
        for told in follow(
            make(with_seeds(case, range(seed, seed + batch))), every, burst, restarts=(seed // batch) % 5 < 2
        ):
            for _, code, _ in told:
                counts[code] = counts.get(code, 0) + 1
        seen, seed = seen + batch * seconds / 3600.0, seed + batch
        print(f"{seen:6.0f} h of parked strings ({pack}, {step:g} K, {burst} of {every} s): {counts}", flush=True)
    return {"hours": seen, "false": counts}


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=12)
    ask.add_argument("--first", type=int, default=FIRST_SEED)
    ask.add_argument("--life", type=float, default=0.0, help="hours of parked strings with nothing wrong")
    ask.add_argument("--only-life", action="store_true")
    ask.add_argument("--json")
    args = ask.parse_args()
    rows, seeds = [], range(args.first, args.first + args.seeds)
    for pack, sizes in (("small", (0.3, 1.0, 3.0)), ("liquid", (3.0, 10.0))):
        for every, burst in () if args.only_life else RHYTHMS:
            for W in sizes:
                seconds = 5400 + max(1800, 3 * every)
                case = Case(pack, 0, seconds, "rest", "heat", 6, W, at=5400 - 1800 if every < 3600 else 5400)
                rows.append(score(case, seeds, every, burst))
                print(" ".join(f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    found = life(args.life, args.first) if args.life else None
    if args.json:
        with open(args.json, "w", encoding="utf-8") as f:
            json.dump({"rows": rows, "life": found}, f, indent=1, default=float)


if __name__ == "__main__":
    main()
