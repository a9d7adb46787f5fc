"""Heat that no current makes, and what looks like it: minutes to the alert, causes, cores.

`python -m tests.benchmarks.bench_heat [--seeds N] [--first S] [--layout NAME] [--volts] [--json F]`

Strings come from `heat_case`, whose truth is no code of the package. Seeds below 1000 were used while settings were
chosen; the figures are of seeds from there on. An alert that comes before the fault counts as false;
hours of strings without one: `heat_life`.
"""

import argparse
import json
import os
from dataclasses import dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.health.heat import HeatWatch
from bms_gateway.health.heat.heat_tick import HeatTick
from bms_gateway.identify.voltage import VoltageTracker
from tests.benchmarks.heat_case import AMPS, LAYOUTS, PACKS, Case, Made, make, model, with_seeds
from tests.truth.pack import CAPACITY_AH

FIRST_SEED = 1000
RIGHT = {
    "heat": ("unexplained_heat",),
    "fan": ("cooling",),
    "pump": ("cooling",),
    "frozen": ("inlet",),
    "off": ("thermocouple",),
    "loose": ("thermocouple",),
    "drift": ("thermocouple",),
    "held": ("thermocouple",),
    "jump": ("thermocouple",),
    "scale": ("missing_heat",),
    "stuck": ("missing_heat",),
}


@dataclass(frozen=True)
class Told:
    """What was told of one string: (s, code, cell) as raised, and the cores' band from five minutes after the fault."""

    alerts: list[tuple[int, str, int | None]]
    sick: float
    healthy: float


def follow(made: list[Made]) -> list[Told]:
    """Watch strings of one pack and length, tick by tick."""
    S, case = len(made), made[0].case
    watch = HeatWatch([model(case.pack, case.cells, case.sensors)] * S, 1.0)
    I, inlet, y = (np.stack([getattr(x, k) for x in made]) for k in ("current", "inlet", "y"))  # noqa: E741
    alerts: list[list[tuple[int, str, int | None]]] = [[] for _ in made]
    inside = np.zeros((S, case.cells))
    count, age = np.zeros(S), np.zeros((S, case.cells))
    nothing = np.full((S, case.cells), np.nan)
    heat = by_voltage(made)
    for k in range(case.seconds):
        tick = HeatTick(I[:, k] ** 2, I[:, k], inlet[:, k], y[:, k], age, None, None if heat is None else heat[:, k])
        for s, f in watch.add((k + 1) * 10**9, tick) or ():
            if f.level:
                alerts[s].append((k + 1, f.code, f.cell))
        if k >= case.at + 300 and k % 30 == 0:
            core, sd = watch.cores(nothing, np.zeros((S, case.cells)))
            truth = np.stack([x.core[k] for x in made])
            known = np.isfinite(core)
            inside += np.where(known, np.abs(core - truth) <= 2 * sd, 0.0)
            count += known[:, 0]
    share = inside / np.maximum(count, 1)[:, None]
    others = np.arange(case.cells) != case.cell - 1
    unheard = np.full(S, np.nan)
    sick, healthy = share[:, case.cell - 1], share[:, others].mean(axis=1) if others.any() else unheard
    judged = np.where(count > 0, [sick, healthy], np.nan).T.tolist()
    return [Told(a, *x) for a, x in zip(alerts, judged, strict=True)]


def by_voltage(made: list[Made]) -> np.ndarray | None:
    """Heat of a mean cell (S, K), W, as the gateway takes it from the voltage; None where there is none on the bus."""
    if not made[0].case.volts:
        return None
    out = np.full((len(made), made[0].case.seconds), np.nan)
    for s, x in enumerate(made):
        tracker = VoltageTracker(CAPACITY_AH * AMPS[x.case.pack])
        for k, (I, V) in enumerate(zip(x.current.tolist(), x.voltage.tolist(), strict=True)):  # noqa: E741
            out[s, k] = tracker.update(I, V, I * V, 1.0).heat
    return out


