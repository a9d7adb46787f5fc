"""`export`: the gateway's recent decoded signals as a table."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from bms_gateway.store.rows import Excerpt

EXAMPLE = """\
  bms-gateway export --last 2h --out drive.csv --config /etc/bms-gateway/gateway.toml --string string_1
  bms-gateway compare drive.csv --model string_1.toml
  bms-gateway diagnose drive.csv --model string_1.toml

works while the service runs, and after; a row for every instant at which a signal of the string came
"""
STATE_DIRECTORY = Path("/var/lib/bms-gateway")
"""Where the service that `install.sh` sets up keeps its state."""
UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86_400.0}
_SPAN = re.compile(r"(\d+(?:\.\d+)?) ?([A-Za-z]*)")


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option(
        "--last", metavar="SPAN", required=True, help="how much, back from the newest signal: 90s, 30min, 2h, 1d"
    )
    parser.option("--out", metavar="TABLE.csv", required=True, help="table to write, as compare and diagnose read it")
    parser.option("--string", metavar="NAME", help="string, where the gateway has several")
    parser.option("--config", metavar="C", type=Path, help="the gateway's config: its [store] says where the record is")
    parser.option(
        "--store", metavar="DIR", type=Path, help=f"the gateway's state directory (default: {STATE_DIRECTORY})"
    )
    parser.option("--json", metavar="FILE", help="write what was done as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Write the table."""
    from bms_gateway.store.rows import excerpt

    seconds = given_span(args.last)
    if args.out == "-":
        raise UsageError("export: --out -: the table is a file; name it, such as TABLE.csv")
    outputs = {"--out": args.out, "--json": args.json}
    writable(outputs)
    distinct(outputs, [args.config] if args.config else [])
    directory = _store(args.config, args.store) / "recent"
    found = excerpt(directory, seconds)
    for problem in found.problems:
        note(str(problem))
    name = _string(found, args.string)
    if found.turned_back:
        note("the clock went back in this time: what was recorded before that is left out, it cannot be the same table")
    rows, first, last = _write(Path(args.out), found, name)
    span = last - first
    if args.json:
        write_json(args.json, {"table": args.out, "string": name, "rows": rows, "from_s": first, "to_s": last})
    say(f"{args.out}: {rows} rows, {span / 60.0:.1f} min of {name}: {', '.join(found.columns[name])}", args.json)
    return 0


def given_span(words: str) -> float:
    """Read a span of time as people write it, s.

    Raises
    ------
    UsageError

    Examples
    --------
    >>> given_span("90s"), given_span("30min"), given_span("1.5h"), given_span("1d")
    (90.0, 1800.0, 5400.0, 86400.0)
    """
    match = _SPAN.fullmatch(words.strip())
    if match is None:
        raise UsageError(f"export: --last '{words}': expected a number with its unit: 90s, 30min, 2h or 1d")
    number, unit = match.groups()
    if unit not in UNITS:
        what = f"unknown unit '{unit}'" if unit else "the unit is missing"
        near = {"m": "min", "sec": "s", "mins": "min", "hours": "h", "hour": "h", "days": "d", "day": "d"}.get(unit)
        hint = f"; did you mean {number}{near}?" if near else ""
        raise UsageError(f"export: --last '{words}': {what}; valid: {', '.join(UNITS)}, as in 90s, 30min, 2h, 1d{hint}")
    seconds = float(number) * UNITS[unit]
    if not 0.0 < seconds <= 3660 * UNITS["d"]:
        raise UsageError(f"export: --last '{words}': must be above 0 and at most ten years")
    return seconds


def _store(config: Path | None, store: Path | None) -> Path:
    """Find the state directory: as told, as the config says, or where the installed service has it."""
    if store is not None:
        if config is not None:
            raise UsageError("export: --store and --config both say where to look: give one of them")
        if not store.is_dir():
            raise UsageError(f"export: --store {store}: no such directory")
        return store
    if config is None:
        return STATE_DIRECTORY
    from bms_gateway.config import load_config

    return load_config(config).store or STATE_DIRECTORY


def _string(found: "Excerpt", name: str | None) -> str:
    names = list(found.columns)
    if name is None:
        if len(names) > 1:
            raise UsageError(f"export: --string is needed, several are recorded; valid: {', '.join(names)}")
        return names[0]
    if name not in names:
        raise UsageError(f"export: --string '{name}' is not recorded in this time{did_you_mean(name, names)}")
    return name


def _write(out: Path, found: "Excerpt", name: str) -> tuple[int, float, float]:
    """Write beside its place and put it there when it is whole; rows, first and last time."""
    from bms_gateway.bus.whole import whole
    from bms_gateway.report.progress import progress

    first_us, last_us = found.first_us, found.last_us
    count, first, last = 0, 0.0, 0.0
    with whole(out) as part, part.open("w", encoding="utf-8", newline="\n") as f:
        f.write(",".join(("time_s", *found.columns[name])) + "\n")
        with progress("exporting", (last_us - first_us) * 1e-6) as advance:
            for row in found.rows(name):
                f.write(",".join(row) + "\n")
                last_before, last = last, float(row[0])
                first = last if not count else first
                advance(last - last_before if count else 0.0)
                count += 1
    return count, first, last
