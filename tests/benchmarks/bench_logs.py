"""Reading and writing logs: our columns against python-can's line reader, on a real drive where it is at hand.

``python -m tests.benchmarks.bench_logs`` prints µs of CPU per frame and ratios round by round.
"""

import gzip
import tempfile
from pathlib import Path

import can

from bms_gateway.bus.logfile import read_log, write_log
from bms_gateway.frames.batch import FrameBatch
from tests.benchmarks.rounds import alternate, ratio
from tests.data import data_dir

LINES = 100_000


def text():
    drive = data_dir() / "can" / "uwfe_pitt_autocross_02.log.gz"
    if drive.exists():
        return b"".join(gzip.decompress(drive.read_bytes()).splitlines(keepends=True)[:LINES])
    return b"".join(
        b"(%d.%06d) can0 %08X#%s\n"
        % (1_700_000_000 + k // 1_000, k % 1_000 * 1_000, k * 37 % 4_096, bytes(8).hex().encode())
        for k in range(LINES)
    )


def main():
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.log"
        path.write_bytes(text())
        frames = FrameBatch.concat(list(read_log(path)))

        def peer():
            for _ in can.CanutilsLogReader(path):
                pass

        times = alternate(
            {
                "read_log": lambda: [None for _ in read_log(path)],
                "python-can reader": peer,
                "write_log": lambda: write_log(Path(folder) / "out.log", [frames]),
            }
        )
    for timing in times.values():
        print(f"{timing.name:20}{timing.median / len(frames) * 1e6:8.3f} µs/frame")
    print("python-can reader / read_log:", ratio(times["python-can reader"], times["read_log"]))


if __name__ == "__main__":
    main()
