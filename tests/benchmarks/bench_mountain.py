"""Reversible heat on a mountain road: is the band of a core honest while the current keeps its sign for half an hour?

``python -m tests.benchmarks.bench_mountain [--seeds 3] [--first 1] [--sizes 0.1,0.2] [--root DIR] [--json F]``

Strings of 6 to 12 cells with 1 to 3 thermocouples, cooled by a liquid or by forced air, by the independent truth. They
drive in a town for forty minutes, climb for 25 to 40 minutes and charge downhill for as long, with a hidden entropic
coefficient dU/dT of either sign, the same at every state of charge or varying with it by its knots. Parameters lie
within 15 % of the model file, which knows them to 30 % (or 10 to 15 %: ``--priors known``) and no entropy. Tables go
the road that a user has (`honesty_road`). A size of 0 is a string without reversible heat. ``--root``: the package of
another checkout on the same cases.
"""

import argparse
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.benchmarks.heat_case import PACKS
from tests.benchmarks.honesty_case import Outcome, model_text, scored
from tests.benchmarks.honesty_road import ROOT, drive_through
from tests.benchmarks.honesty_simulated import PRIORS as USUAL_PRIORS
from tests.config.bench_cell import write_string
from tests.truth.drives import urban
from tests.truth.effects import entropic_heat
from tests.truth.pack import integrate, terms

PRIORS = USUAL_PRIORS | {
    "known": {"C_c": 0.05, "C_s": 0.05, "R_e": 0.1, "R_c": 0.15, "R_u": 0.15, "R_cc": 0.2, "C_f": 0.05}
}
SCALE = {"liquid": 1.0, "forced": 0.8}
"""Current over that of the cell of the paper, whose heat is of the same order in its own cooling."""
UP_A, DOWN_A = (30.0, 60.0), (-50.0, -20.0)
CLIMB_S = (1500, 2400)
TOWN_S = 2400
TOWN = 0.7
"""Current over that of the drive cycle: a town before mountains asks for less than they do."""
STAY_S = (40, 200)
"""How long a slope stays as steep as it is."""
RIPPLE = 0.15
"""Sd of the current about its mean within a slope, by the second."""
PROFILE = np.array([-0.6, 1.4, 0.8, -0.2])
"""dU/dT by the knots of `tests.truth.effects`, over its size, as in the logs with hidden effects."""
USED = 0.8
"""Share of the charge that a drive moves."""
SIZES = (0.1, 0.2, 0.4)
"""mV/K"""


@dataclass
class MountainRoad:
    """One string on its road as a case (`honesty_case.Case`)."""

    pack: str
    size: float
    varying: bool
    seed: int
    kind: str = field(init=False)
    label: str = field(init=False)
    sensors: tuple[int, ...] = field(init=False)
    columns: dict[str, np.ndarray] = field(init=False)
    time_s: np.ndarray = field(init=False)
    core: np.ndarray = field(init=False)
    capacity_Ah: float = field(init=False)
    has_voltage: bool = False

    def __post_init__(self) -> None:
        what = list(SCALE).index(self.pack), round(1000 * self.size) + 10_000, int(self.varying)
        rng = np.random.default_rng([self.seed, 31, *what])
        n = int(rng.integers(6, 13))
        m = int(rng.integers(1, 4))
        self.sensors = tuple(sorted((rng.choice(n, m, replace=False) + 1).tolist()))
        self.kind = f"{self.pack}, {self.size:g} mV/K{' by charge' if self.varying else ''}"
        self.label = f"{self.kind} n={n} m={m} #{self.seed}"
        current = road(rng) * SCALE[self.pack]
        K = len(current)
        moved = np.concatenate([[0.0], np.cumsum(current)]) / 3600.0
        self.capacity_Ah = float(np.ptp(moved)) / USED
        soc = 0.9 - (moved - moved.min()) / self.capacity_Ah
        draw = {
            k: v * rng.uniform(0.85, 1.15) for k, v in PACKS[self.pack].items() if k in ("R_e", "R_c", "R_u", "R_cc")
        }
        draw |= {k: draw[k] * (1.0 + 0.02 * np.clip(rng.normal(size=n), -2, 2)) for k in ("R_e", "R_c", "R_u")}
        draw |= {k: PACKS[self.pack][k] * (1.0 + 0.02 * np.clip(rng.normal(), -2, 2)) for k in ("C_c", "C_s", "C_f")}
        inlet = 22.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(K + 1) / rng.uniform(1500, 5000) + rng.uniform(0, 6))
        t = terms(n, current, inlet, np.ones(K), 0.5, start=float(inlet[0] + 0.3 * rng.normal()), **draw)
        t.soc = (soc[1:] + soc[:-1]) / 2.0
        if self.size:
            entropic_heat(t, dUdT=self.size * PROFILE if self.varying else self.size)
        trace = integrate([t])[0]
        self.time_s, self.core = np.arange(float(K)), trace.core[:-1]
        read = trace.surface[:-1] + 0.03 * np.clip(rng.normal(size=n), -2, 2) + 0.05 * rng.normal(size=(K, n))
        self.columns = {
            "time_s": self.time_s,
            "current_A": np.round(current, 2),
            "coolant_inlet_C": np.round(inlet[:-1] + 0.03 * rng.normal(size=K), 1),
            **{f"surface_{k}_C": np.round(read[:, k - 1], 1) for k in self.sensors},
        }

    @property
    def numbers(self) -> Mapping[str, float]:
        return PACKS[self.pack]

    @property
    def cells(self) -> int:
        return int(self.core.shape[1])

    def write_table(self, folder: Path) -> Path:
        path = folder / "road.csv"
        rows = np.column_stack(list(self.columns.values()))
        np.savetxt(path, rows, fmt="%.6g", delimiter=",", header=",".join(self.columns), comments="")
        return path

    def write_config(self, folder: Path, priors: str, method: str = "window") -> Path:
        known = PRIORS[priors]
        model = model_text(self.numbers, known, self.capacity_Ah, cells=self.cells, sensors=self.sensors)
        return write_string(folder, model, sensors=self.sensors, method=method)


