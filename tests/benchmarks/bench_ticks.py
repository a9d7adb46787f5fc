"""Tick time of the estimators for 60, 1,000 and 10,000 cells: `python -m tests.benchmarks.bench_ticks`.

Observers in strings of twelve cells, sensors on both ends, steady state. Absolute times belong to the machine that ran
them; the exponent from 1,000 to 10,000 cells does not.
"""

import json
import math
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time

import numpy as np

from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import Prior, StringModel

CELLS = 12
SETTLE = 600  # steps until the covariance goes in long strides
STEPS, ROUNDS = 50, 7


def model() -> StringModel:
    values = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
    return StringModel(CELLS, (1, CELLS), "full", {name: Prior(value, 0.05) for name, value in values.items()})


def tick_seconds(strings: int) -> list[float]:
    """Seconds per step, one figure per round."""
    rng = np.random.default_rng(0)
    observer = AdaptiveObserver([model()] * strings, 1.0)
    nothing, age = np.full((strings, CELLS), np.nan), np.full((strings, CELLS), 0.3)
    inlet = np.full(strings, 25.0)

    def step() -> None:
        y = nothing.copy()
        y[:, [0, CELLS - 1]] = 28.0 + rng.normal(0.0, 0.1, (strings, 2))
        observer.step(np.full(strings, 3600.0), nothing, inlet, y, age)

    for _ in range(SETTLE):
        step()
    rounds = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        for _ in range(STEPS):
            step()
        rounds.append((time.perf_counter() - start) / STEPS)
    return rounds


def main() -> None:
    table = {}
    for cells in (60, 1_000, 10_000):
        us = [1e6 * s for s in tick_seconds(math.ceil(cells / CELLS))]
        table[cells] = {"median_us": statistics.median(us), "min_us": min(us), "max_us": max(us)}
        spread = f"rounds of {STEPS}: {min(us):.0f} to {max(us):.0f}"
        print(f"{cells:>6} cells: {statistics.median(us):8.0f} us a tick ({spread})")
    exponent = math.log10(table[10_000]["median_us"] / table[1_000]["median_us"])
    print(f"growth exponent from 1,000 to 10,000 cells: {exponent:.2f}")
    if "--json" in sys.argv:
        print(json.dumps({"ticks": table, "exponent": exponent}))


if __name__ == "__main__":
    main()
