"""False alarms of the watch over heat: hours of strings with nothing wrong, kept in a file that later runs add to.

`python -m tests.benchmarks.heat_life FILE [--hours 10000] [--first 20000] [--layout NAME] [--cores N]`

Strings come from `heat_case`, each for three or six hours with a frame a second: small, liquid-cooled and forced-air
cells, three drives and rest, steps of 0.1 and 0.5 K, normal life at its hardest. Each line of the file is a batch of
strings: which, for how long, and each alert. Lines of another state of the code under test do not count. Every alert
is false.
"""

import argparse
import hashlib
import json
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from itertools import count, islice, product
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from scipy.special import gammaincinv

from bms_gateway import health
from tests.benchmarks.bench_heat import follow
from tests.benchmarks.heat_case import LAYOUTS, PACKS, Case, make, with_seeds

FIRST_SEED = 20_000
BATCH = 36
HOURS = (3, 3, 6)
"""Of the strings of successive rounds through all kinds: what an hour has settled is tried as well as starts."""
KINDS = tuple(product(PACKS, ("urban", "us06", "udds", "rest"), (0.1, 0.5)))


def state() -> str:
    """Give a name to the state of the code under test."""
    files = sorted((Path(health.__file__).parent / "heat").glob("*.py"))
    return hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:12]


def upper(alerts: int, hours: float) -> float:
    """Rate per 1,000 h that is exceeded with a probability of 5 % at most (Poisson, exact).

    >>> round(upper(0, 3000.0), 2)
    1.0
    """
    return float(gammaincinv(alerts + 1, 0.95)) / hours * 1e3


def batch(number: int, first: int, layout: str) -> dict[str, object]:
    """Watch one batch of sound strings."""
    cells, sensors, cell = LAYOUTS[layout]
    pack, drive, step = KINDS[number % len(KINDS)]
    seconds = 3600 * HOURS[number // len(KINDS) % len(HOURS)]
    volts = bool(number // len(KINDS) % 2)  # rounds without and with the voltage on the bus
    sound = Case(pack, 0, seconds, drive, at=seconds, step=step, cells=cells, sensors=sensors, cell=cell, volts=volts)
    seeds = range(first + number * BATCH, first + (number + 1) * BATCH)
    told = follow(make(with_seeds(sound, seeds)))
    alerts = [[seed, *a] for seed, t in zip(seeds, told, strict=True) for a in t.alerts]
    kind = {"pack": pack, "drive": drive, "step": step, "layout": layout, "volts": volts}
    return kind | {"seed": seeds.start, "hours": BATCH * seconds / 3600, "alerts": alerts}


def summary(lines: list[dict]) -> str:
    """Tell total hours, false alerts by code, and their rates with a bound."""
    hours = sum(x["hours"] for x in lines)
    codes = Counter(a[2] for x in lines for a in x["alerts"])
    n = sum(codes.values())
    text = f"{hours:.0f} h of sound strings, {n} alert{'' if n == 1 else 's'}"
    for code in ("unexplained_heat", *sorted(codes.keys() - {"unexplained_heat"})):
        n = codes[code]
        text += f"\n  {code}: {n}, {n / hours * 1e3:.2f} per 1,000 h, with 95 % below {upper(n, hours):.2f}"
    return text


def main() -> None:
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("file", type=Path, help="JSON lines; made if absent, else added to")
    ask.add_argument("--hours", type=float, default=1e4, help="in all, with those of the file")
    ask.add_argument("--first", type=int, default=FIRST_SEED)
    ask.add_argument("--layout", choices=LAYOUTS, default="three sensors")
    ask.add_argument("--cores", type=int, default=1)
    args = ask.parse_args()
    now = state()
    text = args.file.read_text(encoding="utf-8").splitlines() if args.file.exists() else []
    lines = [x for x in map(json.loads, text) if x["state"] == now and x["layout"] == args.layout]
    done, hours = {x["seed"] for x in lines}, sum(x["hours"] for x in lines)
    left = (n for n in count() if args.first + n * BATCH not in done)
    with ProcessPoolExecutor(args.cores) as pool, args.file.open("a", encoding="utf-8") as f:
        while hours < args.hours:
            some = list(islice(left, args.cores))
            for found in pool.map(batch, some, *([x] * len(some) for x in (args.first, args.layout))):
                lines.append(found | {"state": now})
                f.write(json.dumps(lines[-1]) + "\n")
                f.flush()
                hours += found["hours"]
            print(f"{hours:6.0f} h: {sum(len(x['alerts']) for x in lines)} alerts", file=sys.stderr, flush=True)
    print(summary(lines))


if __name__ == "__main__":
    main()
