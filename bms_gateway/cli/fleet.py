"""`fleet`: many logs, one row per vehicle-day and string, and what the vehicles have in common."""

import argparse
import os
from dataclasses import asdict
from heapq import heappop, heappush
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.errors import UsageError, counted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from bms_gateway.fleet.atlas import Atlas
    from bms_gateway.fleet.day import Row
    from bms_gateway.fleet.whole_fleet import Run

EXAMPLE = """
  bms-gateway fleet logs/*/*.log.gz --config gateway.toml --out fleet --vehicle folder
  bms-gateway fleet logs/*.log --config gateway.toml --out fleet --vehicle '(van-[0-9]+)_'
  bms-gateway fleet /share/logs/*.log.gz --config /share/gateway.toml --out fleet --scheduler tcp://10.0.0.1:8786

DIR gets fleet.parquet (one row per log, day and string), atlas.parquet (errors by cell and regime over the vehicles)
and logs/ (a file per log). Run again, only logs that are new or changed are analysed. A log that cannot be read has a
row that says why, and the exit status is 1; it is 2 if none of the logs exists. With --scheduler, its workers read the
logs and the config at the same paths as here, and have the same version of bms-gateway[fleet]
"""
MOST_SHOWN = 10


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("log", nargs="+", type=Path, metavar="LOG", help="logs of any vehicles, in any order")
    parser.option("--config", required=True, type=Path, metavar="C", help="the gateway's config, the same for all")
    parser.option("--out", required=True, metavar="DIR", help="folder for the results; kept from run to run")
    parser.option(
        "--vehicle",
        default="file",
        metavar="HOW",
        help="what names a log's vehicle: file (its name, default), folder, or a regular expression searched in its "
        "path, whose first group is the name",
    )
    parser.option("--jobs", type=int, metavar="N", help="processes of this machine (default: one per processor)")
    parser.option("--scheduler", metavar="ADDRESS", help="an existing Dask scheduler, as tcp://host:8786")
    parser.option("--json", metavar="FILE", help="write the summary and the atlas as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Analyse the fleet; 1 where a log could not be used."""
    from bms_gateway.bus.logfile import no_such_log
    from bms_gateway.cli.output import distinct, folder_for, note, say, writable, write_json
    from bms_gateway.config.load import load_config
    from bms_gateway.fleet import parquet
    from bms_gateway.fleet import whole_fleet as fleet
    from bms_gateway.fleet.atlas import draw_atlas
    from bms_gateway.fleet.vehicle_names import vehicle_of
    from bms_gateway.report.progress import progress

    out = folder_for("fleet", args.out, "the results")
    jobs = _jobs(args)
    writable({"--json": args.json})
    loaded = load_config(args.config)
    places = {"--json": args.json} | {f"--out {f}": out / f for f in (fleet.FLEET, fleet.ATLAS_FILE)}
    distinct(places, [*loaded.files, *args.log])
    if not any(log.exists() for log in args.log):
        raise UsageError(no_such_log(args.log[0]))
    logs = [(log, vehicle_of(log, args.vehicle)) for log in once(args.log)]
    with progress("logs", len(logs)) as advance:
        done = fleet.run_fleet(logs, loaded, out, jobs=jobs, scheduler=args.scheduler, advance=advance)
    models = {s.name: str(args.config.parent / s.model) for s in loaded.config.string}
    seen = _Seen()
    atlas = draw_atlas(seen.passing(done.rows()), str(args.config), models)
    try:
        parquet.write_rows(out / fleet.ATLAS_FILE, _positions(atlas), parquet.ATLAS)
    except OSError as e:
        raise UsageError(f"--out {out}: cannot be written: {e.strerror}") from None
    summary = _summary(done, seen, atlas)
    if args.json:
        write_json(args.json, summary)
    say(_text(done, seen, atlas, out), args.json)
    if done.bad:
        rest = f"; all of them: column error of {out / fleet.FLEET}" if len(done.bad) > 1 else ""
        note(f"{len(done.bad)} of {counted(len(logs), 'log')} could not be used: {done.bad[0][1]}{rest}")
    return 1 if done.bad else 0


def _jobs(args: argparse.Namespace) -> int:
    if args.jobs is None:
        return len(os.sched_getaffinity(0))
    if args.jobs < 1:
        raise UsageError(f"fleet: --jobs {args.jobs}: must be at least 1")
    if args.scheduler is not None:
        raise UsageError("fleet: --jobs is for this machine; with --scheduler its workers are as many as they are")
    return int(args.jobs)


def once(logs: list[Path]) -> list[Path]:
    """List each log once, even if patterns of the shell overlap."""
    return list({os.path.realpath(log): log for log in reversed(logs)}.values())[::-1]


def _positions(atlas: "Atlas") -> list["Row"]:
    """Make the rows of atlas.parquet: each place with its finding."""
    kinds = {(f.string, c, r): f.kind for f in atlas.findings for c in f.cells for r in f.regimes}
    return [asdict(p) | {"finding": kinds.get((p.string, p.cell, p.regime))} for p in atlas.positions]


class _Seen:
    """Counts of the rows, which are too many to be kept in memory: their number, the vehicles, the hottest rows."""

    def __init__(self) -> None:
        self.rows = 0
        self.vehicles: set[str] = set()
        self._hottest: list[tuple[float, int, Row]] = []

    def passing(self, rows: "Iterable[Row]") -> "Iterator[Row]":
        from bms_gateway.thermal.centre import compared

        for row in rows:
            self.rows += 1
            self.vehicles.add(row["vehicle"])
            if row["worst_core_C"] is not None:
                rank = float(compared(row["worst_core_C"], row["worst_core_sd_K"] or 0.0))
                heappush(self._hottest, (rank, -self.rows, row))
                if len(self._hottest) > MOST_SHOWN:
                    heappop(self._hottest)
            yield row

    def hottest(self) -> "list[Row]":
        return [row for _, _, row in sorted(self._hottest, key=lambda h: (-h[0], -h[1]))]


def _summary(done: "Run", seen: _Seen, atlas: "Atlas") -> dict[str, Any]:
    return {
        "logs": len(done.parts) + len(done.bad),
        "analysed": done.analysed,
        "skipped": done.skipped,
        "bad": [{"log": log, "error": why} for log, why in done.bad],
        "vehicles": len(seen.vehicles),
        "rows": seen.rows,
        "atlas": {"positions": _positions(atlas), "findings": [asdict(f) for f in atlas.findings]},
    }


def _text(done: "Run", seen: _Seen, atlas: "Atlas", out: Path) -> str:
    from bms_gateway.fleet.atlas import FEWEST_VEHICLES
    from bms_gateway.report.show import number, text_table

    table = [
        [
            r["vehicle"],
            r["day"],
            r["string"],
            f"{number(r['worst_core_C'])} ± {number(r['worst_core_sd_K'])} (cell {r['worst_core_cell']})",
            f"{number(r['R_e_mOhm'])} ± {number(r['R_e_sd_mOhm'])}",
            number(r["growth_pct"]),
            number(r["mismatch"]),
            ", ".join(r["flags"]) or "none",
        ]
        for r in seen.hottest()
    ]
    lines = []
    if table:
        head = ["vehicle", "day", "string", "hottest core °C", "R_e mΩ", "growth %", "mismatch", "flags"]
        lines += [text_table(head, table), ""]
        if seen.rows > len(table):
            lines[-1] = f"the {len(table)} hottest of {counted(seen.rows, 'row')}\n"
    vehicles = len(seen.vehicles)
    lines += [f.sentence for f in atlas.findings[: 2 * MOST_SHOWN]]
    if vehicles < FEWEST_VEHICLES:
        lines.append(
            f"atlas: {counted(vehicles, 'vehicle')}; from {FEWEST_VEHICLES} on it tells the model's errors from defects"
        )
    elif not atlas.findings:
        lines.append(f"atlas: nothing that {vehicles} vehicles have in common, and none that stands out")
    did = f"{counted(done.analysed, 'log')} analysed, {done.skipped} done before, {len(done.bad)} not usable"
    return "\n".join([*lines, f"{did}; {counted(seen.rows, 'row')} in {out / 'fleet.parquet'}"])
