"""The catalogue on the terminal, as JSON and in the README of the effects is the one that the code has."""

import json
import tomllib
from pathlib import Path

import pytest

from bms_gateway.cli.effects import catalogue_table
from bms_gateway.cli.main import main
from bms_gateway.config import load_config
from bms_gateway.config.model_file import parse_model
from bms_gateway.thermal.effects import catalogue
from tests.config.files import OWN, write
from tests.config.model_texts import EXAMPLE, WITH_EFFECTS


def test_the_readmes_table_is_the_catalogue():
    readme = Path(__file__).parents[2] / "bms_gateway" / "thermal" / "effects" / "README.md"
    text = readme.read_text(encoding="utf-8")
    start, end = "<!-- effects -->\n", "\n<!-- /effects -->"
    assert text.count(start) == text.count(end) == 1
    assert text.partition(start)[2].partition(end)[0] == catalogue_table()


def test_the_overview_names_every_effect_and_fits_a_terminal(capsys):
    assert main(["effects"]) == 0
    out = capsys.readouterr().out
    for e in catalogue().values():
        assert f"\n{e.name} " in out
        assert e.equation.split()[0] in out
    assert max(map(len, out.splitlines())) <= 110


@pytest.mark.parametrize("name", catalogue())
def test_one_effect_in_detail_comes_with_a_table_that_a_model_takes(capsys, name):
    assert main(["effects", name]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    e = catalogue()[name]
    assert out.startswith(f"{name}: {e.title}\n")
    lines = [line.strip() for line in out.partition("in a model file:\n")[2].splitlines()]
    table = "\n".join(lines[1:])
    assert lines[0] == f'effects = ["{name}"]'
    text = EXAMPLE.replace("effects = []", lines[0]) + table
    (added,) = parse_model(text).effects
    assert added.name == name
    for p in e.parameters:
        assert added.values[p.name] == pytest.approx(p.probe, rel=1e-5)
        assert added.sd[p.name] == pytest.approx(p.sd, rel=1e-5)
    assert tomllib.loads(table)["effect"][name]


def test_the_json_has_units_and_bounds_as_shown(capsys):
    assert main(["effects", "--json", "-"]) == 0
    out, err = capsys.readouterr()
    listed = json.loads(out)["effects"]
    assert [e["name"] for e in listed] == list(catalogue())
    assert "entropic_heat" in err
    first = listed[0]["parameters"][0]
    assert (first["name"], first["unit"], first["bounds"]) == ("dUdT", "mV/K", [-1.5, 1.5])
    assert first["sd"] == 0.25
    transfer = next(e for e in listed if e["name"] == "charge_transfer")
    assert transfer["parameters"][0]["rel_sd"] == 1.5


def test_one_effect_as_json(tmp_path, capsys):
    assert main(["effects", "hysteresis", "--json", str(tmp_path / "e.json")]) == 0
    assert [e["name"] for e in json.loads((tmp_path / "e.json").read_text())["effects"]] == ["hysteresis"]
    assert "hysteresis" in capsys.readouterr().out


def test_a_wrong_name_tells_the_nearest(capsys):
    assert main(["effects", "cell_coolin"]) == 2
    assert "did you mean 'cell_cooling'?" in capsys.readouterr().err


def test_a_config_takes_a_model_with_effects(tmp_path):
    (string,) = load_config(write(tmp_path, OWN, WITH_EFFECTS)).plan.strings
    assert [e.key for e in string.model.effects] == ["entropic_heat", "cell_resistance:4", "charge_transfer"]


def test_the_table_is_written_between_its_two_lines_and_nothing_else_changes(capsys, tmp_path):
    file = tmp_path / "README.md"
    file.write_text("# above\n<!-- effects -->\nold\ntable\n<!-- /effects -->\nbelow\n", encoding="utf-8")
    assert main(["effects", "--write", str(file)]) == 0
    assert capsys.readouterr().out == f"{file}: the table was brought up to date\n"
    text = file.read_text(encoding="utf-8")
    assert text == f"# above\n<!-- effects -->\n{catalogue_table()}\n<!-- /effects -->\nbelow\n"
    assert main(["effects", "--write", str(file)]) == 0
    assert "up to date already" in capsys.readouterr().out
    assert file.read_text(encoding="utf-8") == text


@pytest.mark.parametrize("text", ["no lines", "<!-- effects -->\n", "<!-- /effects -->\n<!-- effects -->\n"])
def test_a_file_without_the_two_lines_is_left_alone(capsys, tmp_path, text):
    file = tmp_path / "notes.md"
    file.write_text(text, encoding="utf-8")
    assert main(["effects", "--write", str(file)]) == 2
    assert "the table goes between a line <!-- effects --> and a later line" in capsys.readouterr().err
    assert file.read_text(encoding="utf-8") == text


def test_help_tells_how_an_effect_of_ones_own_is_checked_and_the_table_written(capsys):
    assert main(["effects", "--help"]) == 0
    out = capsys.readouterr().out
    assert "broken_properties(YourEffect)" in out
    assert "effects --write notes.md" in out


@pytest.mark.parametrize("words", ["effects nosuch", "add nosuch --model m.toml --data t.csv --out o.toml"])
def test_a_name_like_none_gets_the_nearest_ones(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("m.toml").write_text(EXAMPLE)
    assert main(words.split()) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    named = err.partition("the nearest: ")[2].partition(" (all: bms-gateway effects)")[0].split(", ")
    assert len(named) == 3
    assert set(named) <= set(catalogue())
