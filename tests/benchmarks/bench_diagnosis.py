"""Logs with hidden effects, diagnosed: scores beside their goals, who was taken for whom, and every miss.

``python -m tests.benchmarks.bench_diagnosis --seed 100 --suites singles,controls --limit 30`` for a part;
``… --new-drives --json out.json --peer FOLDER --peer-python PYTHON`` for all of it, with the prototype beside;
``… --experiments 30 --gateway 30`` drives what is suggested next, and runs the added effects in `analyze`.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
import traceback
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.benchmarks.diagnosis_case import examine
from tests.benchmarks.diagnosis_experiment import confusable, experiment, experiments_report
from tests.benchmarks.diagnosis_gateway import gateway, gateway_report, hidden_ones
from tests.benchmarks.diagnosis_peer import Peer
from tests.benchmarks.diagnosis_scores import by_effect, confusion, misses, table
from tests.truth.hidden import make_logs, new_drive
from tests.truth.suites import SUITES

TRIES = 6
"""Of how many times the number asked for a study gives up."""
CHUNK = 24
"""Logs made at once: a few tens of megabytes."""


def scenarios(suite, seed, limit):
    """A suite, or `limit` of it chosen by the seed, strings of one length together: they are made in one loop."""
    found = SUITES[suite](seed)
    if limit is not None and limit < len(found):
        chosen = np.random.default_rng([seed, 77]).choice(len(found), limit, replace=False)
        found = [found[i] for i in sorted(chosen)]
    return sorted(found, key=lambda s: s.cells)


def attempt(suite, log, new_log, twins):
    """Diagnose one; a crash is a miss like any other."""
    try:
        return examine(suite, log, new_log, twins)
    except Exception as error:
        traceback.print_exc()
        s, never = log.scenario, [float("nan")] * 2
        hidden = [{"effect": k, "size": size, "cell": c, "odds": None} for k, (size, c) in s.effects.items()]
        said = {"verdict": "crashed", "remains": False, "named": [], "seconds": 0.0, "inside": {}, "absorbs": {}}
        said |= {"structure": never, "held": never, "core": never, "error": f"{type(error).__name__}: {error}"}
        where = {"suite": suite, "name": s.name, "cells": s.cells, "sensors": list(s.sensors)}
        return where | {"floor": max(s.noise, 1e-3), "hidden": hidden, "absorbed": False, "ours": said, "peer": None}


def outcomes(suite, scenarios, pool, peer, peer_every, new_drives):
    """Diagnose the logs of a suite. The next logs are made while the workers diagnose: two chunks are held at once."""
    again = new_drives and suite in ("singles", "one_cell", "pairs")
    waiting = []
    for first in range(0, len(scenarios), CHUNK):
        some = scenarios[first : first + CHUNK]
        logs = make_logs(some + [new_drive(s) for s in some] * again)
        other = logs[len(some) :] if again else [None] * len(some)
        twins = without_noise(some) if suite == "unknowns" else [None] * len(some)
        logs = zip(logs, other, twins, strict=False)
        submitted = [(log, pool.submit(attempt, suite, log, *more)) for log, *more in logs]
        yield from gathered(waiting, peer, peer_every)
        waiting = submitted
    yield from gathered(waiting, peer, peer_every)


def without_noise(scenarios):
    """Each log without noise and steps, with what is hidden and without it: tuples of two."""
    plain = [replace(s, noise=0.0, step=0.0) for s in scenarios]
    logs = make_logs(plain + [replace(s, effects={}) for s in plain])
    return list(zip(logs[: len(plain)], logs[len(plain) :], strict=True))


def gathered(waiting, peer, peer_every):
    """Await outcomes; the prototype runs here, on logs of a chunk in equal steps, while the workers go on."""
    for i, (log, future) in enumerate(waiting):
        o = future.result()
        if peer is not None and i % peer_every == 0:
            o["peer"] = peer.run(log)
        yield o


def tries(study, scenarios, pool, wanted, jobs, begin):
    """Try scenarios until `wanted` were of use, `TRIES` times as many at most: outcomes, of how many, crashes.

    Outcomes count in the order of the scenarios, whatever finishes first.
    """
    found, tried, crashed, most = [], 0, [], TRIES * wanted
    some, running = iter(scenarios), deque()
    while len(found) < wanted and tried < most:
        while len(running) < 2 * jobs and (s := next(some, None)) is not None:
            running.append((s, pool.submit(study, s)))
        s, future = running.popleft()
        tried += 1
        try:
            o = future.result()
        except Exception as error:
            traceback.print_exc()
            crashed.append(f"  {s.name}: crashed: {type(error).__name__}: {error}")
            continue
        if o is not None:
            found.append(o)
            print(f"{len(found):4}/{tried} {time.time() - begin:5.0f} s  {s.name}", flush=True)
    for _, future in running:
        future.cancel()
    return found, tried, crashed


def limits(text):
    """`30` for every suite, or `singles=150,pairs=40`; suites that are not named run in full."""
    if text is None:
        return {}
    if text.isdecimal():
        return dict.fromkeys(SUITES, int(text))
    found = {name: int(n) for name, _, n in (part.partition("=") for part in text.split(","))}
    if unknown := found.keys() - SUITES.keys():
        raise SystemExit(f"--limit: no suite {', '.join(sorted(unknown))}; there are {', '.join(SUITES)}")
    return found


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=100, help="base of all seeds")
    parser.add_argument("--suites", default=",".join(SUITES))
    parser.add_argument("--limit", help="logs per suite: one number, or singles=150,pairs=40")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path, help="write every outcome, after each suite")
    parser.add_argument("--peer", type=Path, help="folder of the prototype")
    parser.add_argument("--peer-python", default=sys.executable, help="a Python with numpy, scipy and numba")
    parser.add_argument("--peer-every", type=int, default=1, metavar="K", help="the prototype on every K-th log only")
    parser.add_argument("--new-drives", action="store_true", help="predict another drive of each pack, without refit")
    parser.add_argument("--experiments", type=int, default=0, help="tied pairs whose next experiment is driven")
    parser.add_argument("--gateway", type=int, default=0, help="right verdicts whose model files run in `analyze`")
    parser.add_argument("--quiet", action="store_true", help="no line per log on the way")
    return parser.parse_args()


def main():
    args = options()
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # the workers'
    peer = None if args.peer is None else Peer(args.peer, args.peer_python)
    if peer is None:
        print("no --peer: the prototype does not run beside")
    most, found, begin = limits(args.limit), [], time.time()
    with ProcessPoolExecutor(args.jobs, multiprocessing.get_context("spawn")) as pool:
        for suite in filter(None, args.suites.split(",")):
            some = []
            chosen = scenarios(suite, args.seed, most.get(suite))
            for o in outcomes(suite, chosen, pool, peer, args.peer_every, args.new_drives):
                some.append(o)
                if not args.quiet:
                    at = f"{len(found) + len(some):4} {time.time() - begin:5.0f} s "
                    print(at, *(misses([o]) or [f"ok {o['name']}"]), flush=True)
            found += some
            print(f"\n{suite}, {time.time() - begin:.0f} s", *table(some), "", *misses(some), "", sep="\n", flush=True)
            if args.json:
                args.json.write_text(json.dumps(found))
        studies = studied(args, pool, begin)
    if peer is not None:
        peer.close()
    report(found)
    for name, lines in studies.items():
        print(f"\n{name}", *lines, sep="\n")


def studied(args, pool, begin):
    """Run what was asked for beyond the suites: lines by name."""
    studies = {}
    for name, wanted, study, some, told in (
        ("experiments", args.experiments, experiment, confusable(args.seed), experiments_report),
        ("gateway", args.gateway, gateway, hidden_ones(args.seed), gateway_report),
    ):
        if not wanted:
            continue
        outcome, tried, crashed = tries(study, some, pool, wanted, args.jobs, begin)
        studies[name] = told(outcome, tried) + crashed
        print(f"\n{name}", *studies[name], "", sep="\n", flush=True)
        if args.json:
            args.json.with_suffix(f".{name}.json").write_text(json.dumps(outcome))
    return studies


def report(found):
    if not found:
        return
    for title, lines in (
        (f"{len(found)} logs", table(found)),
        ("hidden: named", confusion(found)),
        ("numbers outside their intervals", by_effect(found)),
        ("misses", misses(found)),
        ("the prototype's misses", misses(found, "peer")),
    ):
        if lines:
            print(f"\n{title}", *lines, sep="\n")


if __name__ == "__main__":
    main()
