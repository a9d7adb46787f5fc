"""`replay`: logged traffic on a bus, with its own timing."""

import argparse
from dataclasses import asdict
from itertools import chain
from pathlib import Path

from bms_gateway.cli.main import Parser
from bms_gateway.cli.output import distinct, note, say, writable, write_json
from bms_gateway.errors import DataError, UsageError, counted

EXAMPLE = """\
  bms-gateway replay drive.log --to vcan0
  bms-gateway replay drive.log.gz --to vcan0 --speed max
"""


def arguments(parser: Parser) -> None:
    """Declare the options."""
    parser.option("log", metavar="LOG", help="candump .log, .asc, .blf, .mf4, .trc or .csv, also .gz")
    parser.option("--to", metavar="CHANNEL", required=True, help="SocketCAN interface, such as vcan0")
    parser.option(
        "--speed", metavar="1|max", default="1", help="1 as it was (default), 2 twice as fast, max as fast as it goes"
    )
    parser.option("--json", metavar="FILE", help="write what was done as JSON; - is standard output")


def run(args: argparse.Namespace) -> int:
    """Replay to the end."""
    from bms_gateway.bus.logfile import LogNotes, read_log
    from bms_gateway.bus.replay import SocketCanSender, replay
    from bms_gateway.report.progress import progress

    speed = _speed(args.speed)
    writable({"--json": args.json})
    distinct({"--json": args.json}, [args.log])
    notes = LogNotes()
    batches = read_log(Path(args.log), notes=notes)
    # the first piece is read before the interface is opened, so that a file which is no log is refused without a bus
    first = next(batches, None)
    if first is None:
        raise DataError(f"{args.log}: no data frames in it")
    frames = chain([first], batches)
    sender = SocketCanSender(args.to)
    try:
        with progress(f"{args.log} to {args.to}", None) as advance:
            done = 0.0

            def show(_frames: int, log_s: float) -> None:
                nonlocal done
                advance(log_s - done)
                done = log_s

            played = replay(frames, sender, speed=speed, progress=show)
    finally:
        sender.close()
    if notes.broken:
        number, text = notes.broken_at[0]
        note(f"{args.log}: {notes.broken} damaged lines skipped, the first is line {number}: {text!r}")
    if notes.remote or notes.errors:
        note(f"{args.log}: {notes.remote} remote and {notes.errors} error frames skipped")
    if args.json:
        write_json(args.json, {"log": args.log, "to": args.to, **asdict(played)})
    late = f", at most {played.worst_late_s * 1e3:.1f} ms late" if speed else ""
    say(f"{counted(played.frames, 'frame')}, {played.log_s:.1f} s of log in {played.took_s:.1f} s{late}", args.json)
    return 0


def _speed(text: str) -> float | None:
    """Factor of the log's own speed; None for as fast as the bus takes it."""
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0.0 < speed < float("inf"):
        raise UsageError(f"replay: --speed '{text}': valid: 1 (as it was), another factor above 0, or max")
    return speed
