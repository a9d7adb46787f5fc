"""Diagnose all given records of real cells, and tell which names are impossible there.

    python -m tests.benchmarks.bench_measured_records [--json OUT] [NAME ...]

Each record goes through the command `diagnose` with a data-sheet model, as a user would do it.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path

from bms_gateway.cli.main import main as command
from tests.benchmarks.measured_records import RECORDS, MeasuredRecord

SLOWEST_S = 900.0


def diagnosed(record: MeasuredRecord) -> dict:
    """The verdict on one record: what is named, what of it is impossible, the sentence, the CPU time."""
    with tempfile.TemporaryDirectory() as name:
        table, model = record.write(Path(name))
        out, err = Path(name) / "out.json", io.StringIO()
        begun = time.process_time()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(err):
            status = command(["diagnose", str(table), "--model", str(model), "--json", str(out)])
        seconds = time.process_time() - begun
        if status != 0 or not out.exists():
            return {
                "record": record.name,
                "verdict": "refused",
                "named": [],
                "impossible": [],
                "looks": [],
                "held": [None, None],
                "sentence": err.getvalue().strip().splitlines()[-1],
                "cpu_s": seconds,
            }
        told = json.loads(out.read_text(encoding="utf-8"))
    named = [s["effect"] + (f":{s['cell']}" if s["cell"] else "") for s in told["selected"]]
    return {
        "record": record.name,
        "verdict": told["verdict"],
        "named": named,
        "impossible": [n for n in named if n.partition(":")[0] in record.impossible],
        "looks": told["looks_like"],
        "held": [told["baseline"]["heldout_rmse_K"], told["after"]["heldout_rmse_K"]],
        "noise": told["baseline"]["noise_floor_K"],
        "parameters": told["parameters"],
        "sentence": told["sentence"],
        "cpu_s": seconds,
    }


def table(rows: list[dict]) -> str:
    """As Markdown."""
    known = {r.name: r.known for r in RECORDS}
    lines = [
        "| record | verdict | named | impossible | held-out K before, after | known | CPU s |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in rows:
        held = ", ".join("–" if x is None else f"{x:.3g}" for x in r["held"])
        names = ", ".join(r["named"]) or (f"(looks like {', '.join(r['looks'])})" if r["looks"] else "–")
        wrong = ", ".join(r["impossible"]) or "–"
        lines.append(
            f"| {r['record']} | {r['verdict']} | {names} | {wrong} | {held} | {known[r['record']]} | {r['cpu_s']:.0f} |"
        )
    count = sum(len(r["impossible"]) for r in rows)
    return "\n".join([*lines, "", f"impossible effects named: {count} in {len(rows)} records"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a record's name; all where none is given")
    parser.add_argument("--json", type=Path, metavar="OUT")
    args = parser.parse_args()
    rows = []
    for record in RECORDS:
        if args.names and not any(n in record.name for n in args.names):
            continue
        rows.append(diagnosed(record))
        print(
            f"{rows[-1]['record']}: {rows[-1]['verdict']} {rows[-1]['named']} {rows[-1]['sentence']}",
            file=sys.stderr,
            flush=True,
        )
        if args.json:
            args.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    print(table(rows))
    return int(any(r["impossible"] for r in rows))


if __name__ == "__main__":
    sys.exit(main())
