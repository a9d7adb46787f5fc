"""R_e of each cell from few sensors, Fig 10's case: `python -m tests.benchmarks.bench_cells [--seeds N] [--rows TEXT]`.

Five cells of 3.5 and 4.3 mOhm (the three inner ones hot), 89 minutes of the drive cycle, inlet moving by 5 K in five
minutes, 0.1 K noise. Per seed the pack's R_u, R_c, C_c, C_s, C_f, R_cc and sensor offsets are drawn, and slow
disturbances of heat and inlet; the truth is `tests.truth.unequal`. The gateway's model holds Table 1's numbers and
knows the scatter, not the draw. Cores are those of the adaptive observer with what was found, from minute ten on. An
error that the cells have in common is one draw per seed, so coverage wants many seeds.
"""

import argparse
import json
import os
import sys

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from dataclasses import dataclass

import numpy as np

from bms_gateway.identify.cell_prior import CellSettings
from bms_gateway.identify.resistance_by_cell import CellRecord, fit_cells, numbers_of
from bms_gateway.observe import AdaptiveObserver
from bms_gateway.thermal import Prior, StringModel
from tests.support.cell_resistances import electrical_resistance
from tests.truth.string import C_F, TABLE_1
from tests.truth.unequal import Scatter, drives

ENDS, ALL = (1, 5), (1, 2, 3, 4, 5)
WARM_UP = 600
BASE = 4000


@dataclass(frozen=True)
class Row:
    """One line of the table: who is sensed, which errors the joints have (None: no voltages), what must be reached."""

    name: str
    sensors: tuple
    joint: float | None = None
    ratio_sd: float = 0.03
    spread: float = 0.10
    fitted: bool = True
    sd: float | None = None
    core: float | None = None
    covered: bool = True
    drive: str = "usual"
    baseline: bool = False


DRIVES = {
    "usual": {"swing": 5.0},
    "rough": {"swing": 5.0, "scatter": Scatter(heat_cell=0.5)},
    "commissioning": {"swing": 8.0},
    "mild": {"swing": 3.0},
    "still": {"swing": 0.0},
    "before": {"swing": 8.0, "run": 1},
}
ROWS = (
    Row("nominal R_e, {1,5}", ENDS, fitted=False, covered=False),
    Row("shared R_e, {1,5}", ENDS, spread=1e-3, covered=False),
    Row("per cell, {1,5}: no promise", ENDS, covered=False),
    Row("{1,5} + voltages, joints 3 %", ENDS, 0.03, sd=0.05, core=2.0),
    Row("{1,5} + voltages, joints 1 %", ENDS, 0.01, sd=0.025, core=1.5),
    Row("all sensed, inlet moves by 8 K", ALL, sd=0.035, core=0.6, drive="commissioning"),
    Row("all sensed", ALL),
    Row("{1,5} + voltages 3 %, ratio unknown", ENDS, 0.03, ratio_sd=0.3),
    Row("{1,5} + voltages 1 %, ratio unknown", ENDS, 0.01, ratio_sd=0.3),
    Row("{1,5} after all sensed once", ENDS, baseline=True),
    Row("{1,5} + voltages after all sensed", ENDS, 0.03, baseline=True),
    Row("all sensed, own heat 0.5 W", ALL, drive="rough"),
    Row("{1,5} + voltages 3 %, own heat 0.5 W", ENDS, 0.03, drive="rough"),
    Row("all sensed, inlet moves by 3 K", ALL, drive="mild"),
    Row("{1,5} + voltages 3 %, by 3 K", ENDS, 0.03, drive="mild"),
    Row("{1,5} + voltages 1 %, by 3 K", ENDS, 0.01, drive="mild"),
    Row("all sensed, constant inlet", ALL, drive="still"),
    Row("{1,5} + voltages 3 %, constant inlet", ENDS, 0.03, drive="still"),
)


def model(sensors):
    rel_sd = {"C_c": 0.05, "C_s": 0.05, "R_e": 0.6, "R_c": 0.05, "R_u": 0.1, "R_cc": 0.2, "C_f": 0.05}
    values = {**TABLE_1, "R_cc": 4.0, "C_f": C_F}
    return StringModel(5, sensors, "full", {k: Prior(v, rel_sd[k]) for k, v in values.items()}, coolant="ntu")


def record(d, i, sensors):
    y = d.readings[i].copy()
    y[:, [k for k in range(5) if k + 1 not in sensors]] = np.nan
    return CellRecord(d.current**2, d.inlet, y, np.zeros_like(y))


def fit(row, d, i, before=None):
    """Fit of seed i, and the row's settings."""
    settings = CellSettings(
        spread={**CellSettings().spread, "R_e": row.spread}, joint_sd=row.joint or 0.03, ratio_sd=row.ratio_sd
    )

    def of(d, sensors, baseline=None):
        R, sd = None, None
        if row.joint is not None:
            e = electrical_resistance(d.current, d.voltage(i, row.joint))
            R, sd = e.value, e.with_skew(settings.skew_s)
        found = fit_cells(
            model(sensors),
            record(d, i, sensors),
            resistance=R,
            resistance_rel_sd=sd,
            baseline=baseline,
            settings=settings,
        )
        return found, R

    baseline = None
    if row.baseline:
        first, R = of(before, ALL)
        baseline = first.baseline(R)
    return of(d, row.sensors, baseline)[0]


