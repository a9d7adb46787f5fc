"""Output of commands: text for people goes to standard output, unless JSON goes there."""

import importlib.util
import io
import json
import os
import shlex
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bms_gateway.cli.main import PROGRAM
from bms_gateway.errors import MissingExtraError, UsageError
from bms_gateway.whole import whole


def say(text: str, json_target: str | None = None) -> None:
    """Print text for people; on standard error if JSON goes to standard output."""
    print(text, file=sys.stderr if json_target == "-" else sys.stdout)


def note(text: str) -> None:
    """Print a remark that is not part of the result."""
    print(f"bms-gateway: note: {text}", file=sys.stderr)


def distinct(outputs: Mapping[str, Path | str | None], inputs: Iterable[Path | str]) -> None:
    """Refuse an output that would destroy a file that is read, or another output.

    Parameters
    ----------
    outputs : mapping of option to path
        Such as ``{"--out": "drive.log"}``; None and "-" (standard output) are ignored.
    inputs : iterable of path
        Every file that the command reads.

    Raises
    ------
    UsageError
        Two of them are the same file, by name, by a link or otherwise.
    """
    read = [Path(p) for p in inputs]
    seen: list[tuple[str, Path]] = []
    for option, given in outputs.items():
        if given is None or str(given) == "-":
            continue
        path = Path(given)
        if any(_same(path, p) for p in read):
            raise UsageError(f"{option} {path}: this file is read by the command; write to another name")
        other = next((name for name, p in seen if _same(path, p)), None)
        if other is not None:
            raise UsageError(f"{option} {path}: {other} writes to the same file; give each its own name")
        seen.append((option, path))


def _same(a: Path, b: Path) -> bool:
    """Whether two paths are one file; devices and pipes are no files that could be destroyed."""
    try:
        if a.exists():
            return a.is_file() and a.samefile(b)
    except OSError:  # the other file does not exist, or its folder may not be entered
        pass
    return os.path.realpath(a) == os.path.realpath(b)


def writable(outputs: Mapping[str, Path | str | None]) -> None:
    """Check before the work whether the results can be written.

    Raises
    ------
    UsageError
        Names the option and the reason.
    """
    for option, given in outputs.items():
        if given is None or str(given) == "-":
            continue
        try:
            reason = _hindrance(Path(given))
        except OSError as e:
            reason = e.strerror
        if reason:
            raise UsageError(f"{option} {given}: cannot be written: {reason}")


def folder_for(command: str, given: Path | str, what: str) -> Path:
    """Return the folder of `--out` for results, checked before the work: no file may be in its place.

    Parameters
    ----------
    command : str
        For the error line.
    given : Path or str
        As the user gives it; the folder need not exist.
    what : str
        What is written there, for the error line.

    Raises
    ------
    UsageError
        It is empty, or it or a part of its path is a file.
    """
    if not str(given):
        raise UsageError(f"{command}: --out is empty; name a folder for {what}")
    path = Path(given)
    for part in (path, *path.parents):
        try:
            if part.exists() and not part.is_dir():
                where = "" if part == path else f" {part}"
                raise UsageError(f"--out {given}:{where} is a file; name a folder for {what}")
        except OSError as e:
            raise UsageError(f"--out {given}: cannot be written: {e.strerror}") from None
    return path


def _hindrance(path: Path) -> str | None:
    if path.is_dir():
        return "is a directory; name a file"
    if not path.parent.is_dir():
        return f"{path.parent} is a file, no folder" if path.parent.exists() else f"no such folder: {path.parent}"
    # a plain file is replaced, so only its folder must be writable
    place = path.parent if path.is_file() or not path.exists() else path
    return None if os.access(place, os.W_OK) else "permission denied"


def write_json(target: str, document: Mapping[str, Any]) -> None:
    """Write a result for machines to a file, which is complete or not written at all, or to standard output for `-`.

    Raises
    ------
    UsageError
        The file cannot be written.
    """
    text = json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # the name of a file need not be valid text; this makes valid JSON of it
    raw = text.encode("utf-8", "backslashreplace")
    if target == "-":
        _put_out(raw)
        return
    try:
        with whole(Path(target)) as file:
            file.write(raw)
    except OSError as e:
        raise UsageError(f"--json {target}: cannot be written: {e.strerror}") from None


def _put_out(raw: bytes) -> None:
    """Write JSON to standard output, always in UTF-8, whatever the encoding of the terminal."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.flush()
        sys.stdout.buffer.write(raw)
    else:
        sys.stdout.write(raw.decode())


def needs_plotly(what: str = "--html", extra: str = "report") -> None:
    """Refuse to make a page, before the work, if the extra that draws it is missing.

    Raises
    ------
    MissingExtraError
    """
    if importlib.util.find_spec("plotly") is None:
        raise MissingExtraError(what, extra)


def command_line(name: str) -> str:
    """Return the command line as it was typed, for a page that shows how it was made."""
    words = sys.argv[1:]
    return shlex.join([PROGRAM, *words]) if words[:1] == [name] else ""
