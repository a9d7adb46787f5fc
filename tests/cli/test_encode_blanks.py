"""What a table does not say never leaves `encode` as a measurement."""

import numpy as np
import pytest

from bms_gateway.cli.main import main
from tests.cli.encoded import decode, put, words_of
from tests.config.files import MAPPED, OWN, write


def test_a_blank_is_no_measurement_where_a_signal_cannot_say_not_available(tmp_path):
    """Blank currents once left as 0 A, and 40 A that the table did not show: heat that the gateway never saw."""
    table = put(tmp_path, [f"{t},{'' if 20 <= t < 40 else 10},25,26,27,28" for t in range(60)])
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    assert main(["encode", table, *words_of(config, log)]) == 0
    got = decode(log, config)
    time, mA = got["Pack.Current"]
    assert np.all(mA == -10_000.0)
    assert not np.any((time > 21.0) & (time < 40.0))
    assert np.any(time < 20.0)
    assert np.any(time > 41.0)
    assert np.all(got["Pack.Voltage"][1] > 600_000)  # the table has no voltage: outside the range of the DBC
    assert np.all(got["Pack.Soc"][1] > 100)


def test_a_sensor_without_values_makes_no_alert(tmp_path, capsys):
    table = put(tmp_path, [f"{t},5,25,26,,28" for t in range(120)])
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    assert main(["encode", table, *words_of(config, log)]) == 0
    assert "surface_3_C has no values: no measurement of it is sent" in capsys.readouterr().err
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "results")]) == 0
    alerts = (tmp_path / "results" / "alerts.jsonl").read_text()
    assert '"heat' not in alerts
    assert '"alarm"' not in alerts


def test_what_the_log_lacks_is_told(tmp_path, capsys):
    """Nothing was said of columns that are not there, and `analyze` then complained of their signals."""
    table = put(tmp_path, [f"{t},5,25,26,,28" for t in range(120)])
    log, config = (
        tmp_path / "a.log",
        write(tmp_path, MAPPED.replace('3 = { signal = "Temps.T3"', '3 = { signal = "Temps.T2"')),
    )
    assert main(["encode", table, *words_of(config, log)]) == 0
    told = capsys.readouterr().err
    assert "no column voltage_V: its signal is sent as 6553.5 V, which the gateway refuses: out of its range" in told
    short = "at its lower rail, as a short circuit or a missing sensor reads"
    assert f"surface_3_C has no values: its signal is sent as -99.5 °C, which the gateway refuses: {short}" in told
    assert main(["analyze", str(log), "--config", str(config), "--out", str(tmp_path / "results")]) == 0
    told = capsys.readouterr().out
    assert f"surface of cell 3 not used: {short} (Temps.T2)" in told
    assert "string_1.voltage (Pack.Voltage) refused 100 %" in told
    assert "all its bits are one in each frame" in told


def test_what_the_log_lacks_of_our_own_dbc_is_told_in_one_line(tmp_path, capsys):
    table = put(tmp_path, [f"{t},5,25,26,27,28" for t in range(20)])
    assert main(["encode", table, *words_of(write(tmp_path, OWN), tmp_path / "a.log")]) == 0
    told = capsys.readouterr()
    lacks = "no column voltage_V, soc, coolant_flow_m3_s, cell_voltage_1_V and 4 more: their signals are sent as"
    assert f"{lacks} not available" in told.out
    assert told.err == ""


