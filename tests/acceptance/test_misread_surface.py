"""Cores of a string one of whose thermocouples reads too much or too little, on the road that a user has."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.honesty_road import ROOT, drive_through
from tests.benchmarks.honesty_simulated import Drive, SimulatedDrive
from tests.truth.hidden import Scenario, make_logs

LATE_S = 1300.0
"""A window of twenty minutes has been fitted."""


@pytest.mark.slow
@pytest.mark.parametrize(("size", "cell", "seed", "most_K"), [("medium", 1, 1, 1.3), ("strong", 3, 3, 3.0)])
def test_cores_stay_within_their_band_although_a_thermocouple_misreads(
    size: str, cell: int, seed: int, most_K: float
) -> None:
    # Bug: windows took the error for R_c, or learnt nothing, and the observer believed it: cores 3 to 9 K off.
    hidden = {"thermocouple_offset": (size, cell)}
    s = Scenario(hidden, 5, (1, 3, 5), noise=0.05, step=0.1, cycle="urban", seed=seed, seconds=3000)
    case = SimulatedDrive(Drive("misread", s), make_logs([s])[0])
    with tempfile.TemporaryDirectory() as tmp:
        folder = Path(tmp)
        config = case.write_config(folder / "config", "default")
        seen = drive_through(ROOT, case.write_table(folder), config, folder / "out")
    late = seen.time_s - seen.time_s[0] >= LATE_S
    true = np.column_stack([np.interp(seen.time_s[late], case.time_s, x) for x in case.core.T])
    error, sd = seen.core[late] - true, seen.sd[late]
    assert np.isfinite(error).all()
    assert np.mean(np.abs(error) <= 2.0 * sd) > 0.95
    assert np.sqrt(np.mean(error**2)) < most_K
    told = [e for e in seen.since if e != "thermocouple"]
    assert told == (["alert thermocouple"] if size == "strong" else [])
