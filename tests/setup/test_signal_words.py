"""Names and units as makers write them."""

import pytest

from bms_gateway.setup.signal_words import unit_of, words


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
