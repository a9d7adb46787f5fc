"""Tables and logs become the same records, and what is wrong with them is one line."""

import argparse
from pathlib import Path

import numpy as np
import pytest

from bms_gateway.cli.main import Parser
from bms_gateway.cli.measurements import add_measurement_arguments, given_measurements
from bms_gateway.config.model_file import read_model
from bms_gateway.diagnosis.checks import check_record
from bms_gateway.errors import ConfigError, DataError, UsageError
from bms_gateway.records.read import read_measurements
from tests.cli.measured_tables import CELLS, MODEL, encoded, table
from tests.config.bench_cell import write_bench_table
from tests.config.files import MAPPED, OWN, write
from tests.config.model_texts import EXAMPLE
from tests.config.race_car import write_race_car
from tests.data import need


def test_a_table_and_the_log_made_of_it_are_the_same_record(tmp_path):
    config = write(tmp_path, OWN)
    file = table(tmp_path)
    (t,) = read_measurements([file], model=MODEL)
    (g,) = read_measurements([encoded(tmp_path, file, config)], model=MODEL, config=config)
    assert g.cells == t.cells == (1, 3, 5)
    assert g.drive.dt == t.drive.dt
    assert g.drive.known == t.drive.known
    assert g.segments == t.segments
    # frames lie up to a tenth of a second from the rows, so that steps may lie by half of that elsewhere
    n = min(g.drive.N, t.drive.N)
    off = g.instants[0] - t.instants[0]
    assert abs(off) < 0.15
    for name, resolution, late in [
        ("I", 0.001, 120 * 0.25),
        ("T_in", 0.01, 2.5),
        ("soc", 1e-4, 1e-3),
        ("V", 0.01, 0.2),
    ]:
        a, b = getattr(g.drive, name)[: n - 1], getattr(t.drive, name)[: n - 1]
        assert np.abs(a - b).max() <= resolution + late, name
        assert np.median(np.abs(a - b)) <= max(2 * resolution, 0.02), name
    assert g.drive.I2.mean() == pytest.approx(t.drive.I2.mean(), rel=0.005)
    assert g.drive.IV.mean() == pytest.approx(t.drive.IV.mean(), abs=0.5)
    assert g.drive.flow == pytest.approx(np.ones(g.drive.N), abs=0.01)
    for j in range(3):
        mine, theirs = g.sensor == j, t.sensor == j
        expected = np.interp(g.surface.at(g.instants)[mine], t.surface.at(t.instants)[theirs], t.y[theirs])
        assert np.abs(g.y[mine] - expected).max() <= 0.0051
    assert np.sum(g.held) == pytest.approx(np.sum(t.held), rel=0.02)


def test_scale_sign_unit_and_offset_of_the_mapping_hold(tmp_path):
    config = write(tmp_path, MAPPED)
    file = table(tmp_path, seconds=600, flow=2e-4)  # 12 l/min; Pack.Flow carries up to 25
    (t,) = read_measurements([file], model=MODEL)
    (g,) = read_measurements([encoded(tmp_path, file, config)], model=MODEL, config=config)
    assert g.drive.I2.mean() == pytest.approx(t.drive.I2.mean(), rel=0.005)
    assert g.drive.I.mean() == pytest.approx(t.drive.I.mean(), abs=0.3)
    assert np.nanmean(g.drive.V) == pytest.approx(np.nanmean(t.drive.V), abs=0.03)
    assert g.drive.T_in.mean() == pytest.approx(t.drive.T_in.mean(), abs=0.05)
    for j in range(3):
        assert g.y[g.sensor == j].mean() == pytest.approx(t.y[t.sensor == j].mean(), abs=0.02)


def test_every_file_is_a_record_of_its_own(tmp_path):
    files = [table(tmp_path, seconds=s, name=f"{s}.csv") for s in (600, 900)]
    assert [r.drive.N for r in read_measurements(files, model=MODEL)] == [600, 900]
    assert [Path(r.source).name for r in read_measurements(files, model=MODEL)] == ["600.csv", "900.csv"]


