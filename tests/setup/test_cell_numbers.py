"""Where the names of thermocouples have other numbers than the cells of the model, all says which is which."""

import json
import re

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config import shipped

SAID = "the cells have other numbers than the names of their thermocouples: "


@pytest.fixture
def gaps(tmp_path):
    """The shipped vehicle, with other numbers in the names of its four thermocouples."""

    def made(*names):
        dbc = shipped("deploy/worked/vehicle.dbc").read_text()
        if names:
            dbc = re.sub(r"CellTemp(\d\d)", lambda found: names[int(found[1]) - 1], dbc)
        (tmp_path / "v.dbc").write_text(dbc)
        log, out = str(shipped("deploy/worked/drive.log.gz")), tmp_path / "v"
        words = ["init", log, "--dbc", str(tmp_path / "v.dbc"), "--cell", "a123_32157", "--out", str(out), "--yes"]
        assert main(words) == 0
        return log, out

    return made


def test_numbers_with_gaps_are_told_in_the_text_the_files_and_the_result(gaps, capsys):
    log, out = gaps("CellTemp02", "CellTemp05", "CellTemp09", "CellTemp12")
    which = f"string_1: {SAID}1 = CellTemp02, 2 = CellTemp05, 3 = CellTemp09, 4 = CellTemp12"
    told = capsys.readouterr()
    assert f"note: {which}\n" in told.err
    assert "cell 2 of string_1 (BMS_CellTemps.CellTemp05)" in told.out
    assert f"# {which}\n" in (out / "gateway.toml").read_text()
    assert f"# {which}\n" in (out / "string_1.toml").read_text()
    words = ["analyze", log, "--config", str(out / "gateway.toml"), "--out", str(out / "r"), "--json", "-"]
    assert main(words) == 0
    told = capsys.readouterr()
    assert "cell 2 of string_1 (BMS_CellTemps.CellTemp05)" in told.err
    assert json.loads(told.out)["signals"]["BMS_CellTemps.CellTemp05"]["key"] == "string_1.surface.2"


def test_a_row_of_numbers_that_begins_later_is_told_in_short(gaps, capsys):
    _, out = gaps("CellTemp13", "CellTemp14", "CellTemp15", "CellTemp16")
    which = f"string_1: {SAID}1 to 4 = CellTemp13 to CellTemp16"
    assert f"note: {which}\n" in capsys.readouterr().err
    assert f"# {which}\n" in (out / "gateway.toml").read_text()


def test_one_channel_that_is_missing_parts_the_cells_into_two_runs(gaps, capsys):
    gaps("CellTemp01", "CellTemp02", "CellTemp04", "CellTemp05")
    assert f"{SAID}1 to 2 = CellTemp01 to CellTemp02, 3 to 4 = CellTemp04 to CellTemp05\n" in capsys.readouterr().err


@pytest.mark.parametrize("names", [(), ("CellTemp00", "CellTemp01", "CellTemp02", "CellTemp03")])
def test_numbers_from_one_or_zero_are_nothing_to_tell(gaps, capsys, names):
    _, out = gaps(*names)
    assert SAID not in capsys.readouterr().err
    assert SAID not in (out / "gateway.toml").read_text() + (out / "string_1.toml").read_text()
