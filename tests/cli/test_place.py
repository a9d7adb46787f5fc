"""`place`: the promised document with the best sets, what failures cost, and how many sensors a wish takes."""

import json
import re

import pytest

from bms_gateway.cli.main import main
from tests.config.model_texts import EXAMPLE
from tests.sensors.strings import cells, riccati


def run(capsys, *words):
    status = main(["place", *words, "--json", "-"])
    return status, json.loads(capsys.readouterr().out)


def test_the_document_is_as_promised(capsys):
    status, got = run(capsys, "--cells", "12", "--sensors", "4")
    assert status == 0
    assert list(got)[:4] == ["best", "exact_observable_sets", "paper_observable_sets", "sets"]
    assert (got["sets"], got["exact_observable_sets"], got["exhaustive"]) == (495, 495, True)
    assert got["paper_observable_sets"] == pytest.approx(106, abs=2)
    best = got["best"]
    assert best[0]["sensors"] == [1, 2, 11, 12]
    for x in best:
        assert x["core_sd_K"][x["worst_cell"] - 1] == max(x["core_sd_K"]) == x["worst_core_sd_K"]
        assert len(x["core_sd_K"]) == 12
    worst = [x["worst_core_sd_K"] for x in best]
    assert worst == sorted(worst)
    assert worst[0] == pytest.approx(0.429, rel=0.01)
    assert got["none"]["worst_core_sd_K"] == pytest.approx(1.411, abs=1e-3)
    assert got["even"]["worst_core_sd_K"] >= worst[0]
    lost = best[0]["if_lost"]
    assert [x["sensor"] for x in lost] == best[0]["sensors"]
    for x in lost:
        expected = riccati(cells(12, R_cc=31.84), tuple(x["sensors"])).max()
        assert x["worst_core_sd_K"] == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize(("condition", "exact"), [("natural", 494), ("no-conduction", 165), ("single", 0)])
def test_sets_are_counted_under_every_condition(capsys, condition, exact):
    _, got = run(capsys, "--cells", "12", "--sensors", "4", "--condition", condition)
    assert got["exact_observable_sets"] == exact
    if condition == "no-conduction":
        assert got["paper_observable_sets"] == 1


def test_people_read_where_sensors_go_and_what_a_failure_costs(capsys):
    assert main(["place", "--cells", "12", "--sensors", "2", "--wanted", "0.45"]) == 0
    out = capsys.readouterr().out
    assert "2 sensors: best on 1,12." in out
    assert "all 66 sets tried" in out
    assert re.search(r"^cell 12 +\d+ +\d\.\d{3} +\d\.\d{3}$", out, re.M)
    assert "± 0.45 K takes 4 sensors: 1,2,11,12 leave ± 0.427 K." in out
    assert max(map(len, out.splitlines())) <= 120


def test_a_wish_alone_places_as_many_as_it_takes(capsys):
    status, got = run(capsys, "--cells", "8", "--wanted", "0.6")
    assert status == 0
    assert got["wanted"]["reached"]
    assert len(got["best"][0]["sensors"]) == len(got["wanted"]["sensors"])
    assert got["best"][0]["worst_core_sd_K"] <= 0.6


def test_a_wish_that_cannot_be_had_is_said_with_status_1(capsys):
    status, got = run(capsys, "--cells", "5", "--sensors", "2", "--wanted", "0.1")
    assert status == 1
    assert not got["wanted"]["reached"]
    assert got["wanted"]["sensors"] == [1, 2, 3, 4, 5]
    assert len(got["best"][0]["sensors"]) == 2
    assert main(["place", "--cells", "5", "--sensors", "2", "--wanted", "0.1"]) == 1
    assert "± 0.1 K cannot be reached" in capsys.readouterr().out


def test_too_many_sets_are_searched_and_not_counted(capsys):
    status, got = run(capsys, "--cells", "40", "--sensors", "6")
    assert status == 0
    assert (got["exhaustive"], got["exact_observable_sets"], got["paper_observable_sets"]) == (False, None, None)
    assert got["sets"] == 3_838_380
    assert got["best"][0]["worst_core_sd_K"] <= got["even"]["worst_core_sd_K"]
    main(["place", "--cells", "40", "--sensors", "6"])
    assert "searched: too many sets to try all" in capsys.readouterr().out


def test_a_model_is_placed_on(tmp_path, capsys):
    path = tmp_path / "m.toml"
    path.write_text(EXAMPLE)
    status, got = run(capsys, "--model", str(path), "--sensors", "1")
    assert status == 0
    assert len(got["best"][0]["core_sd_K"]) == got["sets"] == 5
    assert main(["place", "--model", str(path), "--sensors", "2", "--json", str(path)]) == 2
    assert "this file is read by the command" in capsys.readouterr().err
    assert path.read_text() == EXAMPLE


def test_one_cell_has_one_place(capsys):
    status, got = run(capsys, "--cells", "1", "--sensors", "1")
    assert status == 0
    assert [x["sensors"] for x in got["best"]] == [[1]]
    assert got["best"][0]["if_lost"][0]["sensors"] == []


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--cells", "12"], "--sensors M is needed, how many to place, or --wanted SD"),
        (["--sensors", "2"], "--cells N is needed, or --model M"),
        (["--cells", "12", "--sensors", "0"], "--sensors 0: a string of 12 cells takes 1 to 12"),
        (["--cells", "12", "--sensors", "13"], "--sensors 13: a string of 12 cells takes 1 to 12"),
        (["--cells", "12", "--sensors", "1,5"], "argument --sensors: invalid int value: '1,5'"),
        (["--cells", "12", "--wanted", "0"], "--wanted 0: a standard deviation in K, above 0"),
        (["--cells", "12", "--wanted", "nan"], "--wanted nan: a standard deviation in K, above 0"),
        (["--cells", "12", "--sensors", "4", "--conditon", "full"], "did you mean '--condition'?"),
    ],
)
def test_what_is_wrong_is_one_line(capsys, words, says):
    assert main(["place", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
