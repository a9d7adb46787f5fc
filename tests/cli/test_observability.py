"""`observability`: the promised document, text that a battery engineer reads, one clear line for what is wrong."""

import json
import subprocess
import sys

import pytest

from bms_gateway.cli.main import main
from bms_gateway.config.model_file import read_model
from bms_gateway.sensors import steady_core_sd
from bms_gateway.thermal import Disturbance
from tests.config.model_texts import EXAMPLE
from tests.sensors.strings import cells, riccati

KEYS = ["cells", "sensors", "condition", "states", "exact_rank", "paper_rank", "observable", "core_sd_K"]


def document(capsys, *words):
    assert main(["observability", *words, "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_document_is_as_promised(capsys):
    got = document(capsys, "--cells", "12", "--sensors", "3,6,9,12")
    assert list(got) == KEYS
    assert (got["cells"], got["sensors"], got["condition"]) == (12, [3, 6, 9, 12], "full")
    assert (got["states"], got["exact_rank"], got["paper_rank"], got["observable"]) == (24, 24, 24, True)
    assert got["core_sd_K"] == pytest.approx(riccati(cells(12), (3, 6, 9, 12)), rel=2e-3)


@pytest.mark.parametrize(
    ("words", "exact", "paper", "observable"),
    [
        (["--sensors", "2,5,8,11", "--condition", "natural"], 22, None, False),
        (["--sensors", "3,6,9,12", "--condition", "no-conduction"], 24, 24, True),
        (["--sensors", "11", "--condition", "no-conduction"], 22, None, False),
        (["--sensors", "1-3,12", "--condition", "single"], 8, 8, False),
        (["--sensors", "none"], 0, 0, False),
        (["--sensors", "1"], 24, None, True),
    ],
)
def test_both_ranks_are_told(capsys, words, exact, paper, observable):
    got = document(capsys, "--cells", "12", *words)
    assert (got["exact_rank"], got["observable"]) == (exact, observable)
    assert got["paper_rank"] == paper if paper is not None else got["paper_rank"] < 24


def test_people_read_what_each_core_is_known_to(capsys):
    assert main(["observability", "--cells", "12", "--sensors", "2,5,8,11", "--condition", "natural"]) == 0
    out = capsys.readouterr().out
    assert "sensors on 2,5,8,11: 2 of 24 states are hidden." in out
    assert "exact rank    22 of 24" in out
    assert "core ± sd K" in out
    assert "31.84 K/W from cell to cell" in out
    assert max(map(len, out.splitlines())) <= 120


def test_a_model_brings_its_cells_sensors_and_condition(tmp_path, capsys):
    path = tmp_path / "m.toml"
    path.write_text(EXAMPLE)
    got = document(capsys, "--model", str(path))
    assert (got["cells"], got["sensors"], got["condition"]) == (5, [1, 3, 5], "full")
    assert got["core_sd_K"] == pytest.approx(steady_core_sd(read_model(path).nominal, (1, 3, 5)), abs=1e-4)
    other = document(capsys, "--model", str(path), "--sensors", "5", "--condition", "natural", "--R_cc", "8")
    assert (other["sensors"], other["condition"]) == ([5], "natural")


def test_what_is_unknown_can_be_said(capsys):
    words = ["--heat-common", "1", "--heat-cell", "0.3", "--inlet", "0.2", "--correlation", "300", "--noise", "0.2"]
    got = document(capsys, "--cells", "3", "--sensors", "1,3", "--R_cc", "32", *words)
    d = Disturbance(heat_common=1.0, heat_cell=0.3, inlet=0.2, correlation=300.0, sensor=0.2)
    assert got["core_sd_K"] == pytest.approx(riccati(cells(3), (1, 3), d), abs=1e-4)


def test_where_placement_cannot_help_that_is_said(capsys):
    assert main(["observability", "--cells", "4", "--sensors", "1", "--heat-common", "0", "--inlet", "0"]) == 0
    assert "a cell whose core must be known needs its own sensor" in capsys.readouterr().out


def test_a_very_long_string_has_no_paper_rank(capsys):
    got = document(capsys, "--cells", "130", "--sensors", "1,130")
    assert (got["exact_rank"], got["paper_rank"]) == (260, None)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "--cells N is needed, or --model M"),
        (["--cells", "0"], "--cells 0: valid: 1 to 1000"),
        (["--cells", "1001"], "--cells 1001: valid: 1 to 1000"),
        (["--cells", "twelve"], "argument --cells: invalid int value: 'twelve'"),
        (["--cells", "12", "--sensors", "0"], "cell 0 does not exist; valid: 1 to 12"),
        (["--cells", "12", "--sensors", "1,13"], "cell 13 does not exist; valid: 1 to 12"),
        (["--cells", "12", "--sensors", "1;2"], "'1;2' is no cell; write them as 1,5"),
        (["--cells", "12", "--sensors", ""], "'' is no cell"),
        (["--cells", "12", "--sensors", "5-3"], "5-3 goes backwards"),
        (["--cells", "12", "--sensors", "1-3,2"], "cell 2 is named twice"),
        (["--cells", "12", "--condition", "natrual"], "--condition 'natrual': unknown; did you mean 'natural'?"),
        (["--cells", "12", "--R_cc", "0"], "--R_cc 0: valid: 0.01 to 10000 K/W"),
        (["--cells", "1", "--R_cc", "4"], "one cell has no conduction from cell to cell"),
        (["--cells", "12", "--condition", "single", "--R_cc", "4"], "--condition single has no conduction"),
        (["--cells", "12", "--noise", "nan"], "--noise nan: valid: 0.0001 to 50 K"),
        (["--cells", "12", "--inlet", "-1"], "--inlet -1: valid: 0 to 50 K"),
        (["--cells", "12", "--sensor", "1"], "unknown option '--sensor'; did you mean '--sensors'?"),
        (["--model", "absent.toml"], "absent.toml: no such file"),
        (["--cells", "12", "--json", "absent/x.json"], "--json absent/x.json: cannot be written"),
    ],
)
def test_what_is_wrong_is_one_line(capsys, words, says):
    assert main(["observability", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err


def test_a_model_that_lacks_what_a_condition_needs_is_told(tmp_path, capsys):
    path = tmp_path / "m.toml"
    path.write_text(
        "\n".join(x for x in EXAMPLE.splitlines() if not x.startswith("C_f")).replace('"full" ', '"natural" ')
    )
    assert main(["observability", "--model", str(path), "--condition", "full"]) == 2
    assert "has no C_f in [parameters]" in capsys.readouterr().err
    assert main(["observability", "--model", str(path), "--cells", "4"]) == 2
    assert "has 5 cells; leave --cells away" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["observability", "--cells", "12", "--sensors", "3,6,9,12"], ["place", "--cells", "12", "--sensors", "4"]]
)
def test_the_whole_program_answers_with_json_alone_on_its_output(words):
    done = subprocess.run(
        [sys.executable, "-m", "bms_gateway", *words, "--json", "-"], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout)
