"""A string of sixty cells, each with a thermocouple, an hour at 1 Hz: verdict, memory and size of its report."""

import json
import os
import subprocess
import sys

import pytest

from tests.truth.hidden import Scenario, make_log

PEAK_MIB, REPORT_BYTES = 1_500.0, 2_000_000
"""Measured: 869 MiB, in 50 s of CPU with the report; the diagnosis alone takes 19 s."""
RUN = """
import json, sys
from bms_gateway.cli.main import main
from tests.memory import peak_mib
try:
    status = main(sys.argv[1:])
except SystemExit as e:
    status = e.code
print(json.dumps({"status": status, "peak_mib": peak_mib()}), file=sys.stderr)
"""


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [["entropic_heat"], []])
def test_a_long_string_is_diagnosed_in_little_memory(tmp_path, hidden):
    """Its readings resolve a millikelvin, which no model is exact to: with nothing hidden, nothing is named."""
    effects = dict.fromkeys(hidden, ("strong", None))
    log = make_log(Scenario(effects, cells=60, sensors=tuple(range(1, 61)), seed=5))
    log.write_csv(tmp_path / "drive.csv")
    (tmp_path / "model.toml").write_text(log.model)
    words = ["diagnose", "drive.csv", "--model", "model.toml", "--json", "d.json", "--html", "d.html"]
    env = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(
        [sys.executable, "-c", RUN, *words], cwd=tmp_path, env=env, capture_output=True, text=True, check=True
    )
    took = json.loads(done.stderr.splitlines()[-1])
    assert took["status"] == 0, done.stderr
    said = json.loads((tmp_path / "d.json").read_text())
    assert [s["effect"] for s in said["selected"]] == hidden
    assert said["verdict"] == ("missing_effect" if hidden else "adequate")
    assert took["peak_mib"] < PEAK_MIB
    assert (tmp_path / "d.html").stat().st_size < REPORT_BYTES
