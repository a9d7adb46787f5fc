"""Strings in parallel: each gets its own current, voltage, charge and thermocouples, or none is sure."""

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.load import load_config
from tests.setup.proposals import proposed
from tests.setup.vehicles import parallel, write


@pytest.mark.parametrize(
    "names",
    [
        ("String1", "String2"),
        ("StringA", "StringB"),
        ("strang_a", "strang_b"),
        ("BMSA", "BMSB"),
        ("packa", "packb"),
        ("ESSA", "ESSB"),
        ("ACCUA", "ACCUB"),
    ],
)
def test_each_string_gets_its_own(names, tmp_path) -> None:
    vehicle = parallel(names)
    found = proposed(vehicle, tmp_path)
    assert found.cells == [4, 4]
    for string, name in enumerate(names, 1):
        mine = {p.path: (p.role, p.index) for p in found.signals if p.string == string}
        assert mine == {path: what for path, what in vehicle.truth.items() if name in path}
    assert all(p.sure for p in found.signals)
    assert found.series_cells in (11, 12, 13)
    assert [r for r in found.remarks if "is a guess" in r and f"{found.series_cells} cells in series" in r]


def test_the_config_has_two_currents_and_the_share_of_each_voltage(tmp_path) -> None:
    log, dbc = write(parallel(), tmp_path)
    out = tmp_path / "out"
    assert main(["init", str(log), "--dbc", str(dbc), "--cell", "21700 5Ah", "--out", str(out), "--yes"]) == 0
    plan = load_config(out / "gateway.toml").plan
    text = (out / "gateway.toml").read_text()
    assert len(plan.strings) == 2
    for name in ("String1", "String2"):
        assert text.count(f'"{name}_Elec.{name}_Current"') == 1
    assert text.count("of the pack; the share of this string's cells") == 0
    assert text.count("the share of the cells with a thermocouple") == 2


def test_a_total_that_is_the_sum_of_all_changes_nothing(tmp_path) -> None:
    found = proposed(parallel(total=1.0), tmp_path)
    assert [p.path for p in found.of("current")] == ["String1_Elec.String1_Current", "String2_Elec.String2_Current"]
    assert all(p.sure for p in found.of("current"))


def test_a_total_that_is_no_sum_makes_none_sure(tmp_path) -> None:
    found = proposed(parallel(total=2.0), tmp_path)
    assert not any(p.sure for p in found.of("current"))
    assert any("Pack.TotalCurrent" in remark and "2 times their sum" in remark for remark in found.remarks)


def test_one_current_for_two_strings_is_not_sure(tmp_path) -> None:
    vehicle = parallel(total=1.0)
    vehicle.dbc = vehicle.dbc.replace("String1_Current", "ContactorFoo").replace("String2_Current", "PumpDuty")
    for old, new in (("String1_Elec.String1_Current", "ContactorFoo"), ("String2_Elec.String2_Current", "PumpDuty")):
        vehicle.values[f"{old.split('.')[0]}.{new}"] = vehicle.values.pop(old)
    found = proposed(vehicle, tmp_path)
    assert [(p.path, p.sure) for p in found.of("current")] == [("Pack.TotalCurrent", False)]
    assert any("strings in parallel" in remark for remark in found.remarks)