@pytest.mark.parametrize("config", [OWN, MAPPED])
def test_a_table_of_blanks_alone_is_refused(tmp_path, capsys, config):
    table = put(tmp_path, [f"{t},,,,," for t in range(20)])
    assert main(["encode", table, *words_of(write(tmp_path, config), tmp_path / "a.log")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert f"{table}: no row has a value of current_A, coolant_inlet_C, voltage_V, soc" in told
    assert not (tmp_path / "a.log").exists()


@pytest.mark.parametrize(
    ("row", "column", "signal"), [("5,25", "coolant_flow_m3_s", "Pack.Flow"), (",25", "current_A", "Pack.Current")]
)
def test_a_table_is_refused_where_a_blank_could_only_be_sent_as_a_measurement(tmp_path, capsys, row, column, signal):
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    vehicle = tmp_path / "vehicle.dbc"
    if column == "coolant_flow_m3_s":
        vehicle.write_text(vehicle.read_text().replace("[0|25]", "[0|0]"))
    table = put(tmp_path, [f"{t},{row},26,27,28" for t in range(10)])
    assert main(["encode", table, *words_of(config, log)]) == 2
    assert f"{column} has no values, {signal} cannot say so" in capsys.readouterr().err
    assert not log.exists()


def test_a_blank_row_is_not_bridged(tmp_path, capsys):
    """Rows of 10 s with blanks of 90 s: the last current was held for all of them, 85 A that nobody measured."""
    known = [t for t in range(0, 900, 10) if not 300 < t < 400]
    table = put(
        tmp_path,
        [f"{t},{10 if t in known else ''},25,{26 if t in (0, 890) else ''},27,28" for t in range(0, 900, 10)],
    )
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    assert main(["encode", table, *words_of(config, log)]) == 0
    got = decode(log, config)
    time = got["Pack.Current"][0]
    assert not np.any((time > 301.0) & (time < 400.0))
    assert np.any((time > 210.0) & (time < 300.0))
    assert "Temps.T1" not in got  # no line over 890 s of blank rows
    assert "Temps.T3" in got
    assert "frames of Pack are left out with all that they carry" in capsys.readouterr().err


def test_rows_that_come_at_times_of_their_own_are_no_blanks(tmp_path):
    """Two loggers in one table: each row has the readings of one of them."""
    rows = [f"{t},10,,,," if t % 5 else f"{t},,25,26,27,28" for t in range(600)]
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    assert main(["encode", put(tmp_path, rows), *words_of(config, log)]) == 0
    got = decode(log, config)
    assert len(got["Pack.Current"][0]) > 0.95 * 6000
    assert len(got["Temps.T1"][0]) > 0.95 * 600


def test_a_hole_of_the_charge_does_not_take_the_current_with_it(tmp_path):
    rows = [f"{t},10,25,26,27,28,{'' if 200 <= t < 320 else 0.5}" for t in range(600)]
    table = tmp_path / "t.csv"
    table.write_text("time_s,current_A,coolant_inlet_C,surface_1_C,surface_3_C,surface_5_C,soc\n" + "\n".join(rows))
    log, config = tmp_path / "a.log", write(tmp_path, MAPPED)
    assert main(["encode", str(table), *words_of(config, log)]) == 0
    got = decode(log, config)
    time, soc = got["Pack.Soc"]
    hole = (time > 201.0) & (time < 319.0)
    assert hole.sum() > 1000
    assert np.all(soc[hole] > 100.0)
    assert np.allclose(soc[~hole & (time > 1.0) & ((time < 199.0) | (time > 321.0))], 50.0)


TWO = """\
[bus]
channel = "vcan0"
dbc = ["two.dbc"]
[[string]]
name = "a"
model = "string_1.toml"
[string.signals]
current = "Two.CA"
coolant_inlet = { constant = 25.0 }
[string.signals.surface]
1 = "Two.TA1"
3 = "Two.TA3"
5 = "Two.TA5"
[[string]]
name = "b"
model = "string_1.toml"
[string.signals]
current = "Two.CB"
coolant_inlet = { constant = 25.0 }
[string.signals.surface]
1 = "Two.TB1"
3 = "Two.TB3"
5 = "Two.TB5"
"""
TWO_DBC = """\
VERSION "1.0"
NS_ :
BS_:
BU_: VEHICLE
BO_ 256 Two: 8 VEHICLE
 SG_ CA : 0|8@1- (0.5,0) [-64|63.5] "A" Vector__XXX
 SG_ CB : 8|8@1- (0.5,0) {range} "A" Vector__XXX
 SG_ TA1 : 16|8@1- (1,0) [-128|127] "degC" Vector__XXX
 SG_ TA3 : 24|8@1- (1,0) [-128|127] "degC" Vector__XXX
 SG_ TA5 : 32|8@1- (1,0) [-128|127] "degC" Vector__XXX
 SG_ TB1 : 40|8@1- (1,0) [-128|127] "degC" Vector__XXX
 SG_ TB3 : 48|8@1- (1,0) [-128|127] "degC" Vector__XXX
 SG_ TB5 : 56|8@1- (1,0) [-128|127] "degC" Vector__XXX
"""


@pytest.mark.parametrize(("limits", "refused"), [("[-50|50]", False), ("[-64|63.5]", True)])
def test_one_string_says_nothing_of_another_in_its_frames(tmp_path, capsys, limits, refused):
    """The other string had 0 A and 0.0 °C in every frame, and its cores came out good."""
    config = write(tmp_path, TWO)
    (tmp_path / "two.dbc").write_text(TWO_DBC.replace("{range}", limits))
    table = put(tmp_path, [f"{t},5,25,26,27,28" for t in range(30)])
    words = ["encode", table, "--string", "a", *words_of(config, tmp_path / "a.log")]
    assert main(words) == (2 if refused else 0)
    if refused:
        assert "the table says nothing of Two.CB, which another string" in capsys.readouterr().err
        return
    got = decode(tmp_path / "a.log", config)
    assert np.all(np.abs(got["Two.CB"][1]) > 50.0)
    assert np.all(got["Two.TB1"][1] == -128.0)
    assert np.all(got["Two.CA"][1] == 5.0)
