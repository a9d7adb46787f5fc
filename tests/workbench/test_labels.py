"""People read labels and printed units first; the identifiers that files and commands take stand in brackets."""

from importlib.resources import files
from types import SimpleNamespace

import pytest

from bms_gateway.report.step_names import FILED, REFITTED
from bms_gateway.workbench.documents import effect
from bms_gateway.workbench.form import taken_for
from bms_gateway.workbench.steps import Frame, _step


def test_the_numbers_of_an_effect_have_labels_and_printed_units():
    assert effect("polarization")["parameters"][0] == "resistance of the slow part (R_1), mΩ"
    found = effect("entropic_heat")["parameters"]
    assert found[:2] == [
        "level of the entropic coefficient (dUdT), mV/K",
        "departure from it at 5 % SOC (dUdT_1), mV/K",
    ]
    assert effect("resistance_soc")["parameters"][0] == "rise from half full to empty (s_1)"  # a share has no unit


@pytest.mark.parametrize(
    ("role", "index", "string", "told"),
    [
        ("current", None, None, "current: Pack.X, -10 to 20."),
        ("soc", None, 1, "SOC of string_1: Pack.X, -10 to 20."),
        ("coolant_inlet", None, 1, "coolant inlet of string_1 (coolant_inlet): Pack.X, -10 to 20."),
        ("surface", 2, 1, "surface temperature of cell 2, string_1 (surface 2): Pack.X, -10 to 20."),
        ("cell_voltage", 3, 1, "voltage of cell 3, string_1 (cell_voltage 3): Pack.X, -10 to 20."),
    ],
)
def test_what_a_signal_of_a_log_is_taken_for_has_its_label(role, index, string, told):
    one = SimpleNamespace(role=role, index=index, string=string, path="Pack.X", observed=(-10.0, 20.0), sure=True)
    one.single = (one,)
    assert taken_for(one) == told
    one.single = (one, SimpleNamespace(path="Pack.Y"))
    assert taken_for(one) == told.replace("Pack.X", "Pack.X and Pack.Y")


def test_the_page_takes_the_names_of_the_steps_from_the_server():
    scripts = [p.read_text(encoding="utf-8") for p in files("bms_gateway.workbench").joinpath("page").iterdir()]
    assert not [name for name in (FILED, f'"{REFITTED}"', "as filed", "`+ ") for text in scripts if name in text]
    assert _step(FILED, Frame("", REFITTED), None, "")["title"] == "The model with the parameters from its file"
