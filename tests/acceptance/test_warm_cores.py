"""Cores of strings whose R_e falls as they warm, with model files that do not know it, on the road that a user has."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.bench_known_numbers import KnownDrive, scenario
from tests.benchmarks.honesty_road import ROOT, drive_through
from tests.benchmarks.honesty_simulated import Drive
from tests.truth.hidden import make_logs

LATE_S = 1300.0
"""A window of twenty minutes has been fitted."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed", "most_K"), [("resistance_temperature", 31, 0.6), ("nothing", 31, 1.0)])
def test_windows_find_the_resistance_of_warm_cores(name: str, seed: int, most_K: float) -> None:
    s = scenario(name, "strong", seed)
    case = KnownDrive(Drive(name, s), make_logs([s])[0])
    with tempfile.TemporaryDirectory() as tmp:
        folder = Path(tmp)
        seen = drive_through(ROOT, case.write_table(folder), case.config(folder, 0.01, "window"), folder / "out")
    late = seen.time_s - case.time_s[0] >= LATE_S
    true = np.column_stack([np.interp(seen.time_s[late], case.time_s, x) for x in case.core.T])
    error, sd = seen.core[late] - true, seen.sd[late]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < most_K
    assert np.mean(np.abs(error) <= 2.0 * sd) > 0.95
    assert np.sqrt(np.mean(sd**2)) < 2.5 * most_K
    assert not seen.told[late].any()
