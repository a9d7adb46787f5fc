"""Ageing found in time, and nothing found where nothing is: whole lives of strings, and faults that look like ageing.

``python -m tests.benchmarks.bench_health [--seeds 20] [--first 0] [--drives 400] [--json F] [--only NAME]
[--offsets 0 0.5] [--fault WORDS]``

One drive is a window of twenty minutes. The truth is the independent integrator of `tests/truth/pack.py`; windows go
straight to `health.StringHealth`, without frames and without the observer, which is what makes 400 drives affordable:
some twenty seconds a life. A life has a year's weather (0 to 40 °C) with R_e falling with temperature by an
exponent that is not told (1500, 2500 or 3500 K by seed), charge from 10 to 95 % with R_e depending on it, four cycles
of varying strength, coolant flow 0.6 to 1.2 of nominal with R_u following it, a start up to 8 K warmer than the
coolant, cells that differ by 2 %, C_c 4 % and R_c 5 % off what the model says, readings with 0.05 to 0.1 K of noise in
steps of 0.1 K and up to a second old, 0.3 A of noise on the current. Ticks have four seconds: the work is a quarter.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from functools import lru_cache

import numpy as np

from bms_gateway.health import StringHealth
from bms_gateway.thermal import Prior, StringModel
from tests.benchmarks.health_life import CELLS, SENSORS, Life, heard_of
from tests.truth.pack import NOMINAL

GROWTH = 0.30
EXPONENTS = (1500.0, 2500.0, 3500.0)
IN_TIME = 25  # drives
BLOCK = 50
ELECTRICAL = 0.8  # of the resistance that heats: the share that answers within a second
DAY_NS = 86_400_000_000_000
SD = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.3, "R_c": 0.05, "R_u": 0.2, "R_cc": 0.2, "C_f": 0.05}
FAULTS = {
    "cooling R_u +50 %": ("cooling", 0.5),
    "thermocouple drifts to +3 K": ("thermocouple", 3.0),
    "thermocouple drifts to -3 K": ("thermocouple", -3.0),
    "inlet's sensor 0.2 K high": ("inlet", 0.2),
    "inlet's sensor 0.5 K high": ("inlet", 0.5),
    "inlet's sensor 2 K high": ("inlet", 2.0),
    "thermocouple loose, 30 % of the coolant": ("loose", -0.3),
    "current clipped at 70 A": ("clipped", 70.0),
    "current stuck at 40 A": ("stuck", 40.0),
    "current reads 7 % low, no voltage": ("gain", -0.07),
    "current reads 7 % low, voltage heard": ("gain", -0.07),
    "R_e jumps by 30 %, no voltage": ("joint", 0.30),
    "R_e jumps by 30 %, voltage heard": ("joint", 0.30),
}


def model() -> StringModel:
    return StringModel(CELLS, SENSORS, "full", {k: Prior(NOMINAL[k], SD[k]) for k in SD}, "ntu", capacity_Ah=8.0)


@lru_cache(maxsize=2)
def _whole(life: Life, drives: int) -> list:
    return [d for k in range(0, drives, BLOCK) for d in heard_of(life, k, min(k + BLOCK, drives))]


def lived(
    life: Life, drives: int, *, inlet_offset: float = 0.0, voltage: bool = False
) -> tuple[StringHealth, list, np.ndarray]:
    """Health at the end, flags as they moved (drive, change), growth after each drive."""
    health, told, growth = StringHealth(model(), known=True), [], []
    rng = np.random.default_rng([life.seed, 8])
    for k, (w, current, heats) in enumerate(_whole(life, drives)):
        w = replace(w, inlet=w.inlet + inlet_offset)  # a whole number of the sensor's steps
        electrical = float("nan")
        if voltage:
            electrical = _electrical(life, k, heats) * float(np.exp(rng.normal(0.0, 0.02)))
        job = health.job(w, current, electrical)
        told += [(k, change) for change in health.accept(job.run(), k * DAY_NS)]
        growth.append(health.ageing.growth)
    return health, told, np.array(growth)


def _electrical(life: Life, k: int, heats: float) -> float:
    """Resistance as the voltage shows it: 80 % of the one that heats, over the current's gain."""
    name, since, size = life.fault
    return ELECTRICAL * heats / (1.0 + size if name == "gain" and k >= since else 1.0)


def first_at(told: list, code: str, level: int) -> int | None:
    """Drive after which a flag first stood at a level."""
    return next((k for k, c in told if c.code == code and c.cell is None and c.level >= level), None)


