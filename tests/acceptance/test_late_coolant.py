"""Coolant that changes at its sensor and reaches the cells later: no fault is told, and the cores stay in their bands.

Strings and cells of the independent truth whose inlet steps by several kelvin; a delay is hidden from the model.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.honesty_road import drive_through
from tests.benchmarks.honesty_simulated import Drive, simulated
from tests.truth.suites import suited

ROOT = Path(__file__).resolve().parents[2]
FAULTS = {"cooling", "inlet", "unexplained_heat", "thermocouple", "missing_heat", "core", "surface", "runaway"}
SENSORS = {1: (1,), 5: (1, 3, 5), 8: (1, 4, 8)}


@pytest.mark.plain_cases(2)
@pytest.mark.parametrize(
    ("size", "cells", "seed"),
    [("medium", 5, 202817044), ("strong", 1, 202817138), ("medium", 8, 71), ("medium", 5, 72), ("strong", 1, 73)],
)
def test_a_delayed_step_of_the_coolant_is_no_fault(size, cells, seed, tmp_path):
    scenario = suited({"coolant_delay": size}, cells, seed, reading=(0.05, 0.1))
    scenario = replace(scenario, effects={"coolant_delay": (size, None)}, sensors=SENSORS[cells])
    stated, off, told = followed(Drive("", scenario), tmp_path)
    assert told == []
    assert np.isfinite(off).all()
    assert np.mean(np.abs(off) < 2.0 * stated) > 0.9
    assert np.sqrt(np.mean(off**2)) < 6.0


def followed(drive, folder):
    """Sd stated for each core (K, n) and how far the core is off, K, from minute ten on; sentences of faults told."""
    (case,) = simulated([drive])
    table, config = case.write_table(folder), case.write_config(folder / "config", "default")
    stated = drive_through(ROOT, table, config, folder / "out")
    alerts = [json.loads(line) for line in (folder / "out" / "alerts.jsonl").read_text().splitlines()]
    core = np.stack([np.interp(stated.time_s, case.time_s, c) for c in case.core.T], axis=1)
    late = stated.time_s >= stated.time_s[0] + 600.0
    return stated.sd[late], (stated.core - core)[late], [a["text"] for a in alerts if a["name"] in FAULTS]
