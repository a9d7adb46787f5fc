"""`reproduce`: the paper's figures and tables beside ours, computed here and now."""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, folder_for, say, writable, write_json
from bms_gateway.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from bms_gateway.reproduce import Section, Size

SEEDS, MOST_SEEDS = 8, 1000
REPORT = "report.txt"
EXAMPLE = """
  bms-gateway reproduce
  bms-gateway reproduce --out figures --json reproduction.json
  bms-gateway reproduce string observability
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("section", nargs="*", metavar="SECTION", help="only these sections; default all")
    parser.option("--out", metavar="DIR", help="folder for the figures (PNG) and the text; needs the extra 'report'")
    parser.option("--json", metavar="FILE", help="write every row as JSON; - is standard output")
    parser.option(
        "--seeds", metavar="N", type=int, default=SEEDS, help=f"noise realisations per condition (default {SEEDS})"
    )
    parser.option(
        "--jobs", metavar="N", type=int, help="processes to use (default: as many as there are cores, up to 4)"
    )


def run(args: argparse.Namespace) -> int:
    """Compute the sections and tell them."""
    from bms_gateway.report.reproduce_figures import drawing
    from bms_gateway.report.reproduce_text import text
    from bms_gateway.reproduce import SECTIONS, Size

    if not 2 <= args.seeds <= MOST_SEEDS:
        raise UsageError(f"reproduce: --seeds {args.seeds}: valid: 2 to {MOST_SEEDS}")
    if args.jobs is not None and args.jobs < 1:
        raise UsageError(f"reproduce: --jobs {args.jobs}: at least 1")
    for name in args.section:
        if name not in SECTIONS:
            raise UsageError(f"reproduce: no section '{name}'{did_you_mean(name, SECTIONS)}")
    out = _folder(args.out) if args.out is not None else None
    writable({"--json": args.json})
    if out is not None:
        drawing()
        distinct({f"--out {REPORT}": out / REPORT, "--json": args.json}, [])
    chosen = [name for name in SECTIONS if not args.section or name in args.section]
    sections = _computed(chosen, Size(args.seeds), args.jobs or min(4, os.cpu_count() or 1))
    report = text(sections, args.seeds)
    if out is not None:
        count = _write(out, sections, report)
        report += f"\n\n{out}: {count} figures and {REPORT}"
    if args.json:
        write_json(args.json, document(sections, args.seeds))
    say(report, args.json)
    return 0


def document(sections: "list[Section]", seeds: int) -> dict[str, Any]:
    """Return the result for machines: one entry per row, in the order of the text."""
    return {
        "paper": "X. Lin et al., Parameterization and Observability Analysis of Scalable Battery Clusters for Onboard "
        "Thermal Management",
        "seeds": seeds,
        "rows": [{"section": s.id, **row.as_json()} for s in sections for row in s.rows],
    }


def _folder(given: str) -> Path:
    path = folder_for("reproduce", given, "the figures")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise UsageError(f"--out {given}: cannot be made: {e.strerror}") from None
    if not os.access(path, os.W_OK):
        raise UsageError(f"--out {given}: cannot be written: permission denied")
    return path


def _write(out: Path, sections: "list[Section]", report: str) -> int:
    """Write the figures and the text; returns how many figures."""
    from bms_gateway.report.reproduce_figures import draw
    from bms_gateway.whole import whole, whole_text

    figures = [f for s in sections for f in s.figures]
    path = out / REPORT
    try:
        with whole_text(path) as text_file:
            text_file.write(report + "\n")
        for figure in figures:
            path = out / f"{figure.name}.png"
            with whole(path) as file:
                draw(figure, file)
    except OSError as e:
        raise UsageError(f"--out {path}: cannot be written: {e.strerror}") from None
    return len(figures)


def _computed(names: list[str], size: "Size", jobs: int) -> "list[Section]":
    """Compute the sections, the longest first, and return them in the order asked for."""
    from bms_gateway.report.progress import progress
    from bms_gateway.reproduce import WEIGHTS

    order = sorted(names, key=lambda name: -WEIGHTS.get(name, 0.5))
    done: dict[str, Section] = {}
    with progress("reproducing", sum(WEIGHTS.get(name, 0.5) for name in names)) as advance:
        for name, section in _run(order, size, min(jobs, len(order))):
            done[name] = section
            advance(WEIGHTS.get(name, 0.5))
    return [done[name] for name in names]


def _run(names: list[str], size: "Size", jobs: int) -> "Iterator[tuple[str, Section]]":
    if jobs == 1:
        for name in names:
            yield name, compute(name, size)
        return
    from concurrent.futures import as_completed

    from bms_gateway.report.processes import processes

    with processes(jobs) as pool:
        running = {pool.submit(compute, name, size): name for name in names}
        for future in as_completed(running):
            yield running[future], future.result()


def compute(name: str, size: "Size") -> "Section":
    """Compute one section; the same in this process and in another."""
    from bms_gateway.reproduce import SECTIONS

    return SECTIONS[name](size)
