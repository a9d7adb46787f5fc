"""`reproduce` at its borders: words, files, a missing extra; the numbers have tests of their own."""

import json
import sys

import pytest

from bms_gateway.cli.main import main
from bms_gateway.errors import MissingExtraError
from bms_gateway.report.reproduce_figures import drawing


def complaint(capsys, *words):
    assert main(["reproduce", *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_sections_can_be_chosen_and_come_in_reading_order(capsys):
    assert main(["reproduce", "errata", "observability", "--jobs", "1"]) == 0
    out = capsys.readouterr().out
    assert out.index("1. How many sensors?") < out.index("2. Errors of the print")
    assert "One cell" not in out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["observabilty"], "no section 'observabilty'; did you mean 'observability'?"),
        (["errata", "--seeds", "1"], "--seeds 1: valid: 2 to 1000"),
        (["errata", "--seeds", "many"], "--seeds"),
        (["errata", "--jobs", "0"], "--jobs 0: at least 1"),
        (["errata", "--ot", "x"], "did you mean '--out'?"),
        (["errata", "--out", ""], "--out is empty"),
        (["errata", "--json", "no/such/folder/r.json"], "no such folder"),
    ],
)
def test_a_wrong_word_is_told_in_one_line(capsys, words, told):
    assert told in complaint(capsys, *words)


def test_a_folder_that_is_a_file_is_told(tmp_path, capsys):
    (tmp_path / "taken").write_text("x")
    assert "is a file; name a folder" in complaint(capsys, "errata", "--out", str(tmp_path / "taken"))


def test_json_alone_goes_to_standard_output(capsys):
    assert main(["reproduce", "errata", "--json", "-", "--jobs", "1"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert document["seeds"] == 8
    assert {r["section"] for r in document["rows"]} == {"errata"}
    assert "Errors of the print" in err


def test_two_processes_give_what_one_gives(tmp_path, capsys):
    for jobs in ("1", "2"):
        words = ["reproduce", "placement", "observability", "--jobs", jobs, "--json", str(tmp_path / f"{jobs}.json")]
        assert main(words) == 0
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()
    capsys.readouterr()


def test_without_matplotlib_figures_are_refused_before_the_work_and_text_is_not(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    told = complaint(capsys, "--out", str(tmp_path / "figures"))  # all sections: it would take a minute
    assert "pip install 'bms-gateway[report]'" in told
    assert main(["reproduce", "errata", "--jobs", "1"]) == 0


def test_figures_and_text_lie_in_the_folder(tmp_path, capsys):
    try:
        drawing()
    except MissingExtraError:
        pytest.skip("matplotlib is not installed")
    out = tmp_path / "new" / "figures"
    assert main(["reproduce", "placement", "--jobs", "1", "--out", str(out)]) == 0
    assert f"{out}: 1 figures and report.txt" in capsys.readouterr().out
    assert (out / "placement.png").read_bytes().startswith(b"\x89PNG")
    assert "Where do sensors belong?" in (out / "report.txt").read_text(encoding="utf-8")
    assert {p.name for p in out.iterdir()} == {"placement.png", "report.txt"}
