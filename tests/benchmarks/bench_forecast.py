"""How good is the forecast of a core one, five and ten minutes ahead, held against what a simpler one would have said?

Real cells and simulated ones, whose cores are known and never shown.

``python -m tests.benchmarks.bench_forecast [--only measured|simulated] [--cases hev2] [--packs 8] [--json F]``

Every case goes the road that a user has: a table is encoded to frames of our DBC, `forecast --truth` reads them and
scores itself against the core, from minute ten on, one forecast every 30 s. Measured: the cells with a thermocouple in
the core, with priors of the data sheet, without and with voltage, and where there is a sister record, with a model that
`fit --calibrate` made of that. Simulated: single cells by the independent truth whose numbers lie within 15 % of the
model, with heat that drifts, in restless drives.

Peers in the same run: the core stays as it is (the true one of now); the plain two-node model with the prior's numbers
and the actual current, started from the true core of now and the surface that is read.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.benchmarks.honesty_case import model_text
from tests.benchmarks.honesty_measured import PRIORS, SISTERS, MeasuredCell, measured_cells, read
from tests.benchmarks.honesty_road import ROOT
from tests.config.bench_cell import write_string
from tests.diagnosis.measured_cells import CELLS
from tests.truth.string import TruthString, rk4

SETTLED_S, EVERY_S = 600.0, 30
HORIZONS = ("60", "300", "600")
RUN = "import sys; from bms_gateway.cli.main import main; sys.exit(main(sys.argv[1:]))"


def command(*words: object) -> None:
    done = subprocess.run(
        [sys.executable, "-c", RUN, *map(str, words)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{words[0]}: {done.stderr.strip()[-500:]}")


def scored(folder: Path, table: Path, config: Path, time_s: np.ndarray, core: np.ndarray) -> dict:
    """Encode a table and let `forecast` score itself against the core from minute ten on."""
    log, truth, out = folder / "case.log", folder / "truth.csv", folder / "forecast.json"
    late = time_s >= time_s[0] + SETTLED_S
    columns = np.column_stack((time_s[late], core[late]))
    np.savetxt(truth, columns, "%.4f", ",", header="time_s,core_1_C", comments="")
    command("encode", table, "--config", config, "--out", log)
    command("forecast", log, "--config", config, "--truth", truth, "--every", EVERY_S, "--json", out)
    return json.loads(out.read_text())["score"]["strings"]["cell"]


def two_nodes(numbers: dict, t: dict) -> dict[str, float]:
    """Root mean square of the plain model with the prior's numbers, from the true core of now, by horizon."""
    seconds = np.arange(np.ceil(t["time_s"][0]), np.floor(t["time_s"][-1]))
    at = {k: np.interp(seconds, t["time_s"], t[k]) for k in ("core", "surface", "inlet")}
    edges = np.concatenate(([0.0], np.cumsum(np.diff(t["fast_s"]) * t["square"][:-1])))
    square = np.diff(np.interp(np.append(seconds, seconds[-1] + 1.0), t["fast_s"], edges))
    starts = np.arange(int(SETTLED_S), len(seconds) - 600, EVERY_S)
    if not len(starts):
        return {}
    S = len(starts)
    string = TruthString.of(1, batch=(S,), **numbers)
    heat = square[starts[None, :] + np.arange(600)[:, None]][:, :, None] * string.R_e
    inlet = np.broadcast_to(at["inlet"][starts], (601, S))
    begin = at["core"][starts][:, None], at["surface"][starts][:, None]
    core, _ = rk4(string, np.zeros((600, S)), inlet, begin, heat=heat)
    return {h: float(np.sqrt(np.mean((core[int(h), :, 0] - at["core"][starts + int(h)]) ** 2))) for h in HORIZONS}


def columns(c: MeasuredCell) -> dict:
    t = read(c.name)
    fast = read("a123_26650_hev2_raw_current") if c.name == "a123_26650_hev2" else t
    return {
        "time_s": t["t_s"], "core": t["T_core_C"], "surface": t["T_surf_C"], "inlet": t["T_amb_C"],
        "fast_s": fast["t_s"], "square": fast["I_A"] ** 2,
    }  # fmt: skip


def calibrated(folder: Path, c: MeasuredCell) -> str | None:
    """Model that `fit --calibrate` makes of a sister record's core; None where there is none."""
    if c.name not in SISTERS:
        return None
    t = read(SISTERS[c.name])
    table, plain, out = (folder / name for name in ("sister.csv", "plain.toml", "calibrated.toml"))
    some = t["t_s"], -t["I_A"], t["T_amb_C"], t["T_surf_C"], t["T_core_C"]
    head = "time_s,current_A,coolant_inlet_C,surface_1_C,core_1_C"
    np.savetxt(table, np.column_stack(some), "%.5f", ",", header=head, comments="")
    numbers, capacity = CELLS[SISTERS[c.name]]
    plain.write_text(model_text(numbers, PRIORS["default"], capacity))
    command("fit", table, "--model", plain, "--out", out, "--calibrate")
    return out.read_text()


