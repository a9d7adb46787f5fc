"""Lines and branches that the plain tests of a room reach, for what guards the bus and what is said on it:

    python -m tests.benchmarks.covered [frames] [sender] [engine] [health]

Each room is covered by its own tests alone, not by what happens to run through it from elsewhere; the sender by those
of the ports. Ends with 1 where a line or a branch is not reached. No slow test and none on a real interface is needed.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SENDER = ("pace", "socketcan", "pythoncan", "canframe", "message", "impostor", "port")
"""Queue and limits, the ports that send, and what both are made of."""
ROOMS = {
    "frames": (["bms_gateway.frames"], ["tests/frames"]),
    "sender": (
        [f"bms_gateway.bus.{name}" for name in SENDER],
        [f"tests/bus/test_{name}.py" for name in ("outages", "adapter", "ports", "rules", "wire")],
    ),
    "engine": (["bms_gateway.engine"], ["tests/engine"]),
    "health": (["bms_gateway.health"], ["tests/health"]),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=", ".join(ROOMS))
    rooms = parser.parse_args().rooms or list(ROOMS)
    if strange := set(rooms) - set(ROOMS):
        parser.error(f"no such room: {', '.join(sorted(strange))}; choose from {', '.join(ROOMS)}")
    failed = []
    with tempfile.TemporaryDirectory() as folder:
        for room in rooms:
            packages, tests = ROOMS[room]
            where = [f"--cov={p}" for p in packages]
            command = [sys.executable, "-m", "pytest", "-q", "-m", "not slow and not vcan and not systemd", *where]
            command += ["--cov-branch", "--cov-report=term-missing:skip-covered", "--cov-fail-under=100", *tests]
            environment = os.environ | {"COVERAGE_FILE": f"{folder}/{room}", "OPENBLAS_NUM_THREADS": "1"}
            print(f"== {room}", flush=True)
            if subprocess.run(command, cwd=ROOT, env=environment).returncode:
                failed.append(room)
    print(f"not whole: {', '.join(failed)}" if failed else "every line and every branch is reached", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
