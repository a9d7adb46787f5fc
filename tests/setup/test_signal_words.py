"""Names and units as makers write them."""

import numpy as np
import pytest

from bms_gateway.setup.signal_words import unit_of, words
from tests.setup.proposals import proposed
from tests.setup.vehicles import Vehicle, drive


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("BMSmaxPackTemperature", "bms max pack temperature"),
        ("SOCave292", "soc ave 292"),
        ("BAT_Kuehlmitteltemp", "bat kuehlmittel temp"),
        ("bms_celltempmax", "bms cell temp max"),
        ("hvcurrent", "hv current"),
        ("Tmot", "t mot"),
        ("Ibat", "ibat"),
        ("template", "template"),
        ("ZuiGaoDanTiDianYa", "zuigao danti dianya"),
        ("zongdianliu", "zong dianliu"),
        ("DCLinkVoltage", "dc link voltage"),
        ("PowerState", "power state"),
    ],
)
def test_a_name_is_cut_into_known_words(name: str, expected: str) -> None:
    assert " ".join(words(name)) == expected


@pytest.mark.parametrize("unit", ["Unit_DegreCelsi", "degrees C", "oC", "Grad C", "℃", "¡æ", "â„ƒ", "Celsius degrees"])
def test_celsius_is_read_however_it_is_spelt(unit: str) -> None:
    found = unit_of(unit)
    assert found is not None
    assert (found.family, found.factor, found.offset) == ("temperature", 1.0, 0.0)


@pytest.mark.parametrize(("unit", "family"), [("degrees", "other"), ("cm", "other"), ("Cycles", None), ("CC", None)])
def test_what_only_looks_like_celsius_is_none(unit: str, family: str | None) -> None:
    found = unit_of(unit)
    assert (found.family if found else None) == family


@pytest.mark.parametrize(("unit", "factor"), [("Unit_Amper", 1.0), ("mAmp", 1e-3), ("milliamps", 1e-3)])
def test_ampere_is_read_however_it_is_spelt(unit: str, factor: float) -> None:
    found = unit_of(unit)
    assert found is not None
    assert (found.family, found.factor) == ("current", factor)


LINES = """VERSION ""
BU_: X
BO_ 300 BMS_Main: 8 X
 SG_ BattCurrent : 0|16@1- (0.1,0) [0|0] "A" X
 SG_ BattVoltage : 16|16@1+ (0.1,0) [0|0] "V" X
 SG_ {share} : 32|16@1+ (0.01,0) [0|0] "%" X
BO_ 301 BMS_Temps: 8 X
 SG_ CellTemp1 : 0|8@1+ (0.5,-40) [0|0] "degC" X
 SG_ CellTemp2 : 8|8@1+ (0.5,-40) [0|0] "degC" X
BO_ 302 Thermal: 8 X
 SG_ {one} : 0|16@1- (0.1,0) [0|0] "degC" X
 SG_ {other} : 16|16@1- (0.1,0) [0|0] "degC" X
"""


def roles(folder, share: str, one: str, other: str, rising: bool = False) -> dict[str, tuple[str, bool]]:
    """Role of each signal and whether it is sure; `other` is warmer than `one`."""
    d = drive(41)
    drawn = np.cumsum(d.current) / np.cumsum(d.current).max()
    values = {
        "BMS_Main.BattCurrent": d.current,
        "BMS_Main.BattVoltage": d.voltage,
        f"BMS_Main.{share}": 60.0 + 20.0 * drawn if rising else 80.0 - 20.0 * drawn,
        "BMS_Temps.CellTemp1": d.surface[:, 0],
        "BMS_Temps.CellTemp2": d.surface[:, 1],
        f"Thermal.{one}": d.inlet,
        f"Thermal.{other}": d.inlet + 3.0,
    }
    vehicle = Vehicle("named", LINES.format(share=share, one=one, other=other), values, {}, {})
    return {p.series.info.name: (p.role, p.sure) for p in proposed(vehicle, folder).signals}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("GlycolFeed", "GlycolReturn"),
        ("BrineIn_T", "BrineOut_T"),
        ("CoolantFlowTemp", "CoolantReturnTemp"),
        ("WasserVorlauf", "WasserRuecklauf"),
        ("CoolantUpstreamTemp", "CoolantDownstreamTemp"),
        ("KuehlwasserVL", "KuehlwasserRL"),
    ],
)
@pytest.mark.plain_cases(3)
def test_the_end_where_the_coolant_enters_is_taken(one: str, other: str, tmp_path) -> None:
    found = roles(tmp_path, "SOC", one, other)
    assert found[one][0] == "coolant_inlet"
    assert other not in found


@pytest.mark.parametrize("name", ["TransmissionFluidTemp", "WasherFluidTemp", "GlycolReturn", "CoolantOutflowT"])
@pytest.mark.plain_cases(2)
def test_another_liquid_is_never_taken_for_sure(name: str, tmp_path) -> None:
    assert not roles(tmp_path, "SOC", name, "MotorTemp").get(name, ("", False))[1]


@pytest.mark.parametrize("name", ["BMS_Gauge", "BatteryLevel", "PackRemaining"])
@pytest.mark.plain_cases(1)
def test_a_level_of_the_battery_that_falls_as_current_is_drawn_is_likely_the_charge(name: str, tmp_path) -> None:
    assert roles(tmp_path, name, "GlycolFeed", "MotorTemp")[name] == ("soc", False)
    (tmp_path / "rising").mkdir()
    assert name not in roles(tmp_path / "rising", name, "GlycolFeed", "MotorTemp", rising=True)


def test_words_that_contain_others_are_not_cut() -> None:
    assert words("CurrentFeedback") == ("current", "feedback")