def aged(seed: int, drives: int, inlet_offset: float) -> dict:
    """One life with growth and the same without."""
    life = Life(seed, 0.0, EXPONENTS[seed % 3])
    _, told, still = lived(life, drives, inlet_offset=inlet_offset)
    health, grown, growth = lived(replace(life, growth=GROWTH / 400), drives, inlet_offset=inlet_offset)
    late = {}
    for level, at in ((1, 0.10), (2, 0.20)):
        found = first_at(grown, "ageing", level)
        late[level] = None if found is None else round(found - at * 400 / GROWTH, 1)
    true = GROWTH / 400 * np.arange(drives)
    return {
        "seed": seed,
        "late_10": late[1],
        "late_20": late[2],
        "false": sorted({f"{c.code} {c.level} at {k}" for k, c in told if c.level}),
        "others": sorted({f"{c.code} {c.level} at {k}" for k, c in grown if c.level and c.code != "ageing"}),
        "error_pct": round(100 * float(np.abs(growth - true)[40:].max()), 2),
        "still_pct": round(100 * float(np.abs(still)[40:].max()), 2),
        "B_K": round(1000 * float(health.trend.x[4]), 0),
    }


def ageing(seeds: range, drives: int, offsets: list[float]) -> dict:
    """Lives with and without growth, the inlet's sensor as it should be and off; the truth is made once for both."""
    rows: dict[float, list[dict]] = {offset: [] for offset in offsets}
    for seed in seeds:
        for offset in offsets:
            rows[offset].append(aged(seed, drives, offset))
            print(offset, rows[offset][-1], file=sys.stderr, flush=True)
    return {f"inlet's sensor {offset:+g} K": _counted(found) for offset, found in rows.items()}


def _counted(rows: list[dict]) -> dict:
    late = {at: [r[f"late_{at}"] for r in rows] for at in (10, 20)}
    return {
        "lives": len(rows),
        "in_time_10": sum(x is not None and abs(x) <= IN_TIME for x in late[10]),
        "in_time_20": sum(x is not None and abs(x) <= IN_TIME for x in late[20]),
        "false_alarm_lives": sum(bool(r["false"]) for r in rows),
        "other_flag_lives": sum(bool(r["others"]) for r in rows),
        "late_10": sorted(late[10], key=lambda x: np.inf if x is None else x),
        "late_20": sorted(late[20], key=lambda x: np.inf if x is None else x),
        "error_pct": {
            "median": float(np.median([r["error_pct"] for r in rows])),
            "worst": max(r["error_pct"] for r in rows),
        },
        "still_pct": {
            "median": float(np.median([r["still_pct"] for r in rows])),
            "worst": max(r["still_pct"] for r in rows),
        },
        "rows": rows,
    }


def faults(seeds: range, named: str) -> list[dict]:
    """Each fault with these words from drive 100 on: what was flagged by drive 200."""
    rows = []
    for name, (kind, size) in FAULTS.items():
        for seed in seeds if named in name else ():
            life = Life(seed, 0.0, EXPONENTS[seed % 3], fault=(kind, 100, size))
            health, told, _ = lived(life, 200, voltage="voltage heard" in name)
            raised = sorted({f"{c.code} {c.level}" for _, c in told if c.level})
            after = {c.code: k - 100 for k, c in reversed(told) if c.level}
            rows.append({"fault": name, "seed": seed, "raised": raised, "drives_after": after,
                         "growth_pct": round(100 * health.ageing.growth, 1)})  # fmt: skip
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--drives", type=int, default=400)
    parser.add_argument("--offsets", type=float, nargs="+", default=[0.0, 0.5], help="K, of the inlet's sensor")
    parser.add_argument("--only", choices=("ageing", "faults"))
    parser.add_argument("--fault", default="", help="only faults with these words")
    parser.add_argument("--json")
    args = parser.parse_args()
    seeds, began, out = range(args.first, args.first + args.seeds), time.perf_counter(), {}
    if args.only in (None, "ageing"):
        out["ageing"] = ageing(seeds, args.drives, args.offsets)
    if args.only in (None, "faults"):
        out["faults"] = faults(seeds[:3], args.fault)
    out["seconds"] = round(time.perf_counter() - began, 1)
    text = json.dumps(out, indent=1, ensure_ascii=False)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as f:
            f.write(text)
    for name, found in out.get("ageing", {}).items():
        print(name, {k: v for k, v in found.items() if k != "rows"})
    for row in out.get("faults", []):
        print(row)
    print(f"{out['seconds']} s")


if __name__ == "__main__":
    main()