def test_the_arguments_reach_the_reader(tmp_path):
    file = table(tmp_path)
    file.write_text(file.read_text().replace("current_A", "I_charge", 1).replace("surface_3_C", "middle", 1))
    (tmp_path / "m.toml").write_text(EXAMPLE)
    parser = Parser("fit", "fit", "fit x")
    add_measurement_arguments(parser)
    words = [str(file), "--model", str(tmp_path / "m.toml"), "--columns", "current_A=-I_charge,surface_3_C=middle"]
    args = parser.parse(words)
    assert isinstance(args, argparse.Namespace)
    (r,) = given_measurements(args, read_model(args.model))
    assert r.cells == (1, 3, 5)
    kinds = {f.kind for f in check_record(r, MODEL)}
    assert "current_sign" in kinds


def test_cell_voltages_stand_in_for_the_string_s(tmp_path):
    file = table(tmp_path)
    head, *lines = file.read_text().splitlines()
    at = head.split(",").index("voltage_V")
    names = head.replace("voltage_V", "cell_voltage_1_V")
    cells = [",".join(f"{float(x) / CELLS:.4f}" if i == at else x for i, x in enumerate(s.split(","))) for s in lines]
    file.write_text("\n".join([names, *cells]))
    (r,) = read_measurements([file], model=MODEL)
    assert np.nanmean(r.drive.V) == pytest.approx(3.3, abs=0.05)


def test_columns_without_a_meaning_are_told(tmp_path):
    file = table(tmp_path)
    file.write_text(file.read_text().replace("voltage_V", "volts", 1))
    (r,) = read_measurements([file], model=MODEL)
    assert any("volts" in note for note in r.notes)


class TestRefusals:
    def test_a_log_without_a_config(self, tmp_path):
        log = encoded(tmp_path, table(tmp_path, seconds=60), write(tmp_path, OWN))
        with pytest.raises(UsageError, match=r"bench\.log: this is a \.log log: --config is needed"):
            read_measurements([log], model=MODEL)

    def test_a_string_that_is_not_in_the_config(self, tmp_path):
        config = write(tmp_path, OWN)
        log = encoded(tmp_path, table(tmp_path, seconds=60), config)
        with pytest.raises(UsageError, match=r"--string 'string_2' is not in .*did you mean 'string_1'"):
            read_measurements([log], model=MODEL, config=config, string="string_2")

    def test_a_string_without_a_config(self, tmp_path):
        with pytest.raises(UsageError, match="--string names a string of a gateway config"):
            read_measurements([table(tmp_path)], model=MODEL, string="string_1")

    def test_a_table_without_the_model_s_sensors(self, tmp_path):
        file = table(tmp_path)
        text = file.read_text()
        for k in (1, 3, 5):
            text = text.replace(f"surface_{k}_C", f"T_surf_{k}", 1)
        file.write_text(text)
        with pytest.raises(DataError, match="no column 'surface_1_C', nor of any other sensor"):
            read_measurements([file], model=MODEL)

    def test_a_log_with_nothing_of_the_string(self, tmp_path):
        config = write(tmp_path, OWN)
        log = tmp_path / "other.log"
        log.write_text("(1.000000) can0 123#00\n(2.000000) can0 123#00\n")
        with pytest.raises(
            DataError, match=r"other\.log: no frame carries a signal .* for string_1; expected string_1_"
        ):
            read_measurements([log], model=MODEL, config=config)

    def test_a_config_that_is_not_there(self, tmp_path):
        config = write(tmp_path, OWN)
        log = encoded(tmp_path, table(tmp_path, seconds=60), config)
        with pytest.raises(ConfigError):
            read_measurements([log], model=MODEL, config=tmp_path / "gatewey.toml")

    def test_milliseconds(self, tmp_path):
        file = table(tmp_path)
        head, *lines = file.read_text().splitlines()
        slow = [f"{float(s.split(',')[0]) * 1e3},{s.split(',', 1)[1]}" for s in lines]
        file.write_text("\n".join([head, *slow]))
        with pytest.raises(DataError, match="milliseconds"):
            read_measurements([file], model=MODEL)


