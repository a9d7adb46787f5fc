"""Signals that are missing for a while, and what the watch over heat tells of sound strings and of faults beside it.

`python -m tests.benchmarks.bench_gaps [--seeds N] [--first S] [--json F]`

Strings come from `heat_case`. From minute 60 on, the inlet, the current, the thermocouples or all of them are not
available for 30 s to 10 min; the coolant may warm or cool meanwhile. Of sound strings, every alert until half an hour
after the return is false. A frozen inlet and heat begin at the start of the gap, in its middle and at its end.

Seeds below 1000 were used while settings were chosen.
"""

import argparse
import json
import os
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from tests.benchmarks.bench_heat import RIGHT
from tests.benchmarks.heat_case import Case, Made, make, model, with_seeds

FIRST_SEED = 1000
AFTER_S = 1800
MISSING = {
    "inlet": ("inlet",),
    "current": ("current",),
    "thermocouples": ("y",),
    "inlet and thermocouples": ("inlet", "y"),
    "string": ("inlet", "current", "y"),
    "bus": (),
    "nothing": (),
}
"""Which arrays of `Made` are missing in the gap; without a bus, no tick comes at all."""


@dataclass(frozen=True)
class Gap:
    """A time without some signals: what of `MISSING`, from second `at`, for `lasts` seconds."""

    what: str
    at: int
    lasts: int


def follow(made: list[Made], gap: Gap) -> list[list[tuple[int, str, int | None, int]]]:
    """Watch strings with a gap; by string (s, code, cell, level) of each change."""
    S, case = len(made), made[0].case
    watch = HeatWatch([model(case.pack, case.cells, case.sensors)] * S, 1.0)
    seen = {k: np.stack([getattr(x, k) for x in made]).copy() for k in ("current", "inlet", "y")}
    for k in MISSING[gap.what]:
        seen[k][:, gap.at : gap.at + gap.lasts] = np.nan
    told: list[list[tuple[int, str, int | None, int]]] = [[] for _ in made]
    age = np.zeros((S, case.cells))
    for k in range(case.seconds):
        if gap.what == "bus" and gap.at <= k < gap.at + gap.lasts:
            if k == gap.at:
                watch.pass_time(float(gap.lasts))
            continue
        amps = seen["current"][:, k]
        for s, f in (
            watch.add((k + 1) * 10**9, HeatTick(amps**2, amps, seen["inlet"][:, k], seen["y"][:, k], age)) or ()
        ):
            told[s].append((k + 1, f.code, f.cell, f.level))
    return told


def sound(case: Case, gap: Gap, seeds: range) -> dict[str, object]:
    """Count the strings and alerts of sound strings that are false."""
    case = replace(case, at=gap.at, seconds=gap.at + gap.lasts + AFTER_S)
    told = [[a for a in x if a[3] and a[0] > gap.at] for x in follow(make(with_seeds(case, seeds)), gap)]
    codes = sorted({a[1] for x in told for a in x})
    return {
        "pack": case.pack,
        "drive": case.drive,
        "missing": gap.what,
        "gap_s": gap.lasts,
        "coolant_K": case.ramp,
        "stands": case.stands[1] > 0,
        "strings": len(told),
        "strings_with_false": sum(bool(x) for x in told),
        "in_gap": sum(a[0] <= gap.at + gap.lasts for x in told for a in x),
        "after": sum(a[0] > gap.at + gap.lasts for x in told for a in x),
        "codes": "/".join(f"{c}:{sum(a[1] == c for x in told for a in x)}" for c in codes),
    }


def faulty(case: Case, gap: Gap, seeds: range) -> dict[str, object]:
    """Count the strings whose fault is told, and the minutes from the later of onset and return to the alert."""
    case = replace(case, seconds=max(case.at, gap.at + gap.lasts) + AFTER_S)
    right, others, minutes = 0, 0, []
    for x in follow(make(with_seeds(case, seeds)), gap):
        after = [a for a in x if a[3] and a[0] > min(case.at, gap.at)]
        good = next((a for a in after if a[1] in RIGHT[case.fault]), None)
        right += bool(after) and after[0][1] in RIGHT[case.fault]
        others += any(a[1] not in RIGHT[case.fault] for a in after)
        minutes.append((good[0] - max(case.at, gap.at + gap.lasts)) / 60.0 if good else np.inf)
    return {
        "pack": case.pack,
        "drive": case.drive,
        "missing": gap.what,
        "gap_s": gap.lasts,
        "coolant_K": case.ramp,
        "fault": case.fault,
        "size": case.size,
        "onset_after_gap_start_s": case.at - gap.at,
        "strings": len(minutes),
        "found": sum(np.isfinite(minutes)),
        "median_min": round(float(np.median(minutes)), 1),
        "p90_min": round(float(np.quantile(minutes, 0.9, method="higher")), 1),
        "first_right": right,
        "with_another": others,
    }


AT = 3600
LENGTHS = (30, 120, 600)


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=12)
    ask.add_argument("--first", type=int, default=FIRST_SEED)
    ask.add_argument("--only", nargs="*", default=[], help="kinds of gap")
    ask.add_argument("--part", choices=("sound", "faulty"), help="one of the two tables")
    ask.add_argument("--json")
    args = ask.parse_args()
    seeds, rows = range(args.first, args.first + args.seeds), []
    kinds = [k for k in MISSING if not args.only or k in args.only]
    jobs = []
    if args.part != "faulty":
        jobs += [
            (sound, Case(pack, 0, drive=drive, ramp=ramp), Gap(what, AT, lasts))
            for what in kinds
            for pack in ("small", "forced", "liquid")
            for drive in ("urban", "us06")
            for lasts in LENGTHS
            for ramp in (0.0, 4.0, -4.0)
        ]
        # a string that rests, falls silent, and is driven meanwhile
        jobs += [
            (sound, Case(pack, 0, drive="us06", stands=(AT - 600, AT)), Gap(what, AT, lasts))
            for what in kinds
            for pack in ("small", "forced", "liquid")
            for lasts in LENGTHS
        ]
    if args.part != "sound":
        jobs += [
            (faulty, Case(pack, 0, drive=drive, fault=fault, size=size, ramp=ramp, at=AT + onset), Gap(what, AT, lasts))
            for what in kinds
            for pack in ("small", "liquid")
            for drive, fault, size, ramp in (("urban", "heat", 3.0, 0.0), ("us06", "frozen", 0.0, 4.0))
            for lasts in LENGTHS
            for onset in (0, lasts // 2, lasts)
        ]
    for job in jobs:
        rows.append(job[0](*job[1:], seeds))
        print(" ".join(f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as f:
            json.dump({"rows": rows}, f, indent=1, default=float)


if __name__ == "__main__":
    main()
