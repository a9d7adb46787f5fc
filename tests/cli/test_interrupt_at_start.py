"""Ctrl-C while the program is still being loaded."""

import subprocess
import sys

HALF_LOADED = """
import sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == "bms_gateway.cli.main":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
from bms_gateway.__main__ import start
sys.exit(start())
"""


def test_it_ends_with_one_word():
    done = subprocess.run([sys.executable, "-c", HALF_LOADED], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "bms-gateway: stopped\n")
