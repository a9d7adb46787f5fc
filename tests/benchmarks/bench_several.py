"""Buses with only the greatest, least and mean surface of 96 cells: the hottest core, against the independent truth.

python -m tests.benchmarks.bench_several [--seeds 101,102,103] [--case NAME] [--minutes 30] [--cells 96] [--json F]
    [--oracle [--exact R_e,R_c]]

Each case is a pack whose cells differ by 5 %, whose resistances are off those of its model by draws of 15 % (R_e, R_u)
and 10 % (R_c), and whose readings have 0.1 K of noise and are sent in steps. The figures are those of the hottest core
from minute 5 of the log on: RMSE, and the share of time inside 2 sd.

`--oracle` gives the same figures of a gateway that knows which cell is the hottest, has a thermocouple on it in steps
of 0.01 K, identifies its parameters (`window`), and looks at this cell alone. `--exact` also tells it some of these
parameters, which shows what the error comes from.
"""

import argparse
import csv
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bms_gateway.cli.main import main as command
from tests.truth.cycle import repeated
from tests.truth.string import TruthString, rk4

CELLS = 96
MODEL = """cells = {cells}
sensors = []
condition = "natural"
effects = []
[parameters]
C_c  = {{ value = 268.0, unit = "J/K", rel_sd = 0.1 }}
C_s  = {{ value = 18.8, unit = "J/K", rel_sd = 0.3 }}
R_e  = {{ value = 3.5, unit = "mOhm", rel_sd = 0.2 }}
R_c  = {{ value = 1.266, unit = "K/W", rel_sd = 0.2 }}
R_u  = {{ value = 0.79, unit = "K/W", rel_sd = 0.3 }}
R_cc = {{ value = 4.0, unit = "K/W", rel_sd = 0.3 }}
"""
DBC = """VERSION ""
BU_: B
BO_ 256 P: 8 B
 SG_ I : 0|16@1- (0.1,0) [-3000|3000] "A" B
 SG_ In : 16|16@1- (0.01,0) [-40|100] "C" B
BO_ 257 T: 8 B
 SG_ Hi : 0|8@1+ ({step},-40) [-40|80] "C" B
 SG_ Lo : 8|8@1+ ({step},-40) [-40|80] "C" B
 SG_ Av : 16|8@1+ ({step},-40) [-40|80] "C" B
"""
ALL = {"hot": ("max", "Hi"), "cold": ("min", "Lo"), "mean": ("mean", "Av")}


@dataclass(frozen=True)
class Case:
    """A pack and what it sends: step of the readings, K; how R_u differs by place; minutes driven before the log."""

    sent: tuple[str, ...] = ("hot", "cold", "mean")
    step: float = 0.5
    cooling: str = "even"
    before_min: int = 0


CASES = {
    "even": Case(),
    "greatest only": Case(("hot",)),
    "greatest only, 1 K": Case(("hot",), step=1.0),
    "1 K": Case(step=1.0),
    "graded cooling": Case(cooling="graded"),
    "graded cooling, greatest only": Case(("hot",), cooling="graded"),
    "warm corner": Case(cooling="corner"),
    "warm corner, greatest only, 1 K": Case(("hot",), 1.0, "corner"),
    "late start": Case(before_min=25),
    "late start, greatest only, 1 K": Case(("hot",), 1.0, before_min=25),
    "late start, graded, 1 K": Case(step=1.0, cooling="graded", before_min=25),
    "mean only, 1 K": Case(("mean",), 1.0),
}


def cooling_of(kind: str, cells: int) -> np.ndarray:
    """R_u of each cell over the model's."""
    place = np.linspace(-1.0, 1.0, cells)
    if kind == "graded":
        return np.exp(0.25 * place)
    if kind == "corner":
        return 1.0 + 0.4 * np.exp(-np.arange(cells)[::-1] / 4.0)
    return np.ones(cells)


