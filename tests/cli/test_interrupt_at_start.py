"""Ctrl-C while the program is still being loaded."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HALF_LOADED = """
import sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "bms_gateway.cli.main":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
"""
IN_A_TEXT = HALF_LOADED.replace("raise KeyboardInterrupt", "exec('raise KeyboardInterrupt')")
"""As the code of a dataclass is: Python remembers this interrupt even if it was caught."""


@pytest.mark.parametrize("site", [HALF_LOADED, IN_A_TEXT], ids=["in a module", "in a text"])
def test_it_ends_with_one_word(site, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(site)
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    words = [sys.executable, "-m", "bms_gateway"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=env, cwd=ROOT)
    assert (done.returncode, done.stderr) == (130, "bms-gateway: stopped\n")
