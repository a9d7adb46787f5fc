"""`fleet` with one worker process and with two, in alternating rounds on the same logs; CPU, bytes and time per log.

    python -m tests.benchmarks.bench_fleet [--logs N] [--seconds S] [--rounds R] [--json F]

Time of the wall is what two workers are for, so on a shared machine the figures are no better than its other load; the
CPU time beside them tells how much of that it was.
"""

import argparse
import json
import os
import resource
import statistics
import tempfile
import time
from pathlib import Path

from bms_gateway.config.load import load_config
from bms_gateway.fleet.whole_fleet import run_fleet
from tests.benchmarks.rounds import ROUNDS
from tests.fleet.packs import logs
from tests.truth.hidden import Scenario


def one_run(made, loaded, jobs):
    """Seconds of wall and of CPU, all processes, and bytes of the results."""
    with tempfile.TemporaryDirectory() as out:
        before, start = cpu(), time.perf_counter()
        run = run_fleet(made, loaded, Path(out), jobs=jobs)
        wall, used = time.perf_counter() - start, cpu() - before
        assert not run.bad
        return wall, used, sum(p.stat().st_size for p in run.parts)


def cpu():
    who = (resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in who)


def spread(values):
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=8)
    parser.add_argument("--seconds", type=int, default=1800)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--json")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scenarios = {f"v{k}": Scenario(seed=400 + k, seconds=args.seconds) for k in range(args.logs)}
        config, files = logs(Path(folder), scenarios)
        loaded = load_config(config)
        made = [(f, f.stem) for f in files]
        size = sum(f.stat().st_size for f in files)
        load = os.getloadavg()[0]
        rounds = [{jobs: one_run(made, loaded, jobs) for jobs in (1, 2)} for _ in range(args.rounds)]
    hours = args.logs * args.seconds / 3600.0
    result = {
        "logs": args.logs,
        "seconds_each": args.seconds,
        "rounds": args.rounds,
        "processors": len(os.sched_getaffinity(0)),
        "load_average_before": load,
        "wall_s": {jobs: spread([r[jobs][0] for r in rounds]) for jobs in (1, 2)},
        "cpu_s": {jobs: spread([r[jobs][1] for r in rounds]) for jobs in (1, 2)},
        "one_worker_over_two": spread([r[1][0] / r[2][0] for r in rounds]),
        "cpu_s_per_hour_and_string": spread([r[1][1] / hours for r in rounds]),
        "log_bytes_per_hour_and_string": size / hours,
        "result_bytes_per_log": rounds[0][1][2] / args.logs,
    }
    for name, value in result.items():
        print(f"{name:32s} {json.dumps(value)}")
    if args.json:
        Path(args.json).write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