@dataclass(frozen=True)
class Driven:
    """The truth of a drive: each cell's parameters, current (K,), inlet (K + 1,), core and surface (K + 1, cells)."""

    off: dict[str, np.ndarray]
    current: np.ndarray
    inlet: np.ndarray
    core: np.ndarray
    surface: np.ndarray
    rng: np.random.Generator


def driven(case: Case, seed: int, minutes: int, cells: int) -> Driven:
    """Drive a pack; what came before the log is not in it."""
    rng = np.random.default_rng([seed, 96])
    before = 60 * case.before_min
    current = 0.7 * repeated(minutes + case.before_min, seed)
    inlet = 22.0 + 2.0 * np.sin(np.arange(len(current) + 1) / 200)
    off = {"R_e": 3.5e-3 * np.exp(0.15 * rng.normal() + 0.05 * rng.normal(size=cells))}
    off |= {"R_u": 0.79 * cooling_of(case.cooling, cells) * np.exp(0.15 * rng.normal() + 0.05 * rng.normal(size=cells))}
    off |= {"R_c": 1.266 * np.exp(0.1 * rng.normal() + 0.03 * rng.normal(size=cells))}
    core, surface = rk4(TruthString.of(cells, R_cc=4.0, **off), current, inlet, (25.0, 25.0))
    return Driven(off, current[before:], inlet[before:], core[before:], surface[before:], rng)


def drive(folder: Path, case: Case, seed: int, minutes: int, cells: int) -> tuple[Path, np.ndarray]:
    """Log of a drive, and the true hottest core by the second."""
    true = driven(case, seed, minutes, cells)

    def said(k: int) -> bytes:
        noisy = true.surface[k] + true.rng.normal(0, 0.1, cells)
        return bytes(round((x + 40) / case.step) for x in (noisy.max(), noisy.min(), noisy.mean()))

    return log_of(folder, true, said), true.core.max(axis=1)


def log_of(folder: Path, true: Driven, said: Callable[[int], bytes]) -> Path:
    """Write the log of a drive, with what is `said` of the surfaces in each second."""
    lines = []
    for k in range(len(true.current)):
        t = 1_700_000_000 + k
        amps = (round(10 * true.current[k]) & 0xFFFF).to_bytes(2, "little").hex()
        coolant = (round(100 * true.inlet[k]) & 0xFFFF).to_bytes(2, "little").hex()
        lines += [f"({t + 0.2 * j:.6f}) can0 100#{amps}{coolant}00000000" for j in range(5)]
        lines.append(f"({t + 0.95:.6f}) can0 101#{said(k).ljust(8, bytes(1)).hex()}")
    log = folder / "drive.log"
    log.write_text("\n".join(lines) + "\n")
    return log


def config(folder: Path, case: Case, cells: int) -> Path:
    """Write what the user would."""
    (folder / "car.dbc").write_text(DBC.format(step=case.step))
    (folder / "string.toml").write_text(MODEL.format(cells=cells))
    surface = "\n".join(
        f'{key} = {{ {ALL[key][0]}_of = "1-{cells}", signal = "T.{ALL[key][1]}" }}' for key in case.sent
    )
    path = folder / "gateway.toml"
    path.write_text(
        '[bus]\ndbc = ["car.dbc"]\ntransmit = false\n[[string]]\nname = "s"\nmodel = "string.toml"\n'
        f'[string.signals]\ncurrent = "P.I"\ncoolant_inlet = "P.In"\n[string.signals.surface]\n{surface}\n'
    )
    return path


