"""A long run of the fuzzing: `python -m tests.benchmarks.fuzz --minutes 10 [--seed N]`.

Spoils sound logs, tables, configs, models, DBC files, stored states and frames at random, in turn, and counts. Ends
with status 1 at the first exception that is not ours, at a hang (an input that takes longer than `HANG_S`), or when
the process has grown beyond `BOUND_MIB`; the input that did it is kept as a file.
"""

import argparse
import logging
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

from tests.fuzz.mutate import apply, random_edits
from tests.fuzz.targets import survives, targets
from tests.memory import peak_mib

HANG_S = 60  # a loaded machine takes seconds for what takes a millisecond
BOUND_MIB = 1_500


class HangError(Exception):
    """An input took too long."""


def _hang(*_: object) -> None:
    raise HangError(f"no end within {HANG_S} s")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    logging.disable()  # cantools tells of each message that it replaces
    warnings.simplefilter("error", RuntimeWarning)  # numpy's: a cast of what is no number
    signal.signal(signal.SIGALRM, _hang)
    rng = random.Random(args.seed)
    run, taken, slowest = Counter[str](), Counter[str](), Counter[str]()
    end = time.monotonic() + 60.0 * args.minutes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = targets(folder)
        while time.monotonic() < end:
            for kind, target in found.items():
                data = apply(rng.choice(target.seeds), random_edits(rng))
                begun = time.monotonic()
                signal.alarm(HANG_S)
                try:
                    taken[kind] += survives(target, data, folder)
                except Exception as error:
                    kept = Path(f"fuzz-{kind}.bin")
                    kept.write_bytes(data)
                    print(f"{kind}: {type(error).__name__}: {error} (input kept as {kept}, {len(data)} bytes)")
                    raise
                finally:
                    signal.alarm(0)
                run[kind] += 1
                slowest[kind] = max(slowest[kind], round(1e3 * (time.monotonic() - begun)))
    peak = peak_mib()
    for kind in found:
        print(f"{kind:12} {run[kind]:8} executions, {taken[kind]:8} taken, slowest {slowest[kind]:6} ms")
    print(f"{run.total()} executions in {args.minutes:g} min, none raised what is not ours; peak memory {peak:.0f} MiB")
    return 0 if peak <= BOUND_MIB else 1


if __name__ == "__main__":
    sys.exit(main())
