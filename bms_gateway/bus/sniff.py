"""Finds the kind of a log from its first bytes, for files with a wrong name."""

import re
import zlib
from collections import Counter
from pathlib import Path
from typing import Final

HEAD: Final = 4096  # bytes that are looked at
_CANDUMP = re.compile(rb"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
# candump on a screen: `can0  123   [8]  11 22`, with -t a stamp before it; without -L in a pipe: `can0 123#1122`
_SCREEN = re.compile(rb"(\(\S+( \S+)?\)\s+)?\S+\s+([RT]X\s+\S+\s+\S+\s+)?[0-9A-Fa-f]{3,8}\s+\[\d+\](\s|$)")
_NO_STAMP = re.compile(rb"[A-Za-z]\S*\s+[0-9A-Fa-f]{3,8}#")
_TABLE = re.compile(rb"(\xef\xbb\xbf)?[^\n\x00]*(time_s|current_A|coolant_inlet_C|surface_\d+_C)")
FEWEST_COLUMNS: Final = 3
MOST_TITLES: Final = 5
_STARTS: Final = (
    (b"LOGG", ".blf"),
    (b"MDF     ", ".mf4"),
    (b"date ", ".asc"),
    (b";$FILEVERSION", ".trc"),
    (b"timestamp,arbitration_id,", ".csv"),
)
_SOFTWARE: Final = {".log": "candump", ".asc": "Vector ASC", ".blf": "Vector BLF", ".trc": "PEAK TRC"}


def misnamed(path: Path, kind: str) -> str | None:
    """Find what a file contains if its name is wrong.

    Parameters
    ----------
    path : Path
    kind : str
        Format by its name, such as ".log".

    Returns
    -------
    str or None
        The content and the remedy; None if the name is right, or the content unknown.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    packed = path.suffix.lower() == ".gz"
    with path.open("rb") as file:
        raw = file.read(HEAD)
    if packed and raw and not raw.startswith(b"\x1f\x8b"):
        return "not gzip data: leave .gz out of its name"
    if raw.startswith(b"\x1f\x8b") and not packed:
        return "this is gzip data: end its name with .gz"
    found = kind_of(_unpacked(raw) if packed else raw)
    if found == "screen":
        return "this is candump's output without exact time stamps: record with candump -l or -L"
    if found is None and kind == ".csv" and _is_table(_unpacked(raw) if packed else raw):
        return (
            "this is a table of measurements, no log: encode makes frames of it, and compare, fit and diagnose take it "
            "as it is"
        )
    if found is None or found == kind:
        return None
    what = f"a {_SOFTWARE[found]} log" if found in _SOFTWARE else f"a {found} log"
    return f"this is {what}: name it {found}{'.gz' if packed else ''}"


def _is_table(head: bytes) -> bool:
    """Whether rows of a CSV file are measurements: columns of ours, or names over rows without an identifier (0x…).

    Up to five lines of a title may stand above the names.
    """
    if _TABLE.match(head):
        return True
    wide = head.startswith((b"\xff\xfe", b"\xfe\xff"))
    text = head.decode("utf-16" if wide else "latin-1", errors="replace")
    lines = [line for line in text.splitlines() if line.strip()][:-1]  # the last one may be cut
    if len(lines) < 2 or "\x00" in text:
        return False
    # a comma may be the decimal mark
    mark = next((m for m in ";\t" if any(line.count(m) >= FEWEST_COLUMNS - 1 for line in lines)), ",")
    usual = Counter(line.count(mark) for line in lines).most_common(1)[0][0]
    # lines of fewer fields above the names are titles
    titles = next(k for k, line in enumerate(lines) if line.count(mark) >= usual)
    first = titles if titles <= MOST_TITLES else 0
    names = [name.strip() for name in lines[first].split(mark)]
    named = sum(any(c.isalpha() for c in name) for name in names)
    below = lines[first + 1 : first + 3]
    return bool(below) and named >= FEWEST_COLUMNS and not any("0x" in line for line in below)


def _unpacked(raw: bytes) -> bytes:
    try:
        return zlib.decompressobj(wbits=31).decompress(raw, HEAD)
    except zlib.error:
        return b""


def kind_of(head: bytes) -> str | None:
    """Format that the first bytes of a log belong to: a suffix, "screen" for candump without exact stamps, or None."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    for start, kind in _STARTS:
        if text.startswith(start):
            return kind
    lines = [line.strip() for line in text.splitlines()[:20] if line.strip()]
    if any(map(_CANDUMP.match, lines)):
        return ".log"
    return "screen" if any(_SCREEN.match(x) or _NO_STAMP.match(x) for x in lines) else None