def road(rng: np.random.Generator) -> np.ndarray:
    """Current of a town, a climb and a descent, A, discharge positive, one value a second."""
    parts = [TOWN * urban(rng, TOWN_S)[:TOWN_S]]
    for low, high in (UP_A, DOWN_A):
        left = int(rng.integers(*CLIMB_S))
        while left > 0:
            stay = min(left, int(rng.integers(*STAY_S)))
            parts.append(rng.uniform(low, high) * (1.0 + RIPPLE * rng.normal(size=stay)))
            left -= stay
    return np.concatenate(parts)


def cases(args: argparse.Namespace) -> Iterator[MountainRoad]:
    for seed in range(args.first, args.first + args.seeds):
        for pack in args.packs:
            for size in args.sizes:
                signs = (1, -1) if size else (1,)
                for sign in signs:
                    for varying in (False, True) if size else (False,):
                        yield MountainRoad(pack, sign * size, varying, seed)


def outcome(c: MountainRoad, priors: str, root: Path, method: str) -> Outcome:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table, config = c.write_table(folder), c.write_config(folder, priors, method)
        s = drive_through(root, table, config, folder / "out")
        return Outcome(
            c.label, c.kind, priors, root.name, scored(c, s.time_s, s.core, s.sd, s.told), s.since, s.seconds
        )


def summary(name: str, some: list[Outcome]) -> str:
    s = [o.scores["settled"] for o in some]
    inside = np.array([x.inside for x in s])
    wrong = sum(o.confidently_wrong() for o in some)
    rmse = float(np.sqrt(np.mean([x.rmse**2 for x in s])))
    sd, crps, told = (float(np.mean([getattr(x, k) for x in s])) for k in ("sd", "crps", "told"))
    return (
        f"{name:<28} {len(some):>3} strings: inside {inside.mean():4.0%} (worst {inside.min():4.0%}), "
        f"rmse {rmse:.2f} K, sd {sd:.2f} K, crps {crps:.2f} K, told {told:4.0%}, {wrong} confidently wrong"
    )


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=3)
    ask.add_argument("--first", type=int, default=1)
    ask.add_argument("--packs", type=lambda x: x.split(","), default=list(SCALE))
    ask.add_argument("--sizes", type=lambda x: [float(v) for v in x.split(",")], default=list(SIZES), help="mV/K")
    ask.add_argument("--priors", default="default", choices=list(PRIORS))
    ask.add_argument("--method", default="window", choices=["window", "off"])
    ask.add_argument("--root", type=Path, default=ROOT, help="another checkout")
    ask.add_argument("--jobs", type=int, default=1)
    ask.add_argument("--json", type=Path)
    ask.add_argument("--quiet", action="store_true", help="no line per case")
    args = ask.parse_args()
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # the children's
    found: list[Outcome] = []
    with ThreadPoolExecutor(args.jobs) as pool:
        for o in pool.map(lambda c: outcome(c, args.priors, args.root, args.method), cases(args)):
            found.append(o)
            if not args.quiet:
                print(summary(o.case, [o]), sorted(o.told), flush=True)
    for kind in dict.fromkeys(o.kind for o in found):
        print(summary(kind, [o for o in found if o.kind == kind]))
    print(summary("all", found))
    if args.json:
        args.json.write_text(
            json.dumps([o.__dict__ | {"scores": {k: v.__dict__ for k, v in o.scores.items()}} for o in found])
        )


if __name__ == "__main__":
    main()
