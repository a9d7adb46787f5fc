"""A cell with an internal short, and what the windows of its string learn meanwhile, on the road that a user has."""

import csv
import json
from pathlib import Path

import pytest

from bms_gateway.cli.main import main
from tests.benchmarks.heat_case import PACKS, SENSORS, Case, make

UNITS = {"C_c": "J/K", "C_s": "J/K", "R_e": "Ohm", "R_c": "K/W", "R_u": "K/W", "R_cc": "K/W", "C_f": "W/K"}
CONFIG = """
[identify]
method = "window"
[[string]]
name = "cell"
model = "cell.toml"
[string.signals]
current = "string_1_electrical.current"
coolant_inlet = "string_1_coolant.coolant_inlet"
[string.signals.surface]
"""


def write(case: Case, folder: Path) -> tuple[Path, Path]:
    """Write table and config of a case; give their paths."""
    (made,) = make([case])
    numbers = "".join(
        f'{k} = {{ value = {v}, unit = "{UNITS[k]}", rel_sd = 0.1 }}\n' for k, v in PACKS[case.pack].items()
    )
    head = f'cells = {case.cells}\nsensors = {list(SENSORS)}\ncondition = "full"\neffects = []\n'
    (folder / "cell.toml").write_text(head + "[cell]\ncapacity_Ah = 8.0\n[parameters]\n" + numbers)
    surfaces = "".join(f'{k} = "string_1_surface.surface_{k:02d}"\n' for k in SENSORS)
    (config := folder / "gateway.toml").write_text(CONFIG + surfaces)
    with (table := folder / "drive.csv").open("w", newline="") as f:
        rows = csv.writer(f)
        rows.writerow(["time_s", "current_A", "coolant_inlet_C", *(f"surface_{k}_C" for k in SENSORS)])
        for k in range(case.seconds):
            surface = (round(made.y[k, j - 1], 2) for j in SENSORS)
            rows.writerow([k, round(made.current[k], 2), round(made.inlet[k], 2), *surface])
    return table, config


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 11])
def test_a_short_is_no_thermocouple_that_reads_too_much_and_no_wrong_model(seed: int, tmp_path: Path) -> None:
    # Bug: windows put the heat down to "constant errors" of two or three thermocouples, told as wrong, or to the model.
    case = Case("liquid", seed, 6300, "urban", "heat", 6, 6.0, at=2400, lasts=1800)
    table, config = write(case, tmp_path)
    log, out = tmp_path / "drive.log", tmp_path / "out"
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    assert main(["analyze", str(log), "--config", str(config), "--out", str(out)]) == 0
    told = [json.loads(line) for line in (out / "alerts.jsonl").read_text().splitlines()]
    own = [(a["name"], a["cell"], a["state"]) for a in told if a["name"] not in ("core", "surface", "forecast")]
    assert own == [("unexplained_heat", 6, "raised"), ("unexplained_heat", 6, "over")]
