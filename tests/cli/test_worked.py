"""README's own vehicle, word for word: the log and DBC that come with the package."""

import csv
import json
import re
import shlex
from pathlib import Path

import pytest

from bms_gateway.cli.main import main

ROOT = Path(__file__).resolve().parents[2]


def commands() -> list[list[str]]:
    """The commands of README that name the worked vehicle, or what was made of it, without the service."""
    lines = [line.strip() for line in (ROOT / "README.md").read_text().splitlines()]
    told = [shlex.split(line) for line in lines if line.startswith("bms-gateway ") and "deploy/worked" in line]
    return [words[1:] for words in told]


def test_the_commands_of_readme_lead_to_cores(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deploy").symlink_to(ROOT / "deploy")
    told = commands()
    assert [words[0] for words in told] == ["init", "check", "analyze", "diagnose"]
    for words in told:
        more = ["--json", "init.json"] if words[0] == "init" else []
        assert main([*words, *more]) == 0
    out = capsys.readouterr().out
    charge = next(line.split() for line in out.splitlines() if line.startswith("soc "))
    assert charge[2:] == ["yes", "52.13", "…", "71.07", "0.01", "%", "10"]
    assert "no role here" not in out
    found = json.loads(Path("init.json").read_text())
    assert [s["cells"] for s in found["strings"]] == [4]
    assert all(s["sure"] for s in found["signals"])
    roles = [s["role"] for s in found["signals"]]
    assert roles == ["current", "voltage", "soc", "coolant_inlet", *["surface"] * 4]
    with Path("results/estimates.csv").open() as f:
        last = list(csv.DictReader(f))[-4:]
    for row in last:
        assert float(row["core_C"]) == pytest.approx(40.0, abs=6.0)
        assert float(row["core_C"]) > float(row["surface_C"]) + 3.0
        assert float(row["core_sd_K"]) < 4.0


def test_each_step_of_the_ten_minutes_has_its_command_line() -> None:
    """A step is a numbered line of README's road; what is carried out stands in a block of its own."""
    text = (ROOT / "README.md").read_text()
    road = text[text.index("## With your own vehicle") : text.index("## Commands")]
    steps = re.split(r"^\d+\. ", road, flags=re.MULTILINE)[1:]
    assert len(steps) >= 5
    for step in steps:
        assert re.search(r"^ +```sh\n(?: +.*\n)* +bms-gateway \w+ ", step, re.MULTILINE), step.splitlines()[0]
