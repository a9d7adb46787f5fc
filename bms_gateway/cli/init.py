"""`init`: from the logs and the DBC of a vehicle to a config, its models and the first cores."""

import argparse
import os
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_gateway.cli.main import Parser
from bms_gateway.errors import counted

if TYPE_CHECKING:
    from bms_gateway.setup.proposal import Proposal, Proposed, Role
    from bms_gateway.setup.settle import Settled
    from bms_gateway.setup.vehicle_logs import Traffic
    from bms_gateway.setup.without_dbc import Guess
    from bms_gateway.thermal.cells import CellFacts, Chemistry

EXAMPLE = """
  bms-gateway init drive.log.gz --dbc vehicle.dbc --out my_vehicle
  bms-gateway init drive.mf4 --dbc vehicle.dbc --cell "21700 5Ah 69g 25mOhm 4p" --out my_vehicle --yes
"""
SHOWN = 60
UNUSED_SHOWN = 6
GUESSED = "guessed.dbc"
READ_AS = {
    "current": (1.0, "A"),
    "voltage": (1.0, "V"),
    "temperature": (1.0, "°C"),
    "soc": (100.0, "%"),
    "flow": (60_000.0, "l/min"),
}
"""By the kind of a quantity: factor from SI to the unit of the terminal's table, and this unit."""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("log", nargs="+", type=Path, metavar="LOG", help="logs of the vehicle, the longer the better")
    parser.option("--dbc", action="append", default=[], type=Path, metavar="FILE", help="DBC; may be given again")
    parser.option(
        "--cell", metavar="NAME", help="which cells, as `cells` takes them: lg_m50, '21700 5Ah 69g 25mOhm 2p'"
    )
    parser.option("--out", default="my_vehicle", metavar="DIR", help="folder for the config; default my_vehicle")
    parser.option("--yes", action="store_true", help="take the likeliest signals without asking")
    parser.option("--json", metavar="FILE", help="write what was found as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Propose, ask, write, estimate; 1 if a current or every thermocouple is missing."""
    from bms_gateway.cli.output import distinct, folder_for, note, writable
    from bms_gateway.records.once import given_once, in_order
    from bms_gateway.setup.propose import propose
    from bms_gateway.setup.vehicle_logs import read_traffic
    from bms_gateway.thermal.cells import cell_of

    out = folder_for("init", args.out, "the config")
    writable({"--json": args.json})
    distinct({"--json": args.json, "--out gateway.toml": out / "gateway.toml"}, [*args.log, *args.dbc])
    given_once(args.log)
    in_order(args.log)
    cell = cell_of(args.cell) if args.cell is not None else None
    traffic = read_traffic(args.log, args.dbc)
    chemistry = cell.chemistry if cell is not None else None
    proposal = propose(traffic, chemistry=chemistry)
    for remark in proposal.remarks:
        note(remark)
    if not _may_write(out, args):
        return 1
    if _asks(args):
        proposal = _ask(traffic, proposal, chemistry)
    return _write(args, out, cell, traffic, proposal)


def _write(
    args: argparse.Namespace, out: Path, cell: "CellFacts | None", traffic: "Traffic", proposal: "Proposal"
) -> int:
    """Write the config, estimate with it, and print the next commands."""
    from bms_gateway.cli.output import note, say, write_json
    from bms_gateway.records.signal_use import advice
    from bms_gateway.setup.picture import draw
    from bms_gateway.setup.settle import missing, settle
    from bms_gateway.setup.taken_back import taken_back

    why_not = missing(proposal, traffic)
    guesses = _guessed(out, traffic) if why_not and not traffic.messages else []
    if why_not:
        if args.json:
            write_json(
                args.json, document(proposal) | ({"guesses": [g.document() for g in guesses]} if guesses else {})
            )
        if proposal.signals:
            say(_table(proposal), args.json)
        say(why_not, args.json)
        if guesses:
            _tell_guesses(guesses, out, args)
        return 1
    with taken_back(out):
        kept = keep(out / "gateway.toml") if (out / "gateway.toml").exists() else None
        settled = settle(proposal, traffic, out, cell=cell, logs=args.log)
        picture = draw(settled.cores, out / "cores.png")
    written = settled.written
    if kept is not None:
        note(f"{out / 'gateway.toml'} was there already: kept as {kept.name}")
    if args.json:
        write_json(args.json, document(proposal))
    say(_table(proposal), args.json)
    for text in settled.notes:
        note(text)
    if cell is None:
        note("the cell is unknown (--cell): its size is a guess, and so the cores are sent as doubtful")
    for text in list(advice(settled.uses))[:10]:
        say(text, args.json)
    _show(settled, int(traffic.frames.time_ns[0]), picture, args.json)
    logs = " ".join(str(p) for p in args.log)
    beside = len(written.files) - 1
    say(f"{written.config}: written, with {counted(beside, 'file')} beside it. Next:", args.json)
    say(f"  bms-gateway check {written.config} --log {args.log[0]}", args.json)
    say(f"  bms-gateway analyze {logs} --config {written.config} --out {out / 'results'}", args.json)
    return 0


def _guessed(out: Path, traffic: "Traffic") -> "list[Guess]":
    """Guess the signals without a DBC, and write the guess as a DBC; an older file of that name is replaced."""
    import numpy as np

    from bms_gateway.errors import UsageError
    from bms_gateway.setup.guessed_dbc import guessed_dbc
    from bms_gateway.setup.taken_back import taken_back
    from bms_gateway.setup.without_dbc import guess
    from bms_gateway.whole import whole_text

    frames = traffic.frames
    guesses = guess(frames)
    if guesses:
        ids = {f.can_id for g in guesses for f in (g.field, *g.beside)}
        length = {i: int(np.median(frames.length[frames.can_id == i])) for i in ids}
        try:
            with taken_back(out):
                out.mkdir(parents=True, exist_ok=True)
                with whole_text(out / GUESSED) as file:
                    file.write(guessed_dbc(guesses, length))
        except OSError as e:
            raise UsageError(f"--out {out}: cannot be written: {e.strerror}") from None
    return guesses


def _tell_guesses(guesses: "list[Guess]", out: Path, args: argparse.Namespace) -> None:
    from bms_gateway.cli.output import say
    from bms_gateway.report.show import text_table
    from bms_gateway.setup.bit_fields import name_of

    rank = dict.fromkeys(("current", "voltage", "surface"), 0)
    rows = []
    for g in guesses:
        rank[g.role] += 1
        also = f" and {len(g.beside)} more" if g.beside else ""
        rows.append([f"{g.role} {rank[g.role]}", name_of(g.field) + also, f"{g.scale:g}, {g.offset:.4g}", g.why])
    say(
        "GUESSES from the movement of the bits alone, the likeliest first; scales are usual ones, no measurement:",
        args.json,
    )
    say(text_table(["guess", "where", "scale, offset", "why"], rows, left=4), args.json)
    logs = " ".join(str(p) for p in args.log)
    say(f"{out / GUESSED}: written. Hold it against a clamp meter and a thermometer, correct it, then:", args.json)
    cell = f" --cell {shlex.quote(args.cell)}" if args.cell is not None else ""
    say(f"  bms-gateway init {logs} --dbc {out / GUESSED}{cell} --out {out}", args.json)


def _asks(args: argparse.Namespace) -> bool:
    return not args.yes and sys.stdin.isatty() and sys.stdout.isatty() and args.json != "-"


def _may_write(out: Path, args: argparse.Namespace) -> bool:
    """Whether an existing config may be replaced."""
    from bms_gateway.errors import UsageError

    there = out / "gateway.toml"
    if not there.exists():
        return True
    if args.yes:
        return True
    if not _asks(args):
        raise UsageError(f"--out {out}: gateway.toml is there already; name another folder, or give --yes")
    return _agrees(f"{there} is there already. Overwrite it?")


def keep(there: Path) -> Path:
    """Keep the existing config under another name, beside earlier ones."""
    from bms_gateway.errors import UsageError
    from bms_gateway.store.files import reading
    from bms_gateway.whole import whole

    names = [there.with_name("gateway.toml.bak"), *(there.with_name(f"gateway.toml.bak{k}") for k in range(2, 1000))]
    kept = next((name for name in names if not name.exists()), names[-1])
    fault = f"--out {there.parent}: {there.name} cannot be kept as {kept.name}"
    try:
        with reading(there) as handle:
            if handle is not None:
                with open(handle, "rb", closefd=False) as old, whole(kept) as copy:
                    os.fchmod(copy.fileno(), os.fstat(handle).st_mode & 0o777)  # before any of it is written
                    copy.write(old.read())
    except OSError as e:
        raise UsageError(f"{fault}: {e.strerror}") from None
    if handle is None:
        raise UsageError(f"{fault}: it is no file")
    return kept


def document(proposal: "Proposal") -> dict[str, Any]:
    """Give the result as a document for machines."""
    return {
        "signals": [_entry(half) for p in proposal.signals for half in p.single],
        "unused": [{"signal": path, "why": why} for path, why in proposal.unused],
        "strings": [{"name": f"string_{k}", "cells": n} for k, n in enumerate(proposal.cells, 1)],
        "series_cells": proposal.series_cells,
        "remarks": proposal.remarks,
    }


def _entry(p: "Proposed") -> dict[str, Any]:
    low, high = p.observed
    scale, offset = p.written
    return {
        "role": p.role,
        "index": p.index,
        "signal": p.path,
        "string": None if p.string is None else f"string_{p.string}",
        "sure": p.sure,
        "observed": [float(f"{low:.7g}"), float(f"{high:.7g}")],
        "resolution": float(f"{p.resolution:.5g}"),
        "rate_Hz": float(f"{p.series.rate_Hz:.4g}"),
        "scale": scale,
        "offset": offset,
        "overrides": p.overrides,
        "statistic": p.statistic,
        "way": p.way,
        "why": p.why,
    }


def _table(proposal: "Proposal") -> str:
    from bms_gateway.frames.vocabulary import INPUTS
    from bms_gateway.report.show import text_table
    from bms_gateway.setup.propose import NO_ROLE

    rows = []
    singly = [half for p in proposal.signals for half in p.single]
    for p in singly[:SHOWN]:
        factor, unit = READ_AS[INPUTS[p.role].kind]
        low, high = (factor * x for x in p.observed)
        where = "" if p.string is None else f"string_{p.string}"
        rows.append(
            [
                _which(p),
                where,
                p.path,
                "yes" if p.sure else "likely",
                f"{low:.4g} … {high:.4g}",
                f"{factor * p.resolution:.3g}",
                unit,
                f"{p.series.rate_Hz:.3g}",
            ]
        )
    lines = [text_table(["role", "string", "signal", "sure", "observed", "step", "unit", "Hz"], rows, left=4)]
    if len(singly) > SHOWN:
        lines.append(f"… and {len(singly) - SHOWN} more")
    lines += _reasons(proposal)[:SHOWN]
    odd = [(path, why) for path, why in proposal.unused if path in proposal.refused]
    lines += [f"not used: {path}: {why}" for path, why in odd[:20]]
    if len(odd) > 20:
        lines.append(f"not used: … and {len(odd) - 20} more thermocouples (--json tells all)")
    unused = [(why != NO_ROLE, path) for path, why in proposal.unused if path not in proposal.refused]
    other = [path for _, path in sorted(unused, key=lambda u: u[0])]  # names of unknown meaning come first
    if other:
        shown = ", ".join(other[:UNUSED_SHOWN]) + (" …" if len(other) > UNUSED_SHOWN else "")
        lines.append(f"{len(other)} other signals have no role here (--json tells the reason for each): {shown}")
    return "\n".join(lines)


def _which(p: "Proposed") -> str:
    """Name the role with its cell, or with the statistic of several cells."""
    if p.index is not None:
        return f"{p.role} {p.index}"
    if p.way is not None:
        return f"{p.role}, {p.way}"
    return f"{p.role} {p.statistic}" if p.statistic else p.role


def _reasons(proposal: "Proposal") -> list[str]:
    """Print why each signal was chosen; signals of one role with the same reasons share a line."""
    alike: dict[tuple[str, str], list[Proposed]] = {}
    for p in proposal.signals:
        without_numbers = re.sub(r"[\d.]+", "", "; ".join(p.why))
        alike.setdefault((p.role, without_numbers), []).append(p)
    lines = ["why:"]
    for group in alike.values():
        more = f" and {len(group) - 1} more" if len(group) > 1 else ""
        why = [w for w in group[0].why if w not in proposal.remarks]  # these are in the table above
        lines.append(f"  {_which(group[0])} ({group[0].path}{more}): {'; '.join(why)}")
    return lines


def _ask(traffic: "Traffic", proposal: "Proposal", chemistry: "Chemistry | None") -> "Proposal":
    """Ask about every uncertain choice for the whole pack; offer the next best signal for a refused one."""
    from bms_gateway.cli.output import note
    from bms_gateway.frames.vocabulary import INPUTS
    from bms_gateway.setup.propose import propose

    refused: dict[str, Role] = {}
    agreed: set[tuple[str, str, int | None]] = set()
    told = set(proposal.remarks)
    while (p := next((p for p in proposal.signals if _unsure(p) and _place(p) not in agreed), None)) is not None:
        factor, unit = READ_AS[INPUTS[p.role].kind]
        low, high = (factor * x for x in p.observed)
        instead = "next best " if p.role in refused.values() else ""
        if _agrees(f"{instead}{p.role}: {p.path} ({low:.4g} … {high:.4g} {unit}; {'; '.join(p.why[:3])})?"):
            agreed.add(_place(p))
            continue
        refused[p.path] = p.role
        proposal = propose(traffic, refused, chemistry)
        for remark in proposal.remarks:
            if remark not in told:
                note(remark)
        told.update(proposal.remarks)
    return proposal


def _unsure(p: "Proposed") -> bool:
    return not p.sure and p.role not in ("surface", "cell_voltage")


def _place(p: "Proposed") -> "tuple[str, str, int | None]":
    return p.role, p.path, p.string


def _agrees(question: str) -> bool:
    print(f"{question} [Y/n] ", end="", flush=True)  # `input` itself may write to standard error
    try:
        return input().strip().lower() in ("", "y", "yes", "j", "ja")
    except EOFError:
        return True


def _show(settled: "Settled", start_ns: int, picture: Path | None, json_target: str | None) -> None:
    import numpy as np

    from bms_gateway.cli.output import say
    from bms_gateway.frames.quality import AVAILABLE_SD_K
    from bms_gateway.records.signal_use import channel_of
    from bms_gateway.report.hottest import hottest_sentence
    from bms_gateway.report.show import cells_table
    from bms_gateway.setup.picture import no_picture

    cores = settled.cores
    if cores.last is None:
        say("no core could be estimated from this log: too short, or no sample was believed", json_target)
        return
    if cores.unknown_s > 0:
        say(f"in the last {cores.unknown_s:.0f} s no core is known to {AVAILABLE_SD_K:g} K; before that:", json_target)
    for cells in cores.last.strings():
        if np.isfinite(cells.core).any():
            say(cells_table(cells), json_target)
        else:
            say(f"{cells.string}: no core is known to {AVAILABLE_SD_K:g} K", json_target)
    if cores.hottest is not None:
        channel = channel_of(settled.uses, cores.hottest.string, cores.hottest.cell)
        say(hottest_sentence(cores.hottest, start_ns, channel), json_target)
    if picture is not None:
        steps = "; dotted: a fit gives new parameters, and the core steps there" if cores.fitted_ns else ""
        say(f"picture: {picture}{steps}", json_target)
    else:
        say(no_picture(cores), json_target)
