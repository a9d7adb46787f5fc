"""Entry of the program: finds the command, loads only its file, and turns every fault of the user into one line.

Exit status: 0 done; 1 the thing checked does not hold; 2 bad usage, config or data; 130 stopped by the user.
"""

import argparse
import errno
import importlib
import io
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, ModuleType
from typing import NoReturn

from bms_gateway import __version__
from bms_gateway.errors import MOST_SHOWN, GatewayError, UsageError, clipped, did_you_mean

PROGRAM = "bms-gateway"
DEFAULT_CONFIG = Path("/etc/bms-gateway/gateway.toml")
"""Where `deploy/install.sh` puts the config."""
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
"""Faults of a disk. They can occur at any byte that a command writes, and are not a bug of the command."""
PATHS = (errno.EACCES, errno.EPERM, errno.ELOOP, errno.ENAMETOOLONG, errno.ENOTDIR, errno.ESTALE)
"""Faults of a path that a person named: the path does not exist, or this user has no access."""

COMMANDS = {
    "demo": "the main job with no hardware: a simulated pack, a live table of its cells, the error against the truth",
    "run": "the service: CAN in, estimates out",
    "init": "from logs and DBC of a new vehicle to a config: which signal is what, and the first cores",
    "doctor": "what this computer lacks to run the gateway, and the command for it",
    "check": "validate a config: DBC, signals, models, observability of each string",
    "analyze": "logged traffic through the same engine, as fast as possible",
    "forecast": "what comes next after a log: cores ahead, time to the limit, permitted currents; and their score",
    "fleet": "many logs: a row per vehicle-day and string, and what the vehicles have in common",
    "replay": "put logged traffic on a bus with its own timing",
    "encode": "bench data as CAN frames by the DBC, so that it can be replayed",
    "export": "the gateway's recent decoded signals as a table, for compare and diagnose",
    "simulate": "drive-cycle traffic of a virtual pack",
    "fit": "batch identification of a string model from measurements",
    "compare": "model against measurement: where, when and in which regime it fails",
    "diagnose": "which physical effect the model lacks",
    "add": "add an effect to a model, refit it, show the error before and after",
    "workbench": "a local page: compare, diagnose, add and watch the error fall; and the live pack",
    "cells": "what is known of a cell before it was measured: thermal parameters with formula and source",
    "effects": "the catalogue of physical effects that a model may lack: equation, parameters, needs, look-alikes",
    "baseline": "the baseline against which growth of R_e is measured; show it, or renew it after a cell was replaced",
    "acknowledge": "end alarms that stay until a person has looked at the string",
    "chaos": "inject faults of bus, sensors and time, and check the reaction of the gateway",
    "reproduce": "the paper's figures and tables beside ours, with its errata; explains the method",
    "completion": "completion for bash, zsh and fish, and a manual page",
    "observability": "how well surface sensors determine the cores: exact rank, the paper's rank, sd of each core",
    "place": "where to put surface sensors so that the least certain core is known best",
}
"""Each command and what it does. The file of the same name in this room has `arguments(parser)`, `run(args) -> int` and
`EXAMPLE`. It imports large modules inside `run`, so that help and errors come at once."""


