"""A thermocouple that freezes for ten minutes on a drive, on the road that a user has."""

import csv
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.engine import Alerted, Engine, Estimated, drive
from tests.benchmarks.honesty_simulated import Drive, SimulatedDrive
from tests.truth.hidden import Scenario, make_logs

BEGINS_S, ENDS_S, CELL = 1500, 2100, 3


def freeze(table: Path) -> None:
    """Let the thermocouple repeat one reading."""
    rows = list(csv.reader(table.read_text().splitlines()))
    column = rows[0].index(f"surface_{CELL}_C")
    for row in rows[1 + BEGINS_S : 1 + ENDS_S]:
        row[column] = rows[1 + BEGINS_S][column]
    table.write_text("\n".join(",".join(row) for row in rows) + "\n")


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.01, 0.03, 0.05])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_frozen_thermocouple_is_no_heat_and_makes_no_core_wrong(seed: int, noise: float, tmp_path: Path) -> None:
    # Bug: its cell "heated by itself", or its thermocouple had "come loose", and windows did not prove their cores.
    s = Scenario({}, 5, (1, 3, 5), noise=noise, step=0.1, cycle="urban", seed=seed, seconds=3600)
    case = SimulatedDrive(Drive("frozen", s), make_logs([s])[0])
    config, log = case.write_config(tmp_path / "config", "default"), tmp_path / "drive.log"
    freeze(table := case.write_table(tmp_path))
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    loaded = load_config(config)
    engine = Engine(loaded.plan, loaded.database)
    estimated, told = [], []
    for e in drive(engine, read_log(log)):
        if isinstance(e, Estimated):
            estimated.append(e)
        elif isinstance(e, Alerted):
            told.append(e.change)
    time_s = np.array([e.time_ns * 1e-9 for e in estimated])
    late = time_s - time_s[0] >= BEGINS_S
    core, sd = (np.array([getattr(e, k) for e in estimated])[late] for k in ("core", "core_sd"))
    true = np.column_stack([np.interp(time_s[late] - time_s[0], case.time_s - case.time_s[0], x) for x in case.core.T])
    known = np.isfinite(core)
    assert known.mean() > 0.99
    assert np.mean(np.abs(core - true)[known] <= 2.0 * sd[known]) > 0.95
    assert {c.condition.cell for c in told if c.condition.name in ("thermocouple", "sensor")} <= {CELL}
    of_limits = {"core", "forecast", "surface"}
    assert {c.condition.name for c in told} <= of_limits | {"thermocouple", "sensor"}
    last = {c.condition.name: c.state for c in told}  # it is used again
    assert {last.get(name, "over") for name in ("thermocouple", "sensor")} == {"over"}
