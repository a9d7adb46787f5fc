"""What `init` reads has the bounds of every config, on its second, lenient way too."""

import subprocess
import sys
from pathlib import Path

import pytest

MOST_MIB = 450
"""Of the whole program: it has some 110 MiB before, the bound is 100, and the timer looks twenty times a second."""

INIT = """
import sys
from bms_gateway.cli.main import main
from tests.memory import peak_mib

code = main(sys.argv[1:])
print(peak_mib())
sys.exit(code)
"""


@pytest.mark.slow
def test_a_dbc_that_costs_too_much_is_refused_in_one_line(tmp_path):
    """A hundred thousand messages of one identifier are refused, and were then read once more without a bound."""
    (tmp_path / "a.log").write_text("(1700000000.000000) can0 123#11\n")
    dbc = tmp_path / "a.dbc"
    dbc.write_text('VERSION ""\nBS_:\nBU_: X\n' + "BO_ 1 x: 8 X\n" * 300_000)
    words = [sys.executable, "-c", INIT, "init", tmp_path / "a.log", "--dbc", dbc, "--out", tmp_path / "out"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=Path(__file__).parents[2], check=False)
    assert done.returncode == 2
    assert "a.dbc: reading it takes over" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert float(done.stdout.splitlines()[-1]) < MOST_MIB
