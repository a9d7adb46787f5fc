"""What `init` reads has the bounds of every config, on its second, lenient way too."""

import os
import subprocess
import sys

MOST_MIB = 450
"""Of the whole program: it has some 110 MiB before, the bound is 100, and the timer looks twenty times a second."""


def test_a_dbc_that_costs_too_much_is_refused_in_one_line(tmp_path):
    """A hundred thousand messages of one identifier are refused, and were then read once more without a bound."""
    (tmp_path / "a.log").write_text("(1700000000.000000) can0 123#11\n")
    dbc = tmp_path / "a.dbc"
    dbc.write_text('VERSION ""\nBS_:\nBU_: X\n' + "BO_ 1 x: 8 X\n" * 300_000)
    words = [sys.executable, "-m", "bms_gateway", "init", tmp_path / "a.log", "--dbc", dbc, "--out", tmp_path / "out"]
    with (tmp_path / "said").open("wb") as said:
        process = subprocess.Popen(words, stderr=said)
        _, status, used = os.wait4(process.pid, 0)  # of this child alone
        process.returncode = os.waitstatus_to_exitcode(status)
    told = (tmp_path / "said").read_text()
    assert process.returncode == 2
    assert "a.dbc: reading it takes over" in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()
    print(f"{used.ru_maxrss / 1024:.0f} MiB, {used.ru_utime:.1f} s")
    assert used.ru_maxrss < MOST_MIB * 1024
