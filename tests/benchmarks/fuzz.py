"""A long run of the fuzzing: `python -m tests.benchmarks.fuzz --minutes 10 [--seed N]`; `--check N` for configs, and
`tests/canvm/canvm -t 3600 python -m tests.benchmarks.fuzz --reload N` for configs that a service on vcan0 reads again.

Spoils sound logs, tables, configs, models, DBC files, stored states and frames at random, in turn, and counts. Ends
with status 1 at the first exception that is not ours, at a hang (an input that takes longer than `HANG_S`), or when
the process has grown beyond `BOUND_MIB`; the input that did it is kept as a file.
"""

import argparse
import io
import logging
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

from bms_gateway.cli.main import main as main_of_program
from tests.fuzz.configs import lay, spoilt
from tests.fuzz.mutate import apply, random_edits
from tests.fuzz.reloads import Reloads
from tests.fuzz.targets import LONGEST, survives, targets
from tests.memory import peak_mib

HANG_S = 60  # a loaded machine takes seconds for what takes a millisecond
BOUND_MIB = 1_500
MOST_MIB = 150  # by which a check may grow: reading is bounded to 100
MOST_S = 8.0  # of one check: reading is bounded, and there is more to it
MOST_RELOAD_S = 30.0  # as long as systemd waits for one
MOST_GAP_S = 5.0  # between two frames of the gateway: they come every second, and a guest may stand still for a while
REPORT_EVERY = 50


class HangError(Exception):
    """An input took too long."""


def _hang(*_: object) -> None:
    raise HangError(f"no end within {HANG_S} s")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--check", type=int, metavar="N", help="instead: N spoilt configs, models and DBC files by `check`"
    )
    parser.add_argument(
        "--reload", type=int, metavar="N", help="instead: N of them, reloaded by a service that runs on vcan0"
    )
    args = parser.parse_args()
    logging.disable()  # cantools tells of each message that it replaces
    warnings.simplefilter("error", RuntimeWarning)  # numpy's: a cast of what is no number
    signal.signal(signal.SIGALRM, _hang)
    if args.reload is not None:
        return by_reload(args.reload, random.Random(args.seed))
    if args.check is not None:
        return by_check(args.check, random.Random(args.seed))
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


def by_check(count: int, rng: random.Random) -> int:
    """Give spoilt files to `check`: no traceback, one line, and how long and how large it gets."""
    statuses, kinds, slowest = Counter[int](), Counter[str](), 0.0
    before = peak_mib()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ["CACHE_DIRECTORY"] = str(folder / "tables")
        for _ in range(count):
            file, content = spoilt(rng)
            path = lay(folder, file, content)
            told, begun = io.StringIO(), time.process_time()
            signal.alarm(HANG_S)
            try:
                with redirect_stderr(told), redirect_stdout(io.StringIO()):
                    status = main_of_program(["check", str(path)])
            except BaseException:
                Path(f"fuzz-{file}").write_bytes(content)
                print(f"the input is kept as fuzz-{file}")
                raise
            finally:
                signal.alarm(0)
            slowest = max(slowest, time.process_time() - begun)
            statuses[status] += 1
            kinds[file] += 1
            said = told.getvalue()
            if status == 2 and (said.count("\n") != 1 or len(said) > LONGEST):
                raise AssertionError(f"not one line for a person: {said[:LONGEST]!r}")
    peak = peak_mib()
    print(f"{count} spoilt files by check, {dict(kinds)}: by status {dict(sorted(statuses.items()))}, no traceback;")
    print(f"slowest {slowest:.2f} s of processor time; peak memory {peak:.0f} MiB, {before:.0f} before the first")
    return 0 if set(statuses) <= {0, 1, 2} and slowest < MOST_S and peak - before < MOST_MIB else 1


def by_reload(count: int, rng: random.Random) -> int:
    """Have a service that runs reload spoilt files: no traceback, no end, and how long and how large it gets."""
    with tempfile.TemporaryDirectory() as name, Reloads(Path(name)) as service:
        for done in range(0, count, REPORT_EVERY):
            found = service.spoil(min(REPORT_EVERY, count - done), rng)
            print(found, flush=True)
        service.restore()
        if service.reload() != "reloaded":
            raise AssertionError("sound files are not taken any more")
        status = service.stop()
    print(f"stopped with status {status}")
    return 0 if status == 0 and found.slowest_s < MOST_RELOAD_S and found.gap_s < MOST_GAP_S else 1


if __name__ == "__main__":
    sys.exit(main())
