"""Placement of 4 sensors on 12 cells, all 495 sets: `python -m tests.benchmarks.bench_placement [--json]`.

The product against a plain loop of scipy's `solve_discrete_are`, in turn in one run, with the two answers compared.
Beside it a long string, which dense Riccati solutions cannot be asked for, and the two commands with their start.
"""

import itertools
import json
import os
import subprocess
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import statistics
import time

import numpy as np
import scipy.linalg

from bms_gateway.sensors import PlacementProblem, Steady, paper_string
from bms_gateway.thermal import Disturbance, continuous, gathered_noise
from tests.benchmarks.rounds import ROUNDS, alternate, ratio

SETS = list(itertools.combinations(range(1, 13), 4))
LONG, FEW = 200, 5
COMMANDS = ("observability --cells 12 --sensors 3,6,9,12 --json -", "place --cells 12 --sensors 4 --json -")


def plain() -> np.ndarray:
    """Worst core of every set by one dense Riccati solution each."""
    p, d = paper_string(12), Disturbance()
    s = continuous(p)
    common = s.B_q.sum(axis=1)
    W = d.heat_common**2 * np.outer(common, common) + d.heat_cell**2 * s.B_q @ s.B_q.T
    Phi, Q = gathered_noise(s.A, 2 * d.correlation * (W + d.inlet**2 * np.outer(s.B_f, s.B_f)), 1.0)
    R, worst = d.sensor**2 * np.eye(4), []
    for sensors in SETS:
        C = np.eye(24)[[2 * k - 1 for k in sensors]]
        P = scipy.linalg.solve_discrete_are(Phi.T, C.T, Q, R)
        P = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + R, C @ P)
        worst.append(np.sqrt(np.diag(P)[0::2].max()))
    return np.array(worst)


def ours() -> np.ndarray:
    return Steady.of(paper_string(12)).core_sd(SETS).max(axis=1)


def main() -> None:
    difference = float(np.abs(ours() / plain() - 1.0).max())
    times = alternate({"scipy": plain, "ours": ours})
    for t in times.values():
        print(f"{t.name:>6}: {t.median:.3f} s CPU for {len(SETS)} sets ({min(t.seconds):.3f} to {max(t.seconds):.3f})")
    print(f"scipy takes {ratio(times['scipy'], times['ours'])} of ours; answers differ by {difference:.1e} at most")
    start = time.process_time()
    found = PlacementProblem(paper_string(LONG)).best(FEW)
    long_s = time.process_time() - start
    print(f"{FEW} of {LONG} cells: {long_s:.1f} s CPU, worst core {found.best[0].worst_sd:.3f} K")
    print(f"  evenly {found.even.worst_sd:.3f} K, no sensor {found.nothing.worst_sd:.3f} K")
    answers = {}
    for command in COMMANDS:
        took = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-m", "bms_gateway", *command.split()], check=True, capture_output=True)
            took.append(time.perf_counter() - start)
        answers[command] = statistics.median(took)
        print(f"{command}: {answers[command]:.2f} s from start to answer ({min(took):.2f} to {max(took):.2f})")
    if "--json" in sys.argv:
        seconds = {name: t.median for name, t in times.items()} | answers
        print(json.dumps({"exhaustive_s": seconds, "largest_difference": difference, "long_s": long_s}))


if __name__ == "__main__":
    main()