class Parser(argparse.ArgumentParser):
    """Argument parser with error lines of this program, which name the nearest valid option."""

    def __init__(self, name: str, summary: str, example: str) -> None:
        super().__init__(
            prog=f"{PROGRAM} {name}",
            description=f"{summary[0].upper()}{summary[1:]}.",
            epilog=f"example:\n{example.strip(chr(10)).rstrip()}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        self.options: list[str] = ["--help"]

    def option(self, *names: str, **how: object) -> None:
        """Add an option or argument; its name is remembered for "did you mean"."""
        self.options += [name for name in names if name.startswith("--")]
        self.add_argument(*names, **how)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing the usage."""
        raise UsageError(f"{self.prog.removeprefix(PROGRAM).strip()}: {message} (see {self.prog} --help)")

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Parse; an unknown option is reported first, because others then seem to be missing."""
        for word in words:
            name = word.split("=")[0]
            if name == "--":
                break
            if name.startswith("--") and name not in self.options:
                self.error(f"unknown option '{name}'{did_you_mean(name, self.options)}")
        known, spare = self.parse_known_args(words)
        if spare:
            self.error(f"one argument too many: '{spare[0]}'")
        return known


def main(words: Sequence[str] | None = None) -> int:
    """Run the program.

    Parameters
    ----------
    words : sequence of str, optional
        Command line without the program's name; default `sys.argv[1:]`.

    Returns
    -------
    int
        Exit status.
    """
    # Set before numpy is loaded: on matrices of a dozen rows, threads cost ten times what they gain
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _open_standard_streams()
    try:
        with _ended_by_signals():
            status = _dispatch(list(sys.argv[1:] if words is None else words))
            sys.stdout.flush()
    except GatewayError as e:
        print(f"{PROGRAM}: error: {' '.join(str(e).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{PROGRAM}: stopped", file=sys.stderr)
        return 130
    except _EndedError as e:
        os.kill(os.getpid(), e.number)  # end by the signal itself, as the shell and systemd expect
        return 128 + e.number
    except BrokenPipeError:
        _drop_output()  # the reader of a pipe has closed it
        return 141
    except OSError as e:
        told = _fault_of_a_file(e)
        if told is None:
            raise
        print(f"{PROGRAM}: error: {told}", file=sys.stderr)
        _drop_output()
        return 2
    return status


def _fault_of_a_file(e: OSError) -> str | None:
    """Turn an `OSError` about a file into one line; None if it names no file, because it is then a bug."""
    named = isinstance(e.filename, str | bytes)
    where = f"{clipped(' '.join(os.fsdecode(e.filename).split()), MOST_SHOWN)}: " if named else ""
    if e.errno in DISK:
        return f"{where}a result cannot be written: {e.strerror}"
    return f"{where}cannot be used: {e.strerror}" if named and e.errno in PATHS else None


_TAKE_ALL = (("utf-8", "surrogateescape"), ("utf-8", "backslashreplace"))


class _EndedError(BaseException):
    """A signal that asks for the end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Let the command clean up after SIGTERM or SIGHUP, as it does after Ctrl-C."""

    def end(number: int, _: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)  # a second signal ends the program at once
        raise _EndedError(number)

    before: dict[signal.Signals, signal.Handlers] = {}
    with suppress(ValueError):  # not the main thread: the caller handles the signals
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, end)
                before[number] = signal.SIG_DFL
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _open_standard_streams() -> None:
    """Make standard output and error accept every text, whatever their encoding, and even if they are closed."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, io.TextIOWrapper(io.FileIO(os.devnull, "w"), "utf-8"))
        elif isinstance(stream, io.TextIOWrapper) and (stream.encoding, stream.errors) not in _TAKE_ALL:
            stream.reconfigure(errors="backslashreplace")


def _drop_output() -> None:
    """Drop all further standard output: otherwise Python would write at the end, and report an error."""
    with suppress(OSError, ValueError):  # standard output was replaced by an object without a descriptor
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage())
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        print(f"{PROGRAM} {__version__}")
        return 0
    name, *rest = words
    if name not in COMMANDS:
        option = name.startswith("-")
        known = ("--help", "--version") if option else tuple(COMMANDS)
        kind = "option" if option else "command"
        raise UsageError(f"unknown {kind} '{name}'{did_you_mean(name, known)} (see {PROGRAM} --help)")
    module: ModuleType = importlib.import_module(f"bms_gateway.cli.{name}")
    parser = Parser(name, COMMANDS[name], module.EXAMPLE)
    module.arguments(parser)
    try:
        args = parser.parse(rest)
    except SystemExit as e:  # --help has printed everything
        return int(e.code or 0)
    status: int = module.run(args)
    return status


def usage() -> str:
    """Text of `--help`: every command with its summary."""
    width = max(map(len, COMMANDS))
    lines = [f"usage: {PROGRAM} COMMAND [options]", "", "Core temperatures of battery cells from CAN traffic.", ""]
    lines += [f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items()]
    lines += ["", f"{PROGRAM} COMMAND --help shows its options, with an example.", "", "example:"]
    lines += [f"  {PROGRAM} check gateway.toml"]
    return "\n".join(lines)
