"""Bench data and virtual packs become frames that cantools reads back, whatever DBC they are mapped to."""

import csv
import json
import re
import warnings

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.cli.encoded import decode, put, words_of
from tests.config.bench_cell import write_bench_cell, write_bench_table
from tests.config.files import MAPPED, OWN, write
from tests.config.race_car import write_race_car
from tests.data import need

COLUMNS = "time_s,current_A,coolant_inlet_C,voltage_V,soc,coolant_flow_m3_s,surface_1_C,surface_3_C,surface_5_C"


@pytest.fixture
def table(tmp_path):
    """Half a minute of moving quantities, irregularly sampled."""
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.3, 1.4, 40))
    columns = [
        t,
        np.repeat(rng.uniform(-80, 160, 10), 4),
        20 + t / 30,
        np.full(40, 16.5),
        0.6 - t / 1000,
        np.full(40, 1.5e-4),
        25 + t / 7,
        26 - t / 9,
        27 + np.sin(t / 5),
    ]
    file = tmp_path / "bench.csv"
    np.savetxt(file, np.column_stack(columns), delimiter=",", header=COLUMNS, comments="", fmt="%.6f")
    return file, dict(zip(COLUMNS.split(","), columns, strict=True))


def held(t, rows, values):
    return values[np.searchsorted(rows, t, "right") - 1]


def test_our_own_dbc_carries_the_table_within_its_resolution(tmp_path, table, capsys):
    file, c = table
    log = tmp_path / "bench.log"
    config = write(tmp_path, OWN)
    assert main(["encode", str(file), "--config", str(config), "--out", str(log)]) == 0
    got = decode(log, config)
    t, current = got["string_1_electrical.current"]
    assert np.allclose(np.diff(t), 0.1)
    assert np.allclose(current, held(t, c["time_s"], c["current_A"]), atol=0.0006)
    for signal, column, resolution in [
        ("string_1_surface.surface_01", "surface_1_C", 0.01),
        ("string_1_surface.surface_03", "surface_3_C", 0.01),
        ("string_1_surface.surface_05", "surface_5_C", 0.01),
        ("string_1_coolant.coolant_inlet", "coolant_inlet_C", 0.01),
        ("string_1_coolant.soc", "soc", 2e-5),
        ("string_1_coolant.coolant_flow", "coolant_flow_m3_s", 1e-6),
    ]:
        t, value = got[signal]
        assert np.allclose(np.diff(t), 1.0)
        assert np.abs(value - np.interp(t, c["time_s"], c[column])).max() <= resolution * 0.501, signal
    assert got["string_1_electrical.current"][0][0] >= c["time_s"][0]
    assert got["string_1_electrical.current"][0][-1] <= c["time_s"][-1]
    assert got["string_1_electrical.counter"][1][:16].tolist() == [*range(15), 0]
    # cells that the table does not have are not available: all ones
    assert np.all(got["string_1_surface.surface_02"][1] > 300)


def test_the_users_dbc_carries_the_table_through_scale_sign_and_units(tmp_path, table):
    file, c = table
    log = tmp_path / "bench.log"
    config = write(tmp_path, MAPPED)
    assert main(["encode", str(file), "--config", str(config), "--out", str(log)]) == 0
    got = decode(log, config)
    t, mA = got["Pack.Current"]
    assert np.allclose(mA, -1e3 * held(t, c["time_s"], c["current_A"]), atol=5.01)
    t, F = got["Pack.InletF"]
    assert np.allclose(F, np.interp(t, c["time_s"], c["coolant_inlet_C"]) * 1.8 + 32, atol=0.0501)
    t, T3 = got["Temps.T3"]  # the user's offset of 0.5 is taken off again
    assert np.allclose(T3, np.interp(t, c["time_s"], c["surface_3_C"]) - 0.5, atol=0.00501)
    t, K = got["Temps.T5"]
    assert np.allclose(K, np.interp(t, c["time_s"], c["surface_5_C"]) + 273.15, atol=0.0501)
    assert np.all(got["Temps.T4"][1] == -100.0)  # nothing maps it: raw 0, its start value


def test_what_is_missing_is_sent_as_not_available_not_made_up(tmp_path):
    t = np.arange(60.0)
    rows = [f"{x},10,25,{'' if 15 <= x < 40 else 30}" for x in t]
    (tmp_path / "t.csv").write_text("time_s,current_A,coolant_inlet_C,surface_1_C\n" + "\n".join(rows) + "\n")
    config = write_bench_cell(tmp_path)
    log = tmp_path / "t.log"
    assert main(["encode", str(tmp_path / "t.csv"), "--config", str(config), "--out", str(log)]) == 0
    time, value = decode(log, config)["string_1_surface.surface_01"]
    hole = (time > 14.0) & (time < 40.0)
    assert np.all(value[hole] > 300)
    assert np.allclose(value[~hole], 30.0, atol=0.0051)


