"""Drives whose truth is made by `tests/truth`, as traffic of our own DBC, and what `analyze` makes of them."""

import csv
from pathlib import Path

import numpy as np

from bms_gateway.bus.traffic import SECOND, Traffic, lines, steps
from bms_gateway.cli.main import main
from bms_gateway.frames.batch import FrameBatch
from tests.truth.cycle import repeated
from tests.truth.string import C_F, TruthString, rk4, wavy_inlet

EPOCH_S = 1_700_000_000
NOISE_K = 0.1


def string_drive(minutes: int, seed: int, start_C: float, gap_K: float, cells: int = 12, **truth_values):
    """Current (K,), inlet (K+1,), cores and surfaces (K+1, n) of one string on the drive cycle, inlet ± 3 K."""
    current = repeated(minutes, seed)
    inlet = wavy_inlet(len(current), amplitude=3.0, period=300.0, phase=float(seed))
    truth = TruthString.of(cells, R_cc=4.0, C_f=C_F, **truth_values)
    core, surface = rk4(truth, current, inlet, (start_C + gap_K, start_C))
    return current, inlet, core, surface


def frames_of(plan, database, drives, seed: int) -> FrameBatch:
    """Traffic of the plan's strings, one drive each, noise on inlet and surfaces, stamped from `EPOCH_S`."""
    feeds = []
    for current, inlet, _, surface in drives:
        t = np.arange(len(inlet), dtype=float)
        feed = {("current", None): steps(t[:-1], current), ("coolant_inlet", None): lines(t, inlet)}
        feed |= {("surface", k + 1): lines(t, surface[:, k]) for k in range(surface.shape[1])}
        feeds.append(feed)
    stop = len(drives[0][0]) * SECOND
    b = Traffic(plan, database, noise_K=NOISE_K, seed=seed).between(feeds, 0, stop)
    return FrameBatch(b.time_ns + EPOCH_S * SECOND, b.can_id, b.length, b.data)


def analyze(log: Path, config: Path, out: Path) -> dict[str, np.ndarray]:
    """Run `analyze`; columns of estimates.csv as arrays, blanks NaN."""
    assert main(["analyze", str(log), "--config", str(config), "--out", str(out)]) == 0
    with (out / "estimates.csv").open() as f:
        rows = list(csv.DictReader(f))
    number = {k: np.array([float(r[k] or "nan") for r in rows]) for k in ("time_s", "core_C", "core_sd_K", "surface_C")}
    return number | {k: np.array([r[k] for r in rows]) for k in ("string", "cell", "quality")}