def observe(row, d, fits):
    """Core errors (K, S, 5) and stated sd of the observer that runs on the fits."""
    S, K = len(d.seeds), len(d.current)
    m = model(row.sensors)
    observer = AdaptiveObserver([m] * S, 1.0)
    for i, f in enumerate(fits):
        n = numbers_of(m, f)
        observer.set_parameters(i, n.values, n.names, n.common, n.own)
    nothing, age = np.full((S, 5), np.nan), np.zeros((S, 5))
    off = [k for k in range(5) if k + 1 not in row.sensors]
    core, sd = np.empty((K, S, 5)), np.empty((K, S, 5))
    for k in range(K):
        y = d.readings[:, k].copy()
        y[:, off] = np.nan
        e = observer.step(np.full(S, d.current[k] ** 2), nothing, np.full(S, d.inlet[k + 1]), y, age)
        core[k], sd[k] = e.core, e.core_sd
    return (core - d.core.transpose(1, 0, 2)[1:])[WARM_UP:], sd[WARM_UP:]


def measure(row, d, before=None):
    """One line of figures, all relative ones as shares."""
    start = time.process_time()
    fits = [fit(row, d, i, before) for i in range(len(d.seeds))] if row.fitted else []
    cpu = (time.process_time() - start) / len(d.seeds)
    error, sd = observe(row, d, fits)
    hot = error[:, :, 1:4] if row.sensors == ENDS else error
    out = {
        "row": row.name,
        "core_rmse_K": float(np.sqrt(np.mean(hot**2))),
        "core_coverage": float(np.mean(np.abs(error) < 1.96 * sd)),
        "cpu_s": cpu,
    }
    if fits:
        R = np.array([f.R_e for f in fits])
        rel = np.array([f.rel_sd for f in fits])
        e = np.log(R / d.R_e)
        out |= {
            "R_e_sd": float(np.sqrt(np.mean(rel**2))),
            "R_e_sd_worst_cell": float(np.sqrt(np.mean(rel**2, axis=0)).max()),
            "R_e_rms": float(np.sqrt(np.mean(e**2))),
            "R_e_bias": float(np.mean(e)),
            "R_e_coverage": float(np.mean(np.abs(e) < 1.96 * rel)),
            "level": float(np.median([f.level for f in fits])),
        }
    failed = []
    if row.sd is not None and max(out["R_e_sd"], out["R_e_rms"]) > row.sd:
        failed.append(f"R_e sd above {100 * row.sd:g} %")
    if row.core is not None and out["core_rmse_K"] > row.core:
        failed.append(f"core above {row.core:g} K")
    if row.covered and not 0.90 <= out["R_e_coverage"] <= 0.99:
        failed.append("coverage of R_e outside 0.90 to 0.99")
    return out | {"failed": failed, "promised": row.sd is not None}


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--seeds", type=int, default=60)
    arguments.add_argument("--base", type=int, default=BASE)
    arguments.add_argument("--rows", default="", help="only those whose name holds this")
    arguments.add_argument("--json", action="store_true")
    given = arguments.parse_args()
    seeds = range(given.base, given.base + given.seeds)
    rows = [row for row in ROWS if given.rows in row.name]
    names = {row.drive for row in rows} | {"before" for row in rows if row.baseline}
    logs = {name: drives(seeds, **DRIVES[name]) for name in sorted(names)}
    print(f"{given.seeds} seeds, 5 cells, 89 min; R_e in %, cores of the unread cells")
    print(f"{'':38} {'sd':>5} {'worst':>6} {'rms':>5} {'bias':>5} {'cover':>6} {'core':>6} {'cover':>6} {'CPU':>5}")
    lines = []
    for row in rows:
        line = measure(row, logs[row.drive], logs.get("before"))
        lines.append(line)
        figures = [line.get(k) for k in ("R_e_sd", "R_e_sd_worst_cell", "R_e_rms", "R_e_bias")]
        text = " ".join("    -" if x is None else f"{100 * x:5.1f}" for x in figures)
        cover = line.get("R_e_coverage")
        print(
            f"{row.name:38} {text} {'     -' if cover is None else f'{cover:6.2f}'} {line['core_rmse_K']:4.2f} K "
            f"{line['core_coverage']:6.2f} {line['cpu_s']:4.1f}s  {'; '.join(line['failed'])}",
            flush=True,
        )
    if given.json:
        print(json.dumps(lines))
    return 1 if any(line["failed"] and line["promised"] for line in lines) else 0


if __name__ == "__main__":
    sys.exit(main())
