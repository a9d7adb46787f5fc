"""A vehicle that sends temperatures in steps of 1 K and no cooling: its cores stay inside the band at a light load.

The truth is an integrator of two nodes per cell of this file. A reading that stands still is off by up to half a step
for as long as it stands, so averages over many samples are no better than one.
"""

import csv
import struct
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from bms_gateway.cli.main import main
from bms_gateway.thermal.cells import cell_of, stated_parameters

CELL = "21700 5Ah 69g 25mOhm 6p"
START_S, MINUTES = 1_700_000_000, 15
DBC = """VERSION ""
BU_: B
BO_ 801 BMS_Msg1: 8 B
 SG_ PackCurrent : 0|32@1- (0.001,0) [0|0] "A" B
 SG_ PackVoltage : 32|32@1+ (0.001,0) [0|0] "V" B
BO_ 802 BMS_Msg2: 8 B
 SG_ PackSOC : 0|16@1+ (0.01,0) [0|100] "%" B
 SG_ CellTemp1 : 16|8@1- (1,0) [-40|120] "degC" B
 SG_ CellTemp2 : 24|8@1- (1,0) [-40|120] "degC" B
 SG_ CellTemp3 : 32|8@1- (1,0) [-40|120] "degC" B
"""


def scooter(folder, seed: int) -> np.ndarray:
    """Write log and DBC of fourteen cells in series, three with a thermocouple; return the cores (n, 3) at 10 Hz."""
    rng, n = np.random.default_rng(seed), MINUTES * 600
    told = stated_parameters(replace(cell_of(CELL), cooling="forced"))
    C_c, C_s, R_e, R_c, R_u = (
        told[k].value * np.exp(0.6 * told[k].rel_sd * rng.normal()) for k in ("C_c", "C_s", "R_e", "R_c", "R_u")
    )
    level = np.repeat(0.5 * rng.choice([0, 5, 15, 40, -8, 25], n // 150 + 1), 150)[:n]
    current = np.convolve(level, np.ones(15) / 15, "same")
    air = 20 + rng.normal() * 6
    soc = 0.9 - np.cumsum(current) * 0.1 / 3600 / 30
    voltage = 14 * (3.3 + 0.8 * soc - current * R_e * 0.85)
    own_e, own_u = R_e * (1 + 0.04 * rng.normal(size=3)), R_u * (1 + 0.08 * rng.normal(size=3))
    core, skin, cores, lines = np.full(3, air), np.full(3, air), np.empty((n, 3)), []
    for k in range(n):
        flow = (core - skin) / R_c
        core = core + 0.1 * (current[k] ** 2 * own_e - flow) / C_c
        skin = skin + 0.1 * (flow - (skin - air) / own_u) / C_s
        cores[k] = core
        data = struct.pack("<iI", round(1e3 * current[k]), round(1e3 * voltage[k]))
        lines.append(f"({START_S + k / 10:.6f}) can0 321#{data.hex()}")
        if k % 10 == 0:
            data = struct.pack("<H3b", int(soc[k] * 1e4), *np.rint(skin + 0.05 * rng.normal(size=3)).astype(int))
            lines.append(f"({START_S + k / 10 + 0.001:.6f}) can0 322#{data.hex()}")
    (folder / "scooter.log").write_text("\n".join(lines) + "\n")
    (folder / "scooter.dbc").write_text(DBC)
    return cores


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 21])
def test_cores_are_inside_the_band_while_readings_in_steps_of_a_kelvin_stand_still(tmp_path, seed):
    cores, log, out = scooter(tmp_path, seed), str(tmp_path / "scooter.log"), tmp_path / "v"
    words = ["--dbc", str(tmp_path / "scooter.dbc"), "--cell", CELL, "--out", str(out), "--yes"]
    assert main(["init", log, *words]) == 0
    model = tomllib.loads((out / "string_1.toml").read_text())
    assert model["tolerances"]["surface_offset_K"] == pytest.approx(np.hypot(0.05, 1 / np.sqrt(12)), abs=0.01)
    assert main(["analyze", log, "--config", str(out / "gateway.toml"), "--out", str(out / "r")]) == 0
    inside, sds = [], []
    with (out / "r" / "estimates.csv").open() as file:
        for row in csv.DictReader(file):
            second = float(row["time_s"]) - START_S
            if second >= 300 and row["core_C"]:
                truth = cores[min(int(second * 10) - 1, len(cores) - 1), int(row["cell"]) - 1]
                sds.append(float(row["core_sd_K"]))
                inside.append(abs(float(row["core_C"]) - truth) <= 2 * sds[-1])
    assert len(inside) > 1500
    assert np.mean(inside) >= 0.95
    assert np.median(sds) < 0.5  # no wider than rounding makes it
