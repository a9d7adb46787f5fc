import subprocess
import sys
from pathlib import Path

from tests.memory import peak_mib

SMALL_MIB, LARGE_MIB = 150, 300
ASK = "from tests.memory import peak_mib; print(peak_mib())"


def test_a_small_process_started_by_a_large_one_tells_its_own_peak():
    ballast = b"\1" * (LARGE_MIB << 20)
    assert peak_mib() > LARGE_MIB
    root = Path(__file__).resolve().parents[1]
    done = subprocess.run([sys.executable, "-c", ASK], check=True, capture_output=True, text=True, cwd=root)
    assert float(done.stdout) < SMALL_MIB
    del ballast
