"""Tick time for 60, 1,000 and 10,000 cells beside a peer: `python -m tests.benchmarks.bench_ticks [--profile]`.

Strings of twelve cells with parameters of their own, sensors on both ends, the same readings for all: those of an
independent simulation, for readings that nothing explains widen the bands in every tick. Three runs take
turns in each round:

* the observers alone: means, covariances, sensitivities, bands;
* the estimators of the engine: these and everything that is done of each string in a tick (events, identification's
  gathering, health); the fits of windows run as jobs beside the ticks and are not in it;
* a peer: the same filters in a loop over strings as filterpy (R. Labbe) writes them, with predict and update in its
  order and its number of products, in Joseph's form; it states no sensitivities, bands of parameters, late readings.

CPU time of the process. Figures are means over whole rounds, strides and blocks of the covariances included; beside
them the quickest tick. Absolute times belong to the machine, ratios and the exponent less so.
"""

import argparse
import cProfile
import json
import math
import os
import pstats
import statistics
import time
from collections.abc import Callable

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bms_gateway.engine.estimators import Estimators
from bms_gateway.engine.plan import Plan, StringPlan
from bms_gateway.engine.readings import Layout, Readings
from bms_gateway.frames.quality import Quality
from bms_gateway.observe import AdaptiveObserver, stack
from bms_gateway.thermal import Disturbance, Floats, Prior, StringModel
from tests.support.engine_parts import slow, wire
from tests.truth.string import TruthString, rk4

CELLS, SENSED = 12, (0, 11)
SIZES = (60, 1_000, 10_000)
GOALS_US = {60: 60.0, 1_000: 120.0, 10_000: 800.0}
SETTLE = 3600  # ticks: an hour of a drive; in the first one covariances still take strides that grow with it
TICKS, ROUNDS = 102, 7  # six blocks of sensitivities
PERIOD = 60  # of the current, s
EPOCH_NS, SECOND = 1_700_000_000_000_000_000, 1_000_000_000


def model(k: int) -> StringModel:
    """Tell of a string unlike all others, so that nothing can be shared between them."""
    values = {"C_c": 268.0, "C_s": 18.8, "R_e": 3.5e-3, "R_c": 1.266, "R_u": 0.79, "R_cc": 4.0, "C_f": 11.33}
    values["R_e"] *= 1.0 + 1e-4 * (k % 100)
    sd = {name: 0.0 if name.startswith("C_") else 0.05 for name in values}
    return StringModel(CELLS, (1, CELLS), "full", {name: Prior(x, sd[name]) for name, x in values.items()})


class Pack:
    """Strings and what is measured of them: a current that comes and goes, noise on the surfaces."""

    def __init__(self, strings: int) -> None:
        self.models = [model(k % 8) for k in range(strings)]  # discretising thousands would take a minute
        rng = np.random.default_rng(0)
        self.noise = rng.normal(0.0, 0.1, (64, strings, len(SENSED)))
        self.age = np.full((strings, CELLS), 0.3)
        string = TruthString.of(CELLS, R_cc=4.0, C_f=11.33)
        drive = np.sqrt([self.square(k) for k in range(SETTLE)])
        _, surface = rk4(string, drive, np.full(SETTLE + 1, 25.0), 25.0)
        self.surface = surface[-PERIOD:, SENSED]
        self.inlet = np.full(strings, 25.0)
        self.layout = Layout.of([f"string_{k + 1}" for k in range(strings)], [CELLS] * strings)

    def surfaces(self, k: int) -> Floats:
        y = np.full((len(self.models), CELLS), np.nan)
        y[:, SENSED] = self.surface[k % PERIOD] + self.noise[k % 64]
        return y

    @staticmethod
    def square(k: int) -> float:
        return 3600.0 if k // (PERIOD // 2) % 2 else 400.0

    def readings(self, k: int) -> Readings:
        S = len(self.models)
        none = np.full(S, np.nan)
        quality = np.full((S, CELLS), Quality.NEVER, np.uint8)
        quality[:, SENSED] = Quality.GOOD
        return Readings(
            np.array([np.full(S, 60.0), np.full(S, self.square(k)), none, none, np.full(S, 60.0)]),
            np.full(S, np.uint8(Quality.GOOD)),
            slow(self.inlet, none, none),
            self.surfaces(k).ravel(),
            self.age.ravel(),
            quality.ravel(),
            self.layout.parts,
        )


def observers(pack: Pack) -> Callable[[int], Callable[[], object]]:
    observer = AdaptiveObserver(pack.models, 1.0)

    def ready(k: int) -> Callable[[], object]:
        I2, y = np.full(len(pack.models), pack.square(k)), pack.surfaces(k)
        return lambda: observer.step(I2, None, pack.inlet, y, pack.age)

    return ready


