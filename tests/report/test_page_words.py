"""What the page says of a table names its own fields: nobody there can type an option of a command."""

from types import SimpleNamespace

import numpy as np
import pytest

import bms_gateway as bms
from bms_gateway.config.dbc_files import shipped
from bms_gateway.diagnosis.input_checks import check_sign
from bms_gateway.errors import GatewayError
from bms_gateway.report.words import on_page

HEAD = "time_s,current_A,coolant_inlet_C,surface_1_C,surface_2_C,surface_3_C"
TIMES = [f"{k}" for k in range(100)]


def table(head: str = HEAD, times=TIMES, surface: str = "25.0") -> str:
    """A table of a drive; the surfaces are the same everywhere."""
    return "\n".join([head, *(f"{t},{10 * (k % 2)},25.0,{surface},{surface},{surface}" for k, t in enumerate(times))])


@pytest.mark.parametrize(
    ("text", "columns", "where"),
    [
        (table(surface="298.4"), [], "Choose their unit in the table of the columns"),
        (
            table(times=[f"0{1 + k // 50}/02/2026 10:00:{k % 50:02d}" for k in range(100)]),
            [],
            "choose its unit in the table",
        ),
        (table(HEAD.replace("current_A", "I")), [], "say in the table of the columns which one it is"),
        (
            table(HEAD.replace("coolant_inlet_C", "Tin")),
            ["coolant_inlet_C=Tin F"],
            "typed above the table of the columns",
        ),
        (table(HEAD.replace("coolant_inlet_C", "Tin F")), ["coolant_inlet_C=Tin F"], "choose its unit in the table"),
        (table(HEAD.replace("surface_1_C", "T1")), ["surface_1_C=T1 [bar]"], "choose its unit in the table"),
    ],
    ids=["kelvin", "dates", "name", "no such column", "letter", "no unit"],
)
def test_no_error_of_a_table_speaks_of_an_option(tmp_path, text, columns, where):
    path = tmp_path / "drive.csv"
    path.write_text(text)
    model = bms.read_model(str(shipped("deploy/worked/bench.toml")))
    with pytest.raises(GatewayError) as e:
        bms.read_records(str(path), model=model, columns=dict(c.split("=") for c in columns))
    assert "--columns" in str(e.value)
    said = on_page(str(e.value))
    assert "--columns" not in said, said
    assert where in said


def test_a_current_with_the_wrong_sign_says_where_to_tick():
    current = np.repeat([0.0, 50.0, -20.0, 10.0], 50)
    drive = SimpleNamespace(I=current, V=3.7 + 0.01 * current, dt=1.0, known={"voltage"})
    (found,) = check_sign(SimpleNamespace(drive=drive), None)
    assert "--columns" in found.sentence
    assert "--columns" not in on_page(found.sentence)
    assert "Tick “Sign −” of the current in the table of the columns." in on_page(found.sentence)
