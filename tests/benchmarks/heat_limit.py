"""How soon anybody could tell heat of a cell's own: the bound that sensors and ignorance set, whatever the method.

`python -m tests.benchmarks.heat_limit [--seeds N] [--first S]`

The readings of a string of `heat_case` are what its truth says, plus what is not known: white noise and steps of
0.1 K (means of ten seconds), drift of 0.1 K/√h in each sensor, and the string's numbers, which an hour of readings
tells as well as they can be told. Everything is linear about the truth and Gaussian. So the share of the heat's own
trace that nothing else explains, over its sd, is what the best of all detectors sees (Cramér-Rao). It knows when the
heat began, and in which cell; real ones do not.

Four states of knowledge: "sensors", all numbers exact; "cells", cells unlike by 2.5 % and what is common to them
known as on a data sheet; "heat", and R_e of all cells changes by 10 % in a quarter of an hour, by charge and
overpotential; "films", and so do films and inlet, by 10 % and 0.4 K. Heat is told at 5.3 sd (ln evidence 14).
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from tests.benchmarks.heat_case import AMPS, CELLS, PACKS, SENSORS
from tests.truth.drives import urban
from tests.truth.pack import integrate, terms

SECONDS, AT, STEP = 5400, 3600, 10
TOLD = 5.3
"""sd: √(2 × 14), a little above the evidence at which the watch accepts heat (`SURE`)."""
COMMON = {"R_e": 0.07, "R_c": 0.07, "R_u": 0.1, "C_c": 0.03, "C_s": 0.05, "R_cc": 0.15}
UNLIKE = {"R_e": 0.025, "R_u": 0.025, "R_c": 0.03}
QUARTER = 900
BRISK, FILM, INLET = 0.1, 0.1, 0.4
LITTLE = 0.01
ROWS = (("liquid", 6, 1.0), ("liquid", 6, 3.0), ("liquid", 7, 10.0), ("small", 6, 0.3), ("small", 7, 1.0))
STATES = ("sensors", "cells", "heat", "films")


def traces(pack: str, drive: str, cell: int, seed: int) -> dict[str, list[np.ndarray]]:
    """What 1 W in a cell does to the sensors (steps, m), K; and one sd of each unknown, by what makes it known."""
    rng = np.random.default_rng([seed, 5])
    current = np.zeros(SECONDS) if drive == "rest" else urban(rng, SECONDS) * AMPS[pack] * rng.uniform(0.7, 1.1)
    air = 25.0 + 5.0 * np.sin(2 * np.pi * np.arange(SECONDS + 1) / rng.uniform(5400, 20000) + rng.uniform(0, 6))
    numbers = PACKS[pack]

    def string(**change: object):
        return terms(CELLS, current, air, np.ones(SECONDS), 0.6, start=air[0], **(numbers | change))

    plain, short, warm = string(), string(), string()
    short.core_heat[AT:, cell - 1] += 1.0
    warm.inlet = warm.inlet + 0.3
    cases, states = [plain, short, warm], ["", "signal", "cells"]
    scales = [1.0, 1.0, 1.0]
    for k, sd in COMMON.items():
        cases.append(string(**{k: numbers[k] * (1.0 + LITTLE)}))
        scales.append(sd / LITTLE)
    for k, sd in UNLIKE.items():
        for j in range(CELLS):
            cases.append(string(**{k: numbers[k] * (1.0 + LITTLE * (np.arange(CELLS) == j))}))
            scales.append(sd / LITTLE)
    states += ["cells"] * (len(cases) - len(states))
    for a in range(0, SECONDS, QUARTER // 3):  # steps whose sum is a walk: the sd is reached in a quarter of an hour
        for k, sd in (("heat", BRISK), ("films", FILM), ("inlet", INLET)):
            x = string()
            if k == "heat":
                x.R_e[a:] *= 1.0 + LITTLE
            elif k == "films":
                x.R_u[a:] *= 1.0 + LITTLE
            else:
                x.inlet[a:] += LITTLE
            cases.append(x)
            states.append("heat" if k == "heat" else "films")
            scales.append(sd / LITTLE / np.sqrt(3.0))
    found: dict[str, list[np.ndarray]] = {}
    every = [tr.surface[1:, np.array(SENSORS) - 1].reshape(-1, STEP, len(SENSORS)).mean(1) for tr in integrate(cases)]
    for state, scale, y in zip(states[1:], scales[1:], every[1:], strict=True):
        found.setdefault(state, []).append((y - every[0]) * scale)
    return found


def seen(found: dict[str, list[np.ndarray]], state: str) -> np.ndarray:
    """Sd (steps,) by which the best detector sees 1 W, by the time since it began."""
    signal = found["signal"][0]
    steps, m = signal.shape
    since = np.minimum.outer(np.arange(steps), np.arange(steps)) * STEP / 3600.0
    walk = 0.2**2 + 0.1**2 * since + np.eye(steps) * (0.05**2 + 0.1**2 / 12.0) / STEP
    noise = np.einsum("ab,ij->aibj", walk, np.eye(m)).reshape(steps * m, steps * m)
    for known in STATES[1 : STATES.index(state) + 1]:
        S = np.stack([x.reshape(-1) for x in found[known]])
        noise += S.T @ S
    white = np.linalg.solve(np.linalg.cholesky(noise), signal.reshape(-1))
    return np.sqrt(np.cumsum(np.square(white).reshape(steps, m).sum(1)))[AT // STEP :]


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=5)
    ask.add_argument("--first", type=int, default=1000)
    args = ask.parse_args()
    print(f"sd after 4 and 20 min, and minutes to {TOLD} sd, medians of {args.seeds} strings")
    for pack, cell, watts in ROWS:
        for drive in ("urban", "rest"):
            found = [traces(pack, drive, cell, seed) for seed in range(args.first, args.first + args.seeds)]
            words = []
            for state in STATES:
                sd = np.stack([watts * seen(x, state) for x in found])
                least = [np.argmax(s > TOLD) / 6 if s[-1] > TOLD else np.inf for s in sd]
                a, b = np.median(sd[:, [24, 120]], axis=0)
                words.append(f"{state} {a:.1f}, {b:.1f}: {np.median(least):.1f} min")
            print(f"{pack} cell {cell} {watts:g} W, {drive}: " + "; ".join(words), flush=True)


if __name__ == "__main__":
    main()
