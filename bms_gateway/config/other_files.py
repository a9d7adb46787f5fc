"""Recognises logs and DBC files that are handed over as a config or a model, by how they begin."""

import re
from pathlib import Path
from typing import Final

HEAD: Final = 4096  # bytes that are looked at
_CANDUMP: Final = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
_DBC: Final = re.compile(r'VERSION\s+"|(NS_|BS_|BU_)\s*:|BO_ \d+ \w+\s*:')
_STARTS: Final = (
    ("LOGG", "a Vector BLF log"),
    ("MDF     ", "an MF4 log"),
    ("date ", "a Vector ASC log"),
    (";$FILEVERSION", "a PEAK TRC log"),
    ("\x1f\x8b", "gzip data"),
)


def other_kind(text: str) -> str | None:
    """Name what a text is, if it is a log or a DBC; None otherwise.

    Examples
    --------
    >>> other_kind('VERSION ""'), other_kind("(1.5) can0 123#11"), other_kind("[bus]")
    ('a DBC', 'a candump log', None)
    """
    text = text.removeprefix("\ufeff").lstrip(" \t\r\n")
    if _CANDUMP.match(text):
        return "a candump log"
    if _DBC.match(text):
        return "a DBC"
    return next((kind for start, kind in _STARTS if text.startswith(start)), None)


def kind_of_file(path: Path) -> str | None:
    """Name what a plain file is, as `other_kind`; None if it cannot be read."""
    try:
        if not path.is_file():  # a pipe can be read only once
            return None
        with path.open("rb") as file:
            return other_kind(file.read(HEAD).decode("latin-1"))
    except OSError:
        return None
