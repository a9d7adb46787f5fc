"""Is the band that is stated with a core temperature honest? Cores that are known, and never shown to the product.

``python -m tests.benchmarks.bench_honesty --only measured [--cases hev2,insulated] [--priors default,wide]``
``python -m tests.benchmarks.bench_honesty --only simulated [--limit 40] [--seed 1] [--cases radial,outside]``
``… [--after plain,fit,radial_gradient] [--root DIR] [--peers auto|none|all] [--jobs 2] [--json F]``

Every case goes the road that a user has: a table is encoded to frames of our DBC, `analyze` reads them, estimates.csv
is held against the true core from minute ten on, and from minute thirty on ("late"). Measured: real cells with a
thermocouple in the core, each without and with the cell's voltage on the bus. Simulated: strings of 5 to 12 cells with
three sensors, and single cells, by the independent truth: every effect of the catalogue missing, effects that are in
no catalogue, nothing hidden, and a flow that varies unrecorded; ``--limit`` takes of each kind its share.

Peers in the same run: the prior alone (`[identify] method = "off"`), the prototype where it lies beside the
measurements, of measured cells also core = surface and the steady one-liner with the Biot number of a sister record;
``auto`` takes them with the measured cells only. ``--after``: the model as it is, fitted to the same record before, or
with an effect added to it (`all`: each of the catalogue). ``--root``: the package of another checkout on the same
cases, paired.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks import honesty_measured, honesty_simulated
from tests.benchmarks.honesty_case import Case, Outcome, scored
from tests.benchmarks.honesty_measured import measured_cells
from tests.benchmarks.honesty_peer import prototype, prototype_states
from tests.benchmarks.honesty_road import ROOT, RefusedError, drive_through
from tests.benchmarks.honesty_simulated import CHUNK, chosen, drives, simulated
from tests.benchmarks.honesty_tables import HEAD, case_lines, compared, measured_summary, simulated_summary
from tests.truth.sizes import SIZES

OURS, BEFORE, ALONE, PROTOTYPE = "ours", "before", "prior alone", "prototype"
PRIORS = {"measured": honesty_measured.PRIORS, "simulated": honesty_simulated.PRIORS}


@dataclass(frozen=True)
class Work:
    """One method on one case: `states` gives the outcome."""

    case: Case
    priors: str
    method: str
    states: Callable[[], Outcome]

    def attempt(self) -> Outcome:
        """Do it; a failure is told with the others' results."""
        try:
            return self.states()
        except RefusedError:
            return Outcome(self.case.label, self.case.kind, self.priors, self.method, refused=True)
        except (RuntimeError, ValueError) as error:
            return Outcome(self.case.label, self.case.kind, self.priors, self.method, error=str(error))


def by_product(
    c: Case, folder: Path, table: Path, priors: str, method: str, root: Path = ROOT, after: str = ""
) -> Work:
    """What the package of a checkout states."""
    known = f"{priors} + {after}" if after else priors

    def states() -> Outcome:
        mine = Path(tempfile.mkdtemp(dir=folder))
        config = c.write_config(mine, priors, "off" if method == ALONE else "window")
        s = drive_through(root, table, config, mine / "out", after)
        scores = scored(c, s.time_s, s.core, s.sd, s.told)
        return Outcome(c.label, c.kind, known, method, scores, s.since, s.seconds)

    return Work(c, known, method, states)


def by_prototype(c: Case, table: Path, script: Path) -> Work:
    def states() -> Outcome:
        at, core, sd = prototype_states(script, table, c.numbers, cells=c.cells, voltage=c.has_voltage)
        return Outcome(c.label, c.kind, "its own", PROTOTYPE, scored(c, at + c.time_s[0], core, sd))

    return Work(c, "its own", PROTOTYPE, states)


def without_band(c: Case, method: str, core: np.ndarray) -> Work:
    return Work(
        c, "none", method,
        lambda: Outcome(c.label, c.kind, "none", method, scored(c, c.time_s, core, np.zeros(core.shape))),
    )  # fmt: skip


def cases(args: argparse.Namespace) -> Iterator[Case]:
    if args.only != "simulated":
        yield from measured_cells(args.cases)
    if args.only != "measured":
        yield from simulated(chosen(drives(args.seed), args.limit, args.seed, args.cases))