def test_a_race_car_s_log_is_a_record_without_its_parked_channels(tmp_path):
    log = need("can", "uwfe_july7_run12.log.gz")
    config = write_race_car(tmp_path)
    model = read_model(tmp_path / "module_18.toml")
    (r,) = read_measurements([log], model=model, config=config, string="module_1")
    assert 7 not in r.cells
    assert len(r.cells) == 17
    assert 15 < r.y.min() < r.y.max() < 40
    found = {f.kind: f for f in check_record(r, model)}
    assert found["too_short"].severity == "stop"
    assert "one_direction" in found  # declared unsigned: it cuts charging off
    assert "219.3 A" in found["current_saturated"].sentence


def bench_model(tmp_path):
    single = tmp_path / "cell.toml"
    single.write_text(
        'cells = 1\nsensors = [1]\ncondition = "single"\n[cell]\ncapacity_Ah = 2.3\n[parameters]\n'
        + "".join(
            f'{k} = {{ value = {v}, unit = "{u}", rel_sd = 0.3 }}\n'
            for k, v, u in [
                *[("C_c", 76.0, "J/K"), ("C_s", 6.0, "J/K"), ("R_e", 12.0, "mOhm")],
                *[("R_c", 3.0, "K/W"), ("R_u", 4.8, "K/W")],
            ]
        )
    )
    return read_model(single)


def test_raw_stamps_and_ten_rows_a_second_of_one_drive_give_one_mean_square(tmp_path):
    slow = np.genfromtxt(need("core_surface", "a123_26650_hev2.csv"), delimiter=",", names=True)
    fast = np.genfromtxt(need("core_surface", "a123_26650_hev2_raw_current.csv"), delimiter=",", names=True)
    model = bench_model(tmp_path)
    merged = {t: ["", "", "", ""] for t in sorted({*slow["t_s"], *fast["t_s"]})}
    for t, amps, volts in zip(fast["t_s"], fast["I_A"], fast["V_V"], strict=True):
        merged[t][:2] = f"{-amps:.5f}", f"{volts:.5f}"
    for t, inlet, surface in zip(slow["t_s"], slow["T_amb_C"], slow["T_surf_C"], strict=True):
        merged[t][2:] = f"{inlet:.4f}", f"{surface:.4f}"
    file = tmp_path / "merged.csv"
    head = "time_s,current_A,voltage_V,coolant_inlet_C,surface_1_C"
    file.write_text("\n".join([head, *(f"{t:.5f},{','.join(x)}" for t, x in merged.items())]))
    raw, dense = read_measurements([file, write_bench_table(tmp_path / "dense.csv")], model=model)
    n = min(raw.drive.N, dense.drive.N)
    assert any("bursts" in note for note in raw.notes)
    assert raw.drive.I2.mean() == pytest.approx(dense.drive.I2.mean(), rel=0.003)
    assert raw.drive.I2.mean() == pytest.approx(128.9, abs=0.2)
    # a tenth of a second is as well as the dense table knows its steps
    assert np.abs(raw.drive.I[:n] - dense.drive.I[:n]).max() < 0.2 * 46
    heat = 3.3 * raw.drive.I.mean() - raw.drive.IV.mean()
    assert heat == pytest.approx(3.3 * dense.drive.I.mean() - dense.drive.IV.mean(), rel=0.02)


@pytest.mark.parametrize("name", ["a123_26650_hev2", "lfp_32113_insulated_1", "lfp_32113_uninsulated_2"])
def test_a_bench_cell_has_nothing_suspicious_and_its_core_is_kept_apart(tmp_path, name):
    file = need("core_surface", f"{name}.csv")
    model = bench_model(tmp_path)
    names = {"time_s": "t_s", "current_A": "-I_A", "voltage_V": "V_V", "coolant_inlet_C": "T_amb_C"}
    names |= {"surface_1_C": "T_surf_C", "core_1_C": "T_core_C"}
    (r,) = read_measurements([file], model=model, columns=names)
    assert r.core.cells == (1,)
    assert r.drive.known == {"soc", "voltage"}
    assert not [f for f in check_record(r, model) if f.severity != "note"]