def estimators(pack: Pack) -> Callable[[int], Callable[[], object]]:
    mine = wire({"current": 0, "coolant_inlet": 1}, CELLS)
    plan = Plan(tuple(StringPlan(f"string_{k + 1}", k + 1, m, ()) for k, m in enumerate(pack.models)))
    made = Estimators(plan, [mine] * len(pack.models))

    def ready(k: int) -> Callable[[], object]:
        readings = pack.readings(k)
        return lambda: made.step(readings, EPOCH_NS + k * SECOND)

    return ready


def peer(pack: Pack) -> Callable[[int], Callable[[], object]]:
    """Make one filter per string, each with its own arrays, as `filterpy.kalman.KalmanFilter` steps them."""
    whole = stack([m.nominal for m in pack.models], 1.0, Disturbance())
    M = whole.states
    H = np.zeros((len(SENSED), M))
    H[[0, 1], [2 * c + 1 for c in SENSED]] = 1.0
    R, eye = 0.01 * np.eye(len(SENSED)), np.eye(M)
    R_e = np.array([m.nominal.R_e for m in pack.models])
    F, B = [A.copy() for A in whole.A], [G[:, M:].copy() for G in whole.G]
    x, P = [np.full(M, 25.0) for _ in F], [eye.copy() for _ in F]

    def step(k: int, y: Floats) -> None:
        for s in range(len(F)):
            u = np.concatenate((pack.square(k) * R_e[s], [25.0, 25.0]))
            x[s] = F[s] @ x[s] + B[s] @ u
            P[s] = F[s] @ P[s] @ F[s].T + whole.Q[s]
            PHT = P[s] @ H.T
            K = PHT @ np.linalg.inv(H @ PHT + R)
            x[s] = x[s] + K @ (y[s][list(SENSED)] - H @ x[s])
            I_KH = eye - K @ H
            P[s] = I_KH @ P[s] @ I_KH.T + K @ R @ K.T

    def ready(k: int) -> Callable[[], object]:
        y = pack.surfaces(k)
        return lambda: step(k, y)

    return ready


class Run:
    """One of those that take turns, and what its rounds took: mean and quickest tick, seconds."""

    def __init__(self, ready: Callable[[int], Callable[[], object]], ticks: int, settle: int) -> None:
        self._ready, self._ticks, self._k = ready, ticks, 0
        self.mean: list[float] = []
        self.least: list[float] = []
        for _ in range(settle):
            self._tick()

    def _tick(self) -> float:
        act = self._ready(self._k)
        self._k += 1
        start = time.process_time_ns()
        act()
        return (time.process_time_ns() - start) * 1e-9

    def round(self) -> None:
        took = [self._tick() for _ in range(self._ticks)]
        self.mean.append(statistics.fmean(took))
        self.least.append(min(took))

    def profile(self) -> pstats.Stats:
        watch = cProfile.Profile()
        for _ in range(self._ticks):
            act = self._ready(self._k)
            self._k += 1
            watch.runcall(act)
        return pstats.Stats(watch)


def told(us: list[float]) -> str:
    return f"{statistics.median(us):8.0f} us (min {min(us):.0f}, max {max(us):.0f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--profile", action="store_true", help="tell where the time of the whole tick goes")
    parser.add_argument("--cells", type=int, nargs="+", default=SIZES)
    args = parser.parse_args()
    table: dict[int, dict[str, dict[str, float]]] = {}
    for cells in args.cells:
        pack = Pack(math.ceil(cells / CELLS))
        few = max(3, 10_000 // cells // 5)  # the peer takes long, and does the same every time
        runs = {
            "observers": Run(observers(pack), TICKS, SETTLE),
            "estimators": Run(estimators(pack), TICKS, SETTLE),
            "peer": Run(peer(pack), few, 2),
        }
        for _ in range(ROUNDS):
            for run in runs.values():
                run.round()
        table[cells] = {}
        for name, run in runs.items():
            us, least = [1e6 * s for s in run.mean], 1e6 * min(run.least)
            ratio = [p / m for p, m in zip(runs["peer"].mean, run.mean, strict=True)]
            goal = GOALS_US.get(cells, math.nan)
            print(
                f"{cells:>6} cells, {name:<10} {told(us)}, quickest tick {least:.0f}; peer "
                f"{statistics.median(ratio):.1f}x (min {min(ratio):.1f}, max {max(ratio):.1f})"
                + (f"; goal {goal:.0f}" if name != "peer" else "")
            )
            table[cells][name] = {
                "median_us": statistics.median(us),
                "min_us": min(us),
                "max_us": max(us),
                "quickest_us": least,
                "peer_ratio": statistics.median(ratio),
            }
        if args.profile:
            runs["estimators"].profile().sort_stats("tottime").print_stats(18)
    if {1_000, 10_000} <= set(table):
        for name in ("observers", "estimators", "peer"):
            exponent = math.log10(table[10_000][name]["median_us"] / table[1_000][name]["median_us"])
            print(f"growth exponent from 1,000 to 10,000 cells, {name}: {exponent:.2f}")
    if args.json:
        print(json.dumps(table))


if __name__ == "__main__":
    main()
