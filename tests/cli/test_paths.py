"""A path at which nobody can look is one line and status 2, whichever command it is given to."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.bad_inputs.case import sound
from tests.cli.calls import call

LONG = "x" * 300
DEEP = "y/" * 2100 + "z"
LOOP = "loop"
WITHOUT_THE_RIGHT = ("setpriv", "--bounding-set=-dac_override,-dac_read_search")
COMMANDS = (
    "check gateway.toml --log @.log",
    "check @.toml",
    "init @.log --yes --out out",
    "init drive.log --dbc @.dbc --yes --out out",
    "init drive.log --yes --out @",
    "analyze drive.log --config gateway.toml --out @",
    "analyze @.log --config gateway.toml --out out",
    "forecast @.log --config gateway.toml",
    "forecast drive.log --config gateway.toml --profile @.csv",
    "export --last 2h --out out.csv --store @",
    "encode @.csv --config gateway.toml --out out.log",
    "encode bench.csv --config gateway.toml --out @.log",
    "replay @.log --to vcan0",
    "compare @.csv --model string_1.toml",
    "fit bench.csv --model @.toml --out out.toml",
    "workbench @.csv --model string_1.toml --port 0",
    "workbench --live @.log --config gateway.toml --port 0",
    "workbench --recent 2h --store @ --model string_1.toml --port 0",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("paths")
    sound(folder)
    for ending in ("", ".log", ".csv", ".toml", ".dbc"):
        (folder / f"{LOOP}{ending}").symlink_to(f"{LOOP}{ending}")
    return folder


@pytest.mark.parametrize("path", [LONG, DEEP], ids=["long", "deep"])
@pytest.mark.parametrize("words", COMMANDS)
def test_a_path_that_cannot_be(folder, monkeypatch, words, path):
    monkeypatch.chdir(folder)
    status, _, err = call(*words.replace("@", path).split())
    told = [line for line in err.splitlines() if "error:" in line]
    assert (status, len(told)) == (2, 1), err[-500:]
    assert len(told[0]) < 1700


@pytest.mark.parametrize("words", [words for words in COMMANDS if "--out @" not in words])
def test_a_link_that_leads_to_itself(folder, monkeypatch, words):
    monkeypatch.chdir(folder)
    status, _, err = call(*words.replace("@", LOOP).split())
    told = [line for line in err.splitlines() if "error:" in line]
    assert (status, len(told)) == (2, 1), err[-500:]


@pytest.mark.parametrize("words", COMMANDS)
def test_a_folder_that_may_not_be_entered(folder, words):
    if os.geteuid() == 0 and subprocess.run([*WITHOUT_THE_RIGHT, "true"], check=False).returncode:
        pytest.skip("root may enter every folder here")
    closed = folder / "closed"
    closed.mkdir(exist_ok=True)
    closed.chmod(0)
    before = WITHOUT_THE_RIGHT if os.geteuid() == 0 else ()
    command = [*before, sys.executable, "-m", "bms_gateway", *words.replace("@", "closed/x").split()]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    told = [line for line in done.stderr.splitlines() if "error:" in line]
    assert (done.returncode, len(told)) == (2, 1), done.stderr[-500:]
    assert "closed" in told[0]
    assert "ermission denied" in told[0]