def score(cases: list[Case]) -> dict[str, object]:
    """Figures of strings alike but for their seed."""
    told, c = follow(make(cases)), cases[0]
    first, right, heat, place, early = [], 0, 0, 0, 0
    near = {k + d for k in c.sensors if abs(k - c.cell) <= 1 for d in (-1, 0, 1)}
    for x in told:
        early += any(t <= c.at for t, _, _ in x.alerts)
        after = [a for a in x.alerts if a[0] > c.at]
        good = next((a for a in after if a[1] in RIGHT[c.fault]), None)
        right += bool(after) and after[0][1] in RIGHT[c.fault]
        heat += any(a[1] == "unexplained_heat" for a in after)
        first.append((good[0] - c.at) / 60.0 if good else np.inf)
        if good and c.fault == "heat":
            place += good[2] in near
    n = len(told)
    out: dict[str, object] = {
        "pack": c.pack,
        "drive": c.drive,
        "fault": c.fault,
        "cell": c.cell,
        "size": c.size,
        "strings": n,
        "found": sum(np.isfinite(first)),
        "median_min": round(float(np.median(first)), 1),
        "p90_min": round(float(np.quantile(first, 0.9, method="higher")), 1),
        "first_right": right,
        "called_heat": heat,
        "before": early,
    }
    if c.fault == "heat":
        out["group_right"] = place
        out["sick_inside"] = round(float(np.nanmean([x.sick for x in told])), 3)
        if c.cells > 1:
            out["healthy_inside"] = round(float(np.nanmean([x.healthy for x in told])), 3)
    return out


def few(layout: str) -> list[Case]:
    """One case of each row of a string with fewer than three thermocouples."""
    cells, sensors, cell = LAYOUTS[layout]
    at = {"cells": cells, "sensors": sensors, "cell": cell}
    rows = []
    for pack, watts in (("small", (1.0, 3.0, 10.0)), ("liquid", (10.0, 30.0, 100.0))):
        rows += [Case(pack, 0, drive=d, fault="heat", size=w, **at) for d in ("urban", "rest") for w in watts]
        rows += [Case(pack, 0, drive="us06", fault=f, **at) for f in ("fan", "pump", "frozen", "off")]
        rows.append(Case(pack, 0, drive="us06", fault="loose", size=0.3, **at))
        rows += [Case(pack, 0, drive="us06", fault="jump", size=w, **at) for w in (1.5, -1.5)]
        rows.append(Case(pack, 0, drive="us06", fault="stuck", **at))
    return rows


def table() -> list[Case]:
    """One case of each row."""
    rows = []
    for pack, sensed, beside in (("small", (0.3, 1.0, 3.0), (1.0, 3.0, 10.0)), ("liquid", (1.0, 3.0, 10.0), (10.0,))):
        for drive in ("urban", "rest"):
            rows += [Case(pack, 0, drive=drive, fault="heat", cell=6, size=w) for w in sensed]
            rows += [Case(pack, 0, drive=drive, fault="heat", cell=7, size=w) for w in beside]
        rows += [Case(pack, 0, drive="us06", fault=f) for f in ("fan", "pump", "frozen", "off", "held")]
        rows += [
            Case(pack, 0, drive="us06", fault="loose", size=0.3),
            Case(pack, 0, 7200, drive="us06", fault="drift", size=1.0),
        ]
        rows += [
            Case(pack, 0, drive="us06", fault="jump", size=1.0),
            Case(pack, 0, drive="us06", fault="jump", size=-2.0, step=0.5),
        ]
        rows += [Case(pack, 0, drive="us06", fault="scale", size=w) for w in (0.0, 0.3)]
        rows.append(Case(pack, 0, drive="us06", fault="stuck", size=0.0))
    rows += [Case(p, 0, 9000, drive=d, fault="fan", size=1.8) for p in PACKS for d in ("urban", "us06", "udds")]
    return rows


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=20)
    ask.add_argument("--first", type=int, default=FIRST_SEED)
    ask.add_argument("--only", nargs="*", default=[], help="faults")
    ask.add_argument("--layout", choices=LAYOUTS, default="three sensors", help="which cells have a thermocouple")
    ask.add_argument("--volts", action="store_true", help="the voltage is on the bus")
    ask.add_argument("--json")
    args = ask.parse_args()
    rows = []
    for c in table() if args.layout == "three sensors" else few(args.layout):
        if args.only and c.fault not in args.only:
            continue
        c = replace(c, volts=args.volts)
        rows.append(score(with_seeds(c, range(args.first, args.first + args.seeds))))
        print(" ".join(f"{k}={v}" for k, v in rows[-1].items()), flush=True)
    if args.json:
        with open(args.json, "w", encoding="utf-8") as f:
            json.dump({"rows": rows}, f, indent=1, default=float)


if __name__ == "__main__":
    main()