def measured(folder: Path, names: list[str]) -> list[tuple[str, dict, dict]]:
    found = []
    for c in measured_cells(names):
        table, peer = c.write_table(folder), two_nodes(c.numbers, columns(c))
        own = folder / f"{c.label}"
        config = c.write_config(own, "default")
        found.append((f"{c.label}, data sheet", scored(own, table, config, c.time_s, c.core[:, 0]), peer))
        show(*found[-1])
        if (text := calibrated(own, c)) is not None:
            (own / "cell.toml").write_text(text)
            found.append((f"{c.label}, sister", scored(own, table, config, c.time_s, c.core[:, 0]), peer))
            show(*found[-1])
    return found


def simulated(folder: Path, packs: int) -> list[tuple[str, dict, dict]]:
    """Single cells of a 26650's size whose numbers lie within 15 % of the model, with heat that drifts."""
    found, nominal = [], {"C_c": 76.0, "C_s": 5.5, "R_e": 0.012, "R_c": 3.0, "R_u": 4.8}
    sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.15, "R_c": 0.15, "R_u": 0.15}
    for seed in range(packs):
        rng, K = np.random.default_rng(seed), 3000
        numbers = {k: v * float(np.exp(rng.normal(0.0, sd[k]))) for k, v in nominal.items()}
        keep = np.exp(-np.arange(K) / 600.0)
        drift = np.convolve(rng.normal(0.0, 0.1 * np.sqrt(2.0 / 600.0), K), keep)[:K]
        current = np.repeat(rng.choice([0.0, 5.0, -8.0, 14.0, 20.0, -20.0], K // 20), 20)
        heat = (current**2 * numbers["R_e"] + drift)[:, None]
        inlet = 22.0 + 0.5 * np.sin(np.arange(K + 1) / 900.0)
        core, surface = rk4(TruthString.of(1, **numbers), current, inlet, 22.0, heat=heat)
        own = folder / f"simulated_{seed}"
        own.mkdir()
        table, time = own / "cell.csv", np.arange(K)
        read_ = surface[:-1, 0] + rng.normal(0.0, 0.05, K)
        head = "time_s,current_A,coolant_inlet_C,surface_1_C"
        np.savetxt(table, np.column_stack((time, current, inlet[:-1], read_)), "%.4f", ",", header=head, comments="")
        config = write_string(own, model_text(nominal, sd, 2.3))
        t = {"time_s": time, "core": core[:-1, 0], "surface": read_, "inlet": inlet[:-1],
             "fast_s": time, "square": current**2}  # fmt: skip
        found.append((f"simulated {seed}", scored(own, table, config, time, core[:-1, 0]), two_nodes(nominal, t)))
        show(*found[-1])
    return found


def show(label: str, score: dict, peer: dict) -> None:
    for load in ("actual_current", "load_as_it_was"):
        for h in HORIZONS:
            if x := score.get(load, {}).get(h):
                stays = score.get("core_stays_as_it_is", {}).get(h, {}).get("rms_K")
                other = f"{peer[h]:.2f}" if h in peer else "–"
                print(
                    f"{label:28} {load:15} {int(h) // 60:3} min {x['forecasts']:5} {x['rms_K']:7.2f} "
                    f"{100 * x['inside_2sd']:7.1f} % {x['mean_sd_K']:6.2f} {x['crps_K']:6.2f} "
                    f"{'–' if stays is None else f'{stays:.2f}':>8} {other:>9}",
                    flush=True,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("measured", "simulated"))
    parser.add_argument("--cases", default="", help="parts of names of measured records")
    parser.add_argument("--packs", type=int, default=8)
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    print(
        f"{'case':28} {'load':15}   ahead     n   rms K  inside 2 sd  sd K   CRPS  stays K  two nodes from the truth K"
    )
    found = []
    with tempfile.TemporaryDirectory() as name:
        if args.only != "simulated":
            found += measured(Path(name), [x for x in args.cases.split(",") if x])
        if args.only != "measured":
            found += simulated(Path(name), args.packs)
    if args.json:
        args.json.write_text(json.dumps([{"case": a, "score": b, "two_nodes": c} for a, b, c in found], indent=1))


if __name__ == "__main__":
    main()