def works(args: argparse.Namespace, folder: Path) -> Iterator[Work]:
    """Everything that is to be computed, case by case as these are made."""
    script = prototype()
    for c in cases(args):
        table = c.write_table(Path(tempfile.mkdtemp(dir=folder)))
        peers = args.peers == "all" or (args.peers == "auto" and c.kind == "measured")
        for priors in args.priors:
            if priors not in PRIORS["measured" if c.kind == "measured" else "simulated"]:
                continue
            for after in args.after:
                yield by_product(c, folder, table, priors, OURS, after=after)
                if args.root is not None:
                    yield by_product(c, folder, table, priors, BEFORE, args.root, after)
            if peers:
                yield by_product(c, folder, table, priors, ALONE)
        if peers and script is not None:
            yield by_prototype(c, table, script)
        if peers and isinstance(c, honesty_measured.MeasuredCell) and not c.has_voltage:
            yield without_band(c, "core = surface", c.surface)
            if (line := c.one_liner()) is not None:
                yield without_band(c, "one-liner", line)


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)

    def listed(text: str) -> list[str]:
        return [x for x in text.split(",") if x]

    parser.add_argument("--only", choices=("measured", "simulated"), help="one part; both where it is not given")
    parser.add_argument("--cases", type=listed, default=[], help="parts of names of records, effects or kinds")
    every = list(dict.fromkeys(name for p in PRIORS.values() for name in p))
    parser.add_argument("--priors", type=listed, default=["default"], help=f"of {', '.join(every)}")
    parser.add_argument("--after", type=listed, default=["plain"], help="plain, fit, all, or names of effects")
    parser.add_argument("--seed", type=int, default=1, help="of the simulated packs and drives")
    parser.add_argument("--limit", type=int, help="simulated drives at most, of each kind its share")
    parser.add_argument("--root", type=Path, help="another checkout, to compare with case by case")
    parser.add_argument("--peers", choices=("auto", "none", "all"), default="auto")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", type=Path, help="write every outcome")
    parser.add_argument("--quiet", action="store_true", help="no line per case")
    args = parser.parse_args()
    valid = PRIORS[args.only] if args.only else every
    if unknown := set(args.priors) - set(valid):
        parser.error(f"--priors: no {', '.join(sorted(unknown))}; there are {', '.join(valid)}")
    effects = list(SIZES)
    if unknown := set(args.after) - {"plain", "fit", "all", *effects}:
        parser.error(f"--after: no {', '.join(sorted(unknown))}; there are plain, fit, all, {', '.join(effects)}")
    args.after = [x for a in args.after for x in (effects if a == "all" else [a.replace("plain", "")])]
    if args.root is not None and not (args.root / "bms_gateway" / "cli" / "main.py").exists():
        parser.error(f"--root: {args.root} holds no bms_gateway")
    return args


def attempted(some: Iterable[Work], jobs: int) -> Iterator[Outcome]:
    """Outcomes in the order of the works; a few are made ahead, for a simulated record waits in memory."""
    waiting: deque[Future[Outcome]] = deque()
    with ThreadPoolExecutor(jobs) as pool:
        for w in some:
            waiting.append(pool.submit(w.attempt))
            if len(waiting) > 2 * CHUNK:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def main() -> None:
    args, begin = options(), time.time()
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")  # the children's
    outcomes: list[Outcome] = []
    if not args.quiet:
        print(HEAD)
    with tempfile.TemporaryDirectory() as folder:
        for o in attempted(works(args, Path(folder)), args.jobs):
            outcomes.append(o)
            if not args.quiet or o.error:
                print(*case_lines(o), sep="\n", flush=True)
    measured = [o for o in outcomes if o.kind == "measured"]
    driven = [o for o in outcomes if o.kind != "measured"]
    report(measured, driven)
    print(f"{len(outcomes)} outcomes, {time.time() - begin:.0f} s")
    if args.json:
        args.json.write_text(json.dumps([asdict(o) for o in outcomes], indent=1))
    if any(o.error for o in outcomes):
        sys.exit(1)


def report(measured: list[Outcome], driven: list[Outcome]) -> None:
    print("", *measured_summary(measured), *compared(measured, OURS, BEFORE), sep="\n")
    print(*simulated_summary(driven), *compared(driven, OURS, BEFORE), "", sep="\n")


if __name__ == "__main__":
    main()
