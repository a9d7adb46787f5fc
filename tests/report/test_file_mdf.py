"""MF4 files of decoded signals as tables: stamps of their own for each group, units, blanks, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from bms_gateway.bus.logfile import read_log
from bms_gateway.cli.main import main
from bms_gateway.errors import DataError
from bms_gateway.records.kind import log_kind
from bms_gateway.report.table import parse_columns, read_table

asammdf = pytest.importorskip("asammdf")

T = np.arange(0.0, 60.0, 0.5)
SLOW = np.arange(0.25, 60.0, 1.0)
AMPS = 40.0 * np.sign(np.sin(T / 5))
CELL = 25.0 + SLOW / 30
COLUMNS = "current_A=BMS.Strom,coolant_inlet_C=Vorlauf,surface_1_C=ZellTemp_1"


def write(path: Path, **more: object) -> Path:
    """Current at 2 Hz in mA; inlet in K and a thermocouple in °C at 1 Hz, each group with stamps of its own."""
    with asammdf.MDF() as made:
        made.append([asammdf.Signal(1000 * AMPS, T, name="BMS.Strom", unit="mA", **more)])
        made.append(
            [
                asammdf.Signal(np.full(len(SLOW), 293.15), SLOW, name="Vorlauf", unit="K"),
                asammdf.Signal(CELL, SLOW, name="ZellTemp_1", unit="degC"),
            ]
        )
        made.save(path, overwrite=True)
    return path.with_suffix(".mf4")


def test_each_signal_stands_at_its_own_stamps_in_the_unit_of_a_table(tmp_path) -> None:
    table = read_table(write(tmp_path / "a.mf4"), parse_columns([COLUMNS]))
    known, warm = np.isfinite(table.current_A), np.isfinite(table.surface_C[1])
    assert table.time_s[known] == pytest.approx(T)
    assert table.current_A[known] == pytest.approx(AMPS)
    assert table.time_s[warm] == pytest.approx(SLOW)
    assert table.surface_C[1][warm] == pytest.approx(CELL)
    assert table.coolant_inlet_C[warm] == pytest.approx(20.0)
    assert len(table) == len(T) + len(SLOW)
    assert "3 in 2 groups" in "; ".join(table.notes)


def test_a_minus_turns_the_sign_and_what_is_invalid_is_blank(tmp_path) -> None:
    bad = np.zeros(len(T), bool)
    bad[3:7] = True
    path = write(tmp_path / "a.mf4", invalidation_bits=bad)
    table = read_table(path, parse_columns([COLUMNS.replace("=BMS", "=-BMS")]))
    at = np.isin(table.time_s, T)
    assert np.array_equal(np.isnan(table.current_A[at]), bad)
    assert table.current_A[at][~bad] == pytest.approx(-AMPS[~bad])


def test_a_name_of_two_groups_is_told_by_its_group(tmp_path) -> None:
    with asammdf.MDF() as made:
        for k in (1, 2):
            made.append([asammdf.Signal(T + k, T, name="Temp", unit="degC")])
        made.save(tmp_path / "two.mf4")
    names = "current_A=Temp (group 1),coolant_inlet_C=20 °C,surface_1_C=Temp (group 2)"
    with pytest.raises(DataError, match=r"Temp \(group 1\)"):
        read_table(tmp_path / "two.mf4", parse_columns(["current_A=Temp,coolant_inlet_C=20 °C"]))
    table = read_table(tmp_path / "two.mf4", parse_columns([names.replace("(group 1)", "(group 1) [A]")]))
    assert table.current_A == pytest.approx(T + 1)
    assert table.surface_C[1] == pytest.approx(T + 2)


def test_it_is_no_log_and_raw_frames_are_no_table(tmp_path, data_of_css) -> None:
    assert log_kind(write(tmp_path / "a.mf4")) is None
    assert log_kind(data_of_css) == ".mf4"
    with pytest.raises(DataError, match="raw CAN frames, no table"):
        read_table(data_of_css)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7])
def test_one_that_is_cut_short_is_told_in_a_line(share: float, tmp_path) -> None:
    raw = write(tmp_path / "a.mf4").read_bytes()
    path = tmp_path / "cut.mf4"
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(DataError, match=r"cut.mf4: ") as told:
        read_table(path, parse_columns([COLUMNS]))
    assert "\n" not in str(told.value)


def test_an_older_mdf_is_told_by_its_version(tmp_path) -> None:
    path = tmp_path / "old.mf4"
    path.write_bytes(b"MDF     3.30    " + bytes(300))
    with pytest.raises(DataError, match=r"old.mf4: not a .mf4 log \(it is MDF 3.30: save it as MF4"):
        list(read_log(path))


def test_encode_takes_it_and_analyze_says_that_it_does(tmp_path, capsys) -> None:
    path = write(tmp_path / "a.mf4")
    config = Path(__file__).parents[2] / "deploy" / "worked" / "gateway.toml"
    pairs = COLUMNS + "," + ",".join(f"surface_{k}_C=ZellTemp_1" for k in (2, 3, 4))
    words = ["encode", str(path), "--config", str(config), "--out", str(tmp_path / "l.log")]
    assert main([*words, "--columns", pairs]) == 0
    assert (tmp_path / "l.log").stat().st_size > 1000
    capsys.readouterr()
    for command in (["analyze", str(path), "--config", str(config)], ["init", str(path)]):
        assert main([*command, "--out", str(tmp_path / "r")]) == 2
        told = capsys.readouterr().err.strip().splitlines()
        assert len(told) == 1
        assert "3 decoded signals, as BMS.Strom, Vorlauf, and no CAN frames: this is a table, no log" in told[0]
        assert "encode" in told[0]


@pytest.fixture
def data_of_css() -> Path:
    from tests.data import need

    return need("conformance", "asammdf_css", "17BD1DB7_00000006_00000170.MF4")