def oracle(folder: Path, case: Case, seed: int, minutes: int, cells: int, exact: Sequence[str]) -> tuple[Path, Path]:
    """Log and configuration of the cell that is the hottest on the mean, with a thermocouple of its own."""
    true = driven(case, seed, minutes, cells)
    hot = int(true.core[300:].mean(axis=0).argmax())

    def said(k: int) -> bytes:
        return round((true.surface[k, hot] + true.rng.normal(0, 0.1) + 40) / 0.01).to_bytes(2, "little")

    path = config(folder, Case(("hot",), 0.01), 1)
    model, dbc = folder / "string.toml", folder / "car.dbc"
    lines = [x for x in model.read_text().splitlines() if not x.startswith("R_cc")]
    for k in exact:
        value = true.off[k][hot] * (1e3 if k == "R_e" else 1.0)
        unit = "mOhm" if k == "R_e" else "K/W"
        known = f'{k} = {{ value = {value:.5f}, unit = "{unit}", rel_sd = 0.005 }}'
        lines = [known if x.startswith(f"{k} ") else x for x in lines]
    model.write_text("\n".join(lines).replace("natural", "single").replace("sensors = []", "sensors = [1]"))
    dbc.write_text(dbc.read_text().split(" SG_ Lo")[0].replace("0|8@1+", "0|16@1+"))
    path.write_text(path.read_text().replace('hot = { max_of = "1-1", ', "1 = { "))
    return log_of(folder, true, said), path


def hottest(estimates: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time from the begin of the log, hottest core and its sd by tick."""
    with estimates.open() as f:
        rows = [
            (float(r["time_s"]), float(r["core_C"] or "nan"), float(r["core_sd_K"] or "nan")) for r in csv.DictReader(f)
        ]
    t, core, sd = np.array(rows).T
    times = np.unique(t)
    core, sd = core.reshape(len(times), -1), sd.reshape(len(times), -1)
    at = np.argmax(np.where(np.isnan(core), -np.inf, core), axis=1)
    row = np.arange(len(times))
    return times - 1_700_000_000, core[row, at], sd[row, at]


def score(
    case: Case, seed: int, minutes: int, cells: int = CELLS, exact: Sequence[str] | None = None
) -> dict[str, float]:
    """RMSE, K, bias, share inside 2 sd, and the mean sd of the hottest core from minute 5 on.

    `exact` names the parameters that an oracle knows; None is no oracle.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log, truth = drive(folder, case, seed, minutes, cells)
        path = config(folder, case, cells)
        if exact is not None:
            log, path = oracle(folder, case, seed, minutes, cells, exact)
        if command(
            ["analyze", str(log), "--config", str(path), "--out", str(folder / "out"), "--json", str(folder / "a.json")]
        ):
            raise SystemExit(f"analyze of seed {seed} failed")
        t, core, sd = hottest(folder / "out" / "estimates.csv")
    late = (t > 300) & (t < len(truth))
    error = core[late] - truth[t[late].astype(int)]
    inside = np.abs(error) < 2 * sd[late]  # a core that is not told is not inside
    return {
        "rmse_K": float(np.sqrt(np.nanmean(error**2))),
        "bias_K": float(np.nanmean(error)),
        "inside": float(inside.mean()),
        "sd_K": float(np.nanmean(sd[late])),
    }


def main() -> None:
    """Print a line per case."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", default="101,102,103,104,105")
    parser.add_argument("--case", action="append")
    parser.add_argument("--minutes", type=int, default=30)
    parser.add_argument("--cells", type=int, default=CELLS)
    parser.add_argument("--json")
    parser.add_argument("--oracle", action="store_true")
    parser.add_argument("--exact", default="", help="parameters that the oracle knows: R_e,R_c,R_u")
    args = parser.parse_args()
    exact = [k for k in args.exact.split(",") if k] if args.oracle else None
    found = {}
    for name in args.case or CASES:
        each = [score(CASES[name], int(seed), args.minutes, args.cells, exact) for seed in args.seeds.split(",")]
        found[name] = each
        rmse = np.array([e["rmse_K"] for e in each])
        biases = " ".join(f"{e['bias_K']:+.2f}" for e in each)
        print(
            f"{name:34s} RMSE median {np.median(rmse):.2f} worst {rmse.max():.2f} K  inside "
            f"{np.mean([e['inside'] for e in each]):.3f} worst {min(e['inside'] for e in each):.2f}  "
            f"sd {np.mean([e['sd_K'] for e in each]):.2f} K  biases {biases}",
            flush=True,
        )
    if args.json:
        Path(args.json).write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
