"""Voltages that belong to lumps of series cells: modules of twelve cells with one thermocouple each."""

import tomllib

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.setup.proposals import proposed
from tests.setup.vehicles import CELLS, SERIES, Vehicle, drive, write

EACH = SERIES // CELLS


def modules(names: str, *, whole: bool = False) -> Vehicle:
    """A pack of eight modules; `names` of the cells' messages and signals takes the module (from 1) and the cell."""
    d = drive(31)
    lines = ['VERSION ""', "BU_: B", "BO_ 256 Pack: 8 B",
             ' SG_ PackCurrent : 0|16@1- (0.1,0) [-1000|1000] "A" B',
             ' SG_ PackVoltage : 16|16@1+ (0.01,0) [0|600] "V" B',
             "BO_ 257 Temps: 8 B"]  # fmt: skip
    lines += [f' SG_ Module{k + 1}_Temp : {8 * k}|8@1+ (0.5,-40) [-40|80] "degC" B' for k in range(CELLS)]
    v = {"Pack.PackCurrent": d.current, "Pack.PackVoltage": d.voltage}
    v |= {f"Temps.Module{k + 1}_Temp": d.surface[:, k] for k in range(CELLS)}
    period = {"Temps": 1.0}
    if whole:
        lines += ["BO_ 260 Extremes: 8 B", ' SG_ MaxCellVoltage : 0|16@1+ (0.001,0) [0|6] "V" B']
        v["Extremes.MaxCellVoltage"] = d.cell_voltage.max(axis=1)
        for half in range(2):
            lines.append(f"BO_ {258 + half} Volts{half}: 8 B")
            for j in range(4):
                k = 4 * half + j
                lines.append(f' SG_ Module{k + 1}_Voltage : {16 * j}|16@1+ (0.001,0) [0|65] "V" B')
                v[f"Volts{half}.Module{k + 1}_Voltage"] = d.cell_voltage[:, EACH * k : EACH * (k + 1)].sum(axis=1)
    else:
        for m in range(SERIES // 4):
            lines.append(f"BO_ {300 + m} CV{m}: 8 B")
            for j in range(4):
                k = 4 * m + j
                name = names.format(module=k // EACH + 1, cell=k % EACH + 1, of_all=k + 1)
                lines.append(f' SG_ {name} : {16 * j}|16@1+ (0.001,0) [0|6] "V" B')
                v[f"CV{m}.{name}"] = d.cell_voltage[:, k]
            period[f"CV{m}"] = 1.0
    return Vehicle("modules", "\n".join(lines), v, period, {})


def test_the_cell_nearest_to_the_mean_of_its_module_stands_for_it(tmp_path) -> None:
    vehicle = modules("Module{module}_Cell{cell}_Voltage")
    p = proposed(vehicle, tmp_path)
    own = {q.index: q for q in p.of("cell_voltage") if q.string == 1}
    assert sorted(own) == list(range(1, CELLS + 1))
    for k, q in own.items():
        assert f"Module{k}_Cell" in q.path
        assert not q.sure
        assert f"one of the {EACH} cells of the module of Temps.Module{k}_Temp" in "; ".join(q.why)
        mine = np.array([x for name, x in vehicle.values.items() if f".Module{k}_Cell" in name])
        error = np.abs(mine - mine.mean(axis=0)).mean(axis=1)
        of_it = np.abs(vehicle.values[q.path] - mine.mean(axis=0)).mean()
        assert of_it <= np.sort(error)[2]
    assert sum(q.string is None for q in p.of("cell_voltage")) == SERIES - CELLS


def test_where_no_name_tells_the_module_no_voltage_belongs_to_a_lump(tmp_path) -> None:
    p = proposed(modules("CellVoltage{of_all}"), tmp_path)
    assert len(list(p.of("cell_voltage"))) == SERIES
    assert all(q.string is None for q in p.of("cell_voltage"))


def test_the_voltage_of_a_module_over_its_cells_is_that_of_a_cell(tmp_path, capsys) -> None:
    log, dbc = write(modules("", whole=True), tmp_path)
    assert (
        main(["init", str(log), "--dbc", str(dbc), "--out", str(tmp_path / "v"), "--cell", "21700 5Ah 30p", "--yes"])
        == 0
    )
    config = tomllib.loads((tmp_path / "v" / "gateway.toml").read_text())
    volts = config["string"][0]["signals"]["cell_voltage"]
    assert sorted(volts, key=int) == [str(k) for k in range(1, CELLS + 1)]
    for k in range(CELLS):
        half = k // 4
        assert volts[str(k + 1)] == {"signal": f"Volts{half}.Module{k + 1}_Voltage", "scale": pytest.approx(1 / EACH)}
    assert config["string"][0]["signals"]["voltage"]["scale"] == pytest.approx(1 / EACH)
    assert main(["check", str(tmp_path / "v" / "gateway.toml"), "--log", str(log)]) == 0, capsys.readouterr().out