@pytest.mark.parametrize(("row", "column"), [("{},,25,26,27,28", "current_A"), ("{},5,25,26,,28", "surface_3_C")])
def test_a_column_without_a_value_is_told(tmp_path, capsys, row, column):
    path = put(tmp_path, [row.format(t) for t in range(20)])
    assert main(["encode", path, *words_of(write(tmp_path, OWN), tmp_path / "a.log")]) == 0
    assert capsys.readouterr().err.splitlines() == [
        f"bms-gateway: note: {path}: {column} has no values: its signal is sent as not available"
    ]


def test_the_same_table_gives_the_same_bytes(tmp_path, table):
    config = write(tmp_path, OWN)
    logs = [tmp_path / "a.log", tmp_path / "b.log"]
    for log in logs:
        assert main(["encode", str(table[0]), "--config", str(config), "--out", str(log)]) == 0
    assert logs[0].read_bytes() == logs[1].read_bytes()


@pytest.mark.parametrize(
    ("change", "words", "says"),
    [
        (("surface_3_C", "surface_4_C"), [], "no column 'surface_3_C', a sensor of string_1; did you mean 'surface_"),
        (("time_s,", "t,"), [], "no column 'time_s'"),
        ((",", ","), ["--columns", "curent_A=x"], "did you mean 'current_A'?"),
        ((",", ","), ["--columns", "soc=a", "--columns", "soc=b"], "soc is 'a' already; name it once"),
        ((",", ","), ["--string", "string_2"], "--string 'string_2' is not in the config; did you mean 'string_1'?"),
        ((",", ","), ["--strng", "string_2"], "unknown option '--strng'; did you mean '--string'?"),
    ],
)
def test_faults_of_encode_are_one_line(tmp_path, table, capsys, change, words, says):
    file = table[0]
    file.write_text(file.read_text().replace(*change))
    config = write(tmp_path, OWN)
    assert main(["encode", str(file), "--config", str(config), "--out", str(tmp_path / "a.log"), *words]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_a_time_below_zero_and_an_ambiguous_string_are_refused(tmp_path, table, capsys):
    two = OWN + '[[string]]\nname = "string_2"\nmodel = "string_1.toml"\n'
    words = ["encode", str(table[0]), "--out", str(tmp_path / "a.log"), "--config"]
    assert main([*words, str(write(tmp_path, two))]) == 2
    assert "--string is needed, the config has several; valid: string_1, string_2" in capsys.readouterr().err
    assert main([*words, str(tmp_path / "gateway.toml"), "--string", "string_2"]) == 0
    assert "string_2_electrical.current" in decode(tmp_path / "a.log", tmp_path / "gateway.toml")
    text = table[0].read_text().splitlines()
    table[0].write_text("\n".join([text[0], "-1" + text[1][text[1].index(",") :], *text[2:]]) + "\n")
    assert main([*words, str(write(tmp_path, OWN))]) == 2
    assert "a log cannot hold times below zero" in capsys.readouterr().err


def test_columns_that_mean_nothing_are_mentioned(tmp_path, table, capsys):
    file = table[0]
    file.write_text(file.read_text().replace("soc", "sok"))
    assert main(["encode", str(file), "--config", str(write(tmp_path, OWN)), "--out", str(tmp_path / "a.log")]) == 0
    assert "columns with unknown names are not used: sok" in capsys.readouterr().err


def test_the_bench_record_keeps_the_heat_of_its_raw_current(tmp_path):
    raw = np.genfromtxt(need("core_surface", "a123_26650_hev2_raw_current.csv"), delimiter=",", names=True)
    config = write_bench_cell(tmp_path, voltage=True)
    table = write_bench_table(tmp_path / "t.csv")
    log = tmp_path / "t.log"
    assert main(["encode", str(table), "--config", str(config), "--out", str(log)]) == 0
    got = decode(log, config)
    current = got["string_1_electrical.current"][1]

    def mean(x):  # of the trapezoid over the logged rows
        return float(np.trapezoid(x, raw["t_s"]) / np.ptp(raw["t_s"]))

    assert np.mean(current**2) == pytest.approx(mean(raw["I_A"] ** 2), rel=2e-3)
    assert current.mean() == pytest.approx(-mean(raw["I_A"]), abs=0.01)
    volts = got["string_1_electrical.voltage"][1]
    assert np.mean(current * (3.32 - volts)) == pytest.approx(mean(-raw["I_A"] * (3.32 - raw["V_V"])), rel=5e-3)


def test_simulate_writes_traffic_and_truth_that_belong_together(tmp_path, capsys):
    config = write(tmp_path, OWN)
    log, truth = tmp_path / "s.log", tmp_path / "truth.csv"
    words = ["simulate", "--config", str(config), "--out", str(log), "--truth", str(truth), "--duration", "700"]
    assert main([*words, "--seed", "3"]) == 0
    rows = list(csv.DictReader(truth.read_text().splitlines()))
    assert len(rows) == 701 * 5
    assert list(rows[0]) == ["time_s", "string", "cell", "core_C", "surface_C"]
    true = np.array([[float(r["time_s"]), float(r["surface_C"])] for r in rows if r["cell"] == "3"]).T
    t, read = decode(log, config)["string_1_surface.surface_03"]
    error = read - np.interp(t, *true)
    assert len(t) == 700
    assert error.std() == pytest.approx(0.1, rel=0.15)
    assert abs(error.mean()) < 0.02
    first = log.read_bytes()
    assert main([*words, "--seed", "3"]) == 0
    assert log.read_bytes() == first
    assert main([*words, "--seed", "4"]) == 0
    assert log.read_bytes() != first


def test_the_race_cars_dbc_carries_a_virtual_pack(tmp_path):
    config = write_race_car(tmp_path)
    log = tmp_path / "car.log"
    assert main(["simulate", "--config", str(config), "--out", str(log), "--duration", "5"]) == 0
    got = decode(log, config)
    assert len(got["BMU_stateBusHV.CurrentBusHV"][0]) >= 5
    temperatures = [got[f"BMU_ChannelTemp.TempChannel{k:02d}"][1] for k in range(1, 142)]
    assert all(len(x) == 5 and np.all((x > 10) & (x < 60)) for x in temperatures)


def test_a_log_can_only_be_candump(tmp_path, table, capsys):
    config = write(tmp_path, OWN)
    assert main(["encode", str(table[0]), "--config", str(config), "--out", str(tmp_path / "a.blf")]) == 2
    assert "candump" in capsys.readouterr().err


def test_values_that_the_dbc_cannot_carry_are_told(tmp_path, capsys):
    config = write(
        tmp_path,
        MAPPED.replace('"Pack.Current", scale', '"Pack.Voltage", scale').replace('voltage = "Pack.Voltage"', ""),
    )
    dbc = (tmp_path / "vehicle.dbc").read_text()
    (tmp_path / "vehicle.dbc").write_text(
        dbc.replace('"mV"', '""').replace("[0|600000]", "[0|600]").replace("(100,0)", "(0.1,0)")
    )
    table = put(tmp_path, [f"{t},{20 if t == 3 else -5},25,26,{900 if t > 6 else 27},28" for t in range(10)])
    words = ["encode", table, "--config", str(config), "--out", str(tmp_path / "a.log"), "--json", "-"]
    assert main(words) == 0  # scale = -1: 20 A would be -20 in an unsigned signal
    out, err = capsys.readouterr()
    assert "current_A: 1 of 10 rows, the first at line 5 (20), do not fit Pack.Voltage (-600 to 0)" in err.replace(
        "-0)", "0)"
    )
    assert "surface_3_C: 3 of 10 rows, the first at line 9 (900), do not fit Temps.T3 (-99.5 to 500.5)" in err
    assert [(x["column"], x["rows"]) for x in json.loads(out)["not_carried"]] == [("current_A", 1), ("surface_3_C", 3)]


@pytest.mark.parametrize(("every", "amps", "told"), [(60, 40, True), (60, 0, False), (2, 40, False)])
def test_a_current_that_steps_between_rows_far_apart_is_told(tmp_path, capsys, every, amps, told):
    rng = np.random.default_rng(3)
    rows = [f"{k * every},{20 + amps * rng.random():.2f},25,26,27,28" for k in range(20)]
    config, log = write(tmp_path, OWN), tmp_path / "a.log"
    assert main(["encode", put(tmp_path, rows), *words_of(config, log)]) == 0
    assert (f"rows that are {every} s apart" in capsys.readouterr().err) is told


def test_what_our_dbc_cannot_carry_leaves_as_not_available(tmp_path, capsys):
    table = put(tmp_path, [f"{t},5,25,26,{900 if t > 6 else 27},28" for t in range(10)])
    log, config = tmp_path / "a.log", write(tmp_path, OWN)
    assert main(["encode", table, "--config", str(config), "--out", str(log)]) == 0
    assert "surface_3_C: 3 of 10 rows" in (err := capsys.readouterr().err)
    assert "sent as not available" in err
    assert main(["encode", put(tmp_path, [f"{t},5,25,26,27,28" for t in range(10)]), *words_of(config, log)]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("config", [OWN, MAPPED])
@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            "50000,25,26,27,28",
            "current_A: 900 of 900 .*: are they in mA\\? A table takes A: --columns 'current_A=COLUMN \\[mA\\]'",
        ),
        ("-4500,25,26,27,28", "current_A: 900 of 900 values are outside .*: are they in mA\\? A table takes A"),
        (
            "50,298.15,299.15,300.15,301.15",
            "coolant_inlet_C: 900 .*: are they in K\\? A table takes °C: --columns 'coolant_inlet_C=COLUMN \\[K\\]'",
        ),
        (
            "1e308,25,26,27,28",
            "current_A: 900 of 900 values are outside [-0-9.]* to [0-9.]*, what .* believes; nothing",
        ),
    ],
)
def test_a_quantity_in_another_unit_is_refused_not_dropped(tmp_path, capsys, config, row, says):
    """Once all 900 values left as not available, with a note and status 0."""
    table, log = put(tmp_path, [f"{t},{row}" for t in range(900)]), tmp_path / "a.log"
    assert main(["encode", table, *words_of(write(tmp_path, config), log)]) == 2
    out, err = capsys.readouterr()
    assert re.search(says, err), err
    assert (out, err.count("\n"), log.exists()) == ("", 1, False)


