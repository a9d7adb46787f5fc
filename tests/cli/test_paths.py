"""A path at which nobody can look is one line and status 2, whichever command it is given to."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.bad_inputs.case import sound
from tests.cli.calls import call

ROOT = Path(__file__).parents[2]
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


ALL = """
import json, sys
from tests.cli.calls import call
json.dump([call(*words) for words in json.load(sys.stdin)], sys.stdout)
"""


@pytest.fixture(scope="module")
def closed_out(folder) -> dict[str, tuple[int, str, str]]:
    """What each command says in a process that may not enter the folder of its path."""
    if os.geteuid() == 0 and subprocess.run([*WITHOUT_THE_RIGHT, "true"], check=False).returncode:
        pytest.skip("root may enter every folder here")
    (folder / "closed").mkdir(mode=0)
    before = WITHOUT_THE_RIGHT if os.geteuid() == 0 else ()
    done = subprocess.run(
        [*before, sys.executable, "-c", ALL],
        input=json.dumps([words.replace("@", "closed/x").split() for words in COMMANDS]),
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    return dict(zip(COMMANDS, json.loads(done.stdout), strict=True))


@pytest.mark.parametrize("words", COMMANDS)
@pytest.mark.plain_cases(4)
def test_a_folder_that_may_not_be_entered(closed_out, words):
    status, _, err = closed_out[words]
    told = [line for line in err.splitlines() if "error:" in line]
    assert (status, len(told)) == (2, 1), err[-500:]
    assert "closed" in told[0]
    assert "ermission denied" in told[0]
