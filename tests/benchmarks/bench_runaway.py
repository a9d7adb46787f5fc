"""Thermal runaway told, and faults of sensors not called one.

``python -m tests.benchmarks.bench_runaway [--seeds 100] [--json F]``

Recorded: seconds from the rule of GB 38031-2025, C.5.3.7 (four rises of a second in a row of 1 K and more, above 60 °C)
to the alarm, as recorded and with noise and steps of real inputs. Simulated: heat that grows with its temperature, in a
string whose cells warm each other. Faults: every kind of `runaway_faults`, in cool, warm and hot cells, alone and with
the other thermocouples of a string, on so many seeds.
"""

import argparse
import gzip
import json
import sys
from pathlib import Path

import numpy as np

from bms_gateway.health.runaway import Runaway
from tests.benchmarks.runaway_faults import ALONE, CONTEXTS, MATES, WITH_MATES, read
from tests.data import data_dir

RECORDS = ("ustc_tr_fig7b.csv.gz", "ustc_tr_fig7e.csv.gz")
VARIANTS = {
    "as recorded": (0.0, 0.0),
    "noise 0.05 K": (0.05, 0.0),
    "noise 0.1 K": (0.1, 0.0),
    "steps 0.5 K": (0.0, 0.5),
}


def called(surfaces):
    """When and of which cells a runaway is told; (n, m) readings, one a second."""
    n = surfaces.shape[1]
    detector, nothing, told = Runaway(["s"], [slice(0, n)]), np.full(n, np.nan), []
    for second, y in enumerate(surfaces):
        missing = np.isnan(y)
        found = detector.step(y, np.where(missing, np.nan, float(second)), missing, nothing)
        told += [(second, k) for k in found]
    return told


def rule(x):
    """First second at which the standard's rule holds."""
    fast = np.diff(x) >= 1.0
    return next(i for i in range(4, len(x)) if fast[i - 4 : i].all() and x[i] > 60.0)


def recorded(name):
    """Temperature of a record, one a second."""
    with gzip.open(data_dir() / "abuse" / name, "rt") as f:
        return np.genfromtxt(f, delimiter=",", names=True)["surface_1_C"]


def delays(seeds):
    """Seconds after the rule, by record and variant; None where nothing is told."""
    found = {}
    for name in RECORDS:
        x = recorded(name)
        for variant, (noise, step) in VARIANTS.items():
            for seed in range(seeds if noise else 1):
                y = x + noise * np.random.default_rng(seed).standard_normal(len(x))
                y = np.round(y / step) * step if step else y
                told = called(y[:, None])
                found.setdefault((name, variant), []).append(told[0][0] - rule(x) if told else None)
    return found


def propagation(seed):
    """Readings (n, m) of a row of cells, the first of which is heated until it runs away; seconds of the rule by cell.

    A cell's own heat doubles every 7 to 10 K and is used up; cells conduct to each other and lose heat to the air.
    """
    rng = np.random.default_rng([seed, 77])
    C, G, h = rng.uniform(40, 60), rng.uniform(0.02, 0.2), rng.uniform(0.02, 0.08)
    fuel0 = rng.uniform(250, 500) * C
    T, fuel, dt, heater = np.full(MATES, 25.0), np.full(MATES, fuel0), 0.2, rng.uniform(5, 15)
    doubling, rows = rng.uniform(7, 10), []
    for step in range(int(2400 / dt)):
        power = fuel / fuel0 * 0.05 * C * 2.0 ** ((np.minimum(T, 260.0) - 130.0) / doubling)
        power = np.minimum(np.minimum(power, fuel / dt), 60.0 * C)
        fuel = fuel - power * dt
        flow = np.zeros(MATES)
        across = G * np.diff(T)
        flow[:-1] += across
        flow[1:] -= across
        on = heater * (T[0] < 200.0) * (fuel[0] > 0.9 * fuel0)
        T = T + dt / C * (power + flow - h * (T - 25.0) + np.r_[on, np.zeros(MATES - 1)])
        if step % round(1 / dt) == 0:
            rows.append(T)
    true = np.array(rows)
    return true, true + 0.05 * rng.standard_normal(true.shape)


def spread(seeds):
    """Seconds after the rule, of every simulated cell in which it holds."""
    found = []
    for seed in range(seeds):
        true, y = propagation(seed)
        told = {k: s for s, k in reversed(called(y))}
        for k in range(true.shape[1]):
            fast = np.diff(true[:, k]) >= 1.0
            at = next((i for i in range(4, len(true)) if fast[i - 4 : i].all() and true[i, k] > 60.0), None)
            if at is not None:
                found.append(told[k] - at if k in told else None)
    return found


def false_calls(seeds, only=None):
    """Faults called runaway, by kind, temperature, and whether others are seen; and how many were tried."""
    found, tried = {}, 0
    for kind in only or [*ALONE, *WITH_MATES]:
        for context in CONTEXTS:
            for seed in seeds:
                y = read(kind, context, seed)
                for mates in (False, True) if kind in ALONE else (True,):
                    tried += 1
                    if called(y if mates else y[:, :1]):
                        key = f"{kind}, {context}, {'with others' if mates else 'alone'}"
                        found[key] = found.get(key, 0) + 1
    return found, tried


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    result = {"delays_s": {}}
    if (data_dir() / "abuse").is_dir():
        for (name, variant), found in delays(20).items():
            told = [d for d in found if d is not None]
            result["delays_s"][f"{name}, {variant}"] = found
            print(f"{name}, {variant}: told {len(told)} of {len(found)}, {min(told)} to {max(told)} s after the rule")
    after = spread(min(args.seeds, 20))
    told = [d for d in after if d is not None]
    result["simulated_s"] = after
    print(f"simulated cells: told {len(told)} of {len(after)}; worst {max(told)} s after the rule")
    wrong, tried = false_calls(range(args.seeds))
    result |= {"false": wrong, "tried": tried}
    print(f"{len(ALONE) + len(WITH_MATES)} kinds of fault: {sum(wrong.values())} of {tried} called runaway")
    for key, count in sorted(wrong.items(), key=lambda x: -x[1]):
        print(f"  {count} x {key}")
    if args.json:
        args.json.write_text(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
