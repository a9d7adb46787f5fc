"""Cores of a cell with a short of tens and hundreds of watts, by the observer alone: how often inside their band.

`python -m tests.benchmarks.bench_short [--seeds N] [--first S] [--never]`

Strings come from `heat_case`, whose truth is no code of the package: one cell; twelve with a thermocouple on the
shorted one alone; twelve with two others beside it. `--never` gives the figures of an observer that is never surprised.
Seeds below 500 were used while settings were chosen.
"""

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.observe import AdaptiveObserver, innovation_check
from tests.benchmarks.heat_case import LAYOUTS, Case, make, model, with_seeds

WATTS = (10.0, 30.0, 100.0, 200.0)
AT, LATER = 900, 300


def followed(case: Case, seeds: range) -> tuple[np.ndarray, np.ndarray]:
    """Errors and standard deviations (seconds, strings, cells) of the cores, K."""
    made = make(with_seeds(case, seeds))
    observer = AdaptiveObserver([model(case.pack, case.cells, case.sensors)] * len(made), 1.0)
    I, inlet, y = (np.stack([getattr(x, k) for x in made]) for k in ("current", "inlet", "y"))  # noqa: E741
    age, error, sd = np.zeros(y[:, 0].shape), [], []
    for t in range(case.seconds):
        e = observer.step(I[:, t] ** 2, None, inlet[:, t], y[:, t], age)
        error.append(np.stack([x.core[t] for x in made]) - e.core)
        sd.append(e.core_sd)
    return np.array(error), np.array(sd)


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=12)
    ask.add_argument("--first", type=int, default=500)
    ask.add_argument("--never", action="store_true")
    args = ask.parse_args()
    if args.never:
        innovation_check.ODD = np.inf  # type: ignore[misc]
    seeds = range(args.first, args.first + args.seeds)
    for pack in ("liquid", "small"):
        for layout, (cells, sensors, cell) in LAYOUTS.items():
            case = Case(pack, 0, AT + LATER, "us06", at=AT, cells=cells, sensors=sensors, cell=cell)
            error, sd = (x[300:] for x in followed(case, seeds))
            inside = (np.abs(error) <= 2.0 * sd).mean()
            print(f"{pack}, {layout}: nothing wrong: sd {sd.mean():.2f} K, inside {inside:.3f}", flush=True)
            for watts in WATTS:
                short = Case(pack, 0, AT + LATER, "us06", "heat", cell, watts, AT, cells=cells, sensors=sensors)
                error, sd = (x[AT:] for x in followed(short, seeds))
                inside, k = np.abs(error) <= 2.0 * sd, cell - 1
                others = np.delete(inside, k, axis=2)
                print(
                    f"{pack}, {layout}: {watts:.0f} W: inside from onset {inside[..., k].mean():.2f}, from 60 s on "
                    f"{inside[60:, :, k].mean():.2f} (error {np.abs(error[60:, :, k]).mean():.1f}, sd "
                    f"{sd[60:, :, k].mean():.1f} K)" + (f", other cells {others.mean():.2f}" if cells > 1 else ""),
                    flush=True,
                )


if __name__ == "__main__":
    main()
