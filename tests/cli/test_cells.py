"""`cells`: a table for people, JSON for machines."""

import json

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import format_model, parse_model
from bms_gateway.diagnosis.geometry import odd_declared
from bms_gateway.thermal.cells import PUBLISHED, cell_of


def test_one_cell_as_json(capsys) -> None:
    assert main(["cells", "lg_m50", "--json", "-"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert list(document) == ["lg_m50"]
    parameters = document["lg_m50"]["parameters"]
    assert set(parameters) == {"C_c", "C_s", "R_e", "R_c", "R_u", "R_cc"}
    for p in parameters.values():
        assert {"value", "unit", "rel_sd", "source"} <= set(p)
    assert parameters["R_e"]["unit"] == "mOhm"
    assert 20 < parameters["R_e"]["value"] < 60
    assert 60 < parameters["C_c"]["value"] + parameters["C_s"]["value"] < 75  # 69 g at 0.95 J/g/K


def test_what_is_shown_for_a_model_file_is_one_and_says_which_cell_it_is(capsys) -> None:
    assert main(["cells", "pouch 290x216x7.1mm 33Ah 787g LMO still 2p"]) == 0
    shown = capsys.readouterr().out.partition("model file:\n")[2].partition("\n\nA record")[0]
    model = parse_model(f'cells = 1\nsensors = [1]\ncondition = "single"\n{shown}\n')
    assert model.capacity_Ah == 66.0
    facts = cell_of(model.cell_format)
    assert (facts.shape, facts.chemistry, facts.parallel) == ("pouch", "LMO", 2)
    assert odd_declared(model) == ()
    assert parse_model(format_model(model)) == model


def test_all_cells_and_words_with_blanks(capsys, tmp_path) -> None:
    assert main(["cells", "--json", str(tmp_path / "all.json")]) == 0
    assert set(PUBLISHED) <= set(json.loads((tmp_path / "all.json").read_text()))
    assert "lg_m50" in capsys.readouterr().out
    assert main(["cells", "21700", "5Ah", "forced", "2p"]) == 0
    assert "2 in parallel" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("21700 18650", "'21700' and '18650' are two cells"),
        ("18650 2,6Ah", "decimals take a point, as '2.6Ah'"),
    ],
)
def test_what_is_wrong_with_a_description_is_said_as_it_is(text, says, capsys) -> None:
    # Bug: "'18650' is not known; did you mean '18650'?"
    assert main(["cells", text]) == 2
    assert says in capsys.readouterr().err


def test_a_published_cell_is_found_as_its_maker_writes_it(capsys) -> None:
    assert main(["cells", "LG M50"]) == 0
    assert capsys.readouterr().out.startswith("lg_m50,")


@pytest.mark.parametrize("words", [["lgm5O"], ["21700", "5V"]])
def test_an_unknown_cell_is_one_line(words, capsys) -> None:
    assert main(["cells", *words]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "Traceback" not in told
