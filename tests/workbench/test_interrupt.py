"""Ctrl-C reaches every process of the workbench: one that computes ends without a traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
AT_WORK = """
from bms_gateway.workbench import bench, worker

def answer(self, request, tell, show):
    tell(0.5, "at work")
    while True:
        pass

bench.Bench.answer = answer
worker.main()
"""


def test_a_worker_in_the_midst_of_its_work_ends_without_a_word():
    with subprocess.Popen(
        [sys.executable, "-c", AT_WORK],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as process:
        process.stdin.write("{}\n")
        process.stdin.flush()
        assert "at work" in process.stdout.readline()
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=30)[1]
    assert process.returncode == -signal.SIGINT
    assert said == ""