def test_a_value_beyond_all_bounds_is_told_without_a_warning_of_numpy(tmp_path, capsys):
    table, log = put(tmp_path, [f"{t},{1e308 if t == 3 else 5},25,26,27,28" for t in range(10)]), tmp_path / "a.log"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["encode", table, *words_of(write(tmp_path), log)]) == 0
    assert "current_A: 1 of 10 rows, the first at line 5 (1e+308)" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("times", "says"),
    [
        ([1.7e12, 1.7e12 + 100], "looks like milliseconds"),
        ([1.7e15, 1.7e15 + 1e5], "looks like microseconds"),
        ([1.764e18, 1.764e18 + 1e9], "looks like nanoseconds"),
        ([1e300, 2e300], "looks like milliseconds"),
        ([0, 100, 200, 300], "looks like milliseconds, it must be in seconds: it goes on by 100"),
        ([*range(0, 100, 10), 1e6], "spans 11.6 days"),
        ([k / 3600 for k in range(900)], "looks like hours or days, it must be in seconds: 900 rows span 0.25 s"),
        ([45_000 + k / 86_400 for k in range(900)], "looks like hours or days"),
    ],
)
def test_times_that_are_no_seconds_are_refused_and_the_old_log_stays(tmp_path, capsys, times, says):
    config, log = write(tmp_path, OWN), tmp_path / "a.log"
    log.write_text("old")
    assert main(["encode", put(tmp_path, [f"{t!r},5,25,26,27,28" for t in times]), *words_of(config, log)]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert log.read_text() == "old"


ROW = "time_s,current_A,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C\n0,1,2,3,4,5\n1,1,2,3,4,5\n"


@pytest.mark.parametrize(
    ("name", "text", "kind"),
    [
        *((name, ROW, name[1 : 1 + 4].lower()) for name in ("a.log", "a.LOG.gz", "a.asc", "a.blf")),
        ("a.csv", "(1700000000.000000) can0 123#AABB\n", ".log"),
        ("a.txt", "(1700000000.000000) can0 123#AABB\n", ".log"),
        ("a.csv", "timestamp,arbitration_id,extended,remote,error,dlc,data\n", ".csv"),
        ("a.log.csv", ROW, None),
    ],
)
def test_a_log_is_not_taken_for_a_table(tmp_path, capsys, name, text, kind):
    config = write(tmp_path, OWN)
    (tmp_path / name).write_text(text)
    status = main(["encode", str(tmp_path / name), *words_of(config, tmp_path / "b.log")])
    if kind is None:
        assert status == 0
        return
    assert status == 2
    assert f"this is a {kind} log, frames already: use analyze or replay" in capsys.readouterr().err


@pytest.mark.parametrize(
    "columns", [["--columns", "time_s=t", "--columns", "current_A=-I"], ["--columns", "time_s=t,current_A=-I"]]
)
def test_columns_do_not_swallow_the_table(tmp_path, columns):
    table = tmp_path / "map.csv"
    table.write_text("t,I,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C\n0,5,25,26,27,28\n1,5,25,26,27,28\n")
    config, log = write(tmp_path, OWN), tmp_path / "a.log"
    assert main(["encode", *columns, str(table), *words_of(config, log)]) == 0
    assert np.allclose(decode(log, config)["string_1_electrical.current"][1], -5.0)


def test_help_names_the_columns_of_a_table(capsys):
    assert main(["encode", "--help"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ["coolant_inlet_C", "surface_K_C", "cell_voltage_K_V", "discharge positive"])
