"""Strings whose model file knows its numbers well and lacks one effect: is the live band honest, and what is flagged?

``python -m tests.benchmarks.bench_known_numbers [--seeds 3] [--first 3] [--rel-sd 0.01,0.1] [--names A,B]``

Strings of twelve cells with three thermocouples by the independent truth, each with one effect of the catalogue at
`--size` that its model file lacks (`nothing`: none). The numbers of the file lie about the true ones as far as the file
says (`--rel-sd`). Tables go the road that a user has (`honesty_road`). ``--root``: the package of another checkout on
the same cases.
"""

import argparse
import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from tests.benchmarks.honesty_case import model_text
from tests.benchmarks.honesty_road import ROOT, drive_through
from tests.benchmarks.honesty_scores import score
from tests.benchmarks.honesty_simulated import Drive, SimulatedDrive
from tests.config.bench_cell import write_string
from tests.truth.drives import CYCLES, INLETS
from tests.truth.hidden import Scenario, make_logs
from tests.truth.pack import CAPACITY_AH, NOMINAL_FLOW
from tests.truth.sizes import SIZES
from tests.truth.suites import suited

NOTHING = "nothing"
CELLS, SENSORS = 12, (1, 6, 12)
SINCE_S = 120.0
"""Nothing is judged before: the start is unknown."""
EARLY_S = 1200.0
"""Until when the windows know little: the first is fitted after ten minutes."""
HEAT = ("alert unexplained_heat",)


class KnownDrive(SimulatedDrive):
    """A log of the truth whose model file knows the pack's own numbers."""

    def text(self, rel_sd: float) -> str:
        """Model file with numbers that lie about those of the pack as far as it says."""
        s = self.log.scenario
        rng = np.random.default_rng([s.seed, 57])
        true: Mapping[str, float] = {k: float(np.mean(self.log.pack[k])) for k in self.numbers}
        numbers = {k: v * np.exp(rel_sd * np.clip(rng.normal(), -2, 2)) for k, v in true.items()}
        known = dict.fromkeys(numbers, rel_sd)
        return model_text(numbers, known, CAPACITY_AH, cells=s.cells, sensors=s.sensors, flow_m3_s=NOMINAL_FLOW)

    def config(self, folder: Path, rel_sd: float, method: str) -> Path:
        """Write gateway and model files."""
        s = self.log.scenario
        return write_string(folder, self.text(rel_sd), sensors=s.sensors, also=s.columns, method=method)


@dataclass(frozen=True)
class Result:
    """One string with one file.

    Attributes
    ----------
    inside, inside_worst, sd_ratio, crps, rmse, untold : float
        As of `honesty_scores`, from `SINCE_S` on.
    early, late : float
        Share inside 2 sd before and after `EARLY_S`.
    told : float
        Share of the time in which something was told.
    told_min : float
        When first, in minutes; infinite for never.
    heat : bool
        Whether heat was told that no cell makes.
    """

    name: str
    rel_sd: float
    seed: int
    inside: float
    inside_worst: float
    early: float
    late: float
    sd_ratio: float
    rmse: float
    crps: float
    untold: float
    told: float
    told_min: float
    heat: bool
    seconds: float


def scenario(name: str, size: str, seed: int) -> Scenario:
    """One string: its pack, drive and inlet follow the seed and the effect."""
    number = seed * 1000 + 500 + (list(SIZES).index(name) if name in SIZES else 99)
    if name == NOTHING:
        rng = np.random.default_rng([number, 3])
        own = {"cycle": str(rng.choice(list(CYCLES))), "inlet": str(rng.choice(INLETS)), "seed": number}
        return Scenario(cells=CELLS, sensors=SENSORS, noise=0.05, step=0.1, **own)
    s = suited({name: size}, CELLS, number, reading=(0.05, 0.1))
    return replace(s, effects={name: (size, None)}, sensors=SENSORS)


def cases(args: argparse.Namespace) -> Iterator[tuple[str, int, KnownDrive]]:
    for seed in range(args.first, args.first + args.seeds):
        for name in args.names:
            s = scenario(name, args.size, seed)
            yield name, seed, KnownDrive(Drive(name, s), make_logs([s])[0])


def result(name: str, seed: int, c: KnownDrive, rel_sd: float, args: argparse.Namespace) -> Result:
    with tempfile.TemporaryDirectory() as tmp:
        folder = Path(tmp)
        table, config = c.write_table(folder), c.config(folder, rel_sd, args.method)
        s = drive_through(args.root, table, config, folder / "out")
    time_s = s.time_s - c.time_s[0]
    true = np.column_stack([np.interp(s.time_s, c.time_s, x) for x in c.core.T])

    def of(at: np.ndarray):
        return score(s.core[at], s.sd[at], true[at], s.told[at])

    whole, early, late = of(time_s >= SINCE_S), of((time_s >= SINCE_S) & (time_s < EARLY_S)), of(time_s >= EARLY_S)
    told = np.flatnonzero((s.told & (time_s >= SINCE_S)[:, None]).any(axis=1))
    return Result(
        name, rel_sd, seed, whole.inside, whole.inside_worst, early.inside, late.inside, whole.sd_ratio, whole.rmse,
        whole.crps, whole.untold, whole.told, float(time_s[told[0]]) / 60.0 if len(told) else np.inf,
        any(x in HEAT for x in s.since), s.seconds,
    )  # fmt: skip


def line(name: str, some: list[Result]) -> str:
    def mean(what: str) -> float:
        return float(np.mean([getattr(r, what) for r in some]))

    rmse = float(np.sqrt(np.mean([r.rmse**2 for r in some])))
    minute = float(np.median([r.told_min for r in some]))
    return (
        f"{name:<34} {len(some):>3}: inside {mean('inside'):4.0%} (early {mean('early'):4.0%}, "
        f"late {mean('late'):4.0%}, worst cell {min(r.inside_worst for r in some):4.0%}), rmse {rmse:5.2f} K, "
        f"sd/rmse {mean('sd_ratio'):5.2f}, crps {mean('crps'):5.2f} K, outside untold {mean('untold'):4.0%}, "
        f"told {mean('told'):4.0%} from {minute:.1f} min, heat {sum(r.heat for r in some)}"
    )


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=3)
    ask.add_argument("--first", type=int, default=3)
    ask.add_argument("--rel-sd", type=lambda x: [float(v) for v in x.split(",")], default=[0.01, 0.1])
    ask.add_argument("--names", type=lambda x: x.split(","), default=[*SIZES, NOTHING])
    ask.add_argument("--size", default="strong", choices=["weak", "medium", "strong"])
    ask.add_argument("--method", default="window", choices=["window", "off"])
    ask.add_argument("--root", type=Path, default=ROOT, help="another checkout")
    ask.add_argument("--json", type=Path)
    ask.add_argument("--quiet", action="store_true", help="no line per case")
    args = ask.parse_args()
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # the children's
    found: list[Result] = []
    for name, seed, c in cases(args):
        for rel_sd in args.rel_sd:
            r = result(name, seed, c, rel_sd, args)
            found.append(r)
            if not args.quiet:
                print(line(f"{name} {rel_sd:g} #{seed}", [r]), f"{r.seconds:.0f} s", flush=True)
            if args.json:
                args.json.write_text(json.dumps([asdict(x) for x in found]))
    for rel_sd in args.rel_sd:
        for name in args.names:
            print(line(f"{name} {rel_sd:g}", [r for r in found if (r.name, r.rel_sd) == (name, rel_sd)]))
        print(line(f"all, {rel_sd:g}", [r for r in found if r.rel_sd == rel_sd]))


if __name__ == "__main__":
    main()
