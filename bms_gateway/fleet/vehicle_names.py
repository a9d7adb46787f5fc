"""Finds the vehicle of a log by the name of its file or folder, or by a pattern in its path."""

import re
from pathlib import Path

from bms_gateway.bus.logfile import FORMATS
from bms_gateway.errors import UsageError

FILE, FOLDER = "file", "folder"


def vehicle_of(log: Path, how: str) -> str:
    r"""Name the vehicle of a log.

    Parameters
    ----------
    log : Path
    how : str
        `file`: the file's name without its endings; `folder`: the name of its folder; else a regular expression that is
        searched in the path, whose first group is the name (the whole match without a group).

    Raises
    ------
    UsageError
        No regular expression, or one that finds nothing in this path.

    Examples
    --------
    >>> log = Path("fleet/van-7/2026-05-01.log.gz")
    >>> vehicle_of(log, "file"), vehicle_of(log, "folder"), vehicle_of(log, r"van-(\d+)")
    ('2026-05-01', 'van-7', '7')
    """
    if how == FILE:
        name = log.name
        for ending in (".gz", *FORMATS):
            if name.lower().endswith(ending):
                name = name[: -len(ending)]
        return name or log.name
    if how == FOLDER:
        return log.absolute().parent.name
    try:
        found = re.search(how, log.as_posix())
    except re.error as e:
        raise UsageError(f"--vehicle {how!r}: no regular expression ({e}); valid: file, folder, or one") from None
    if found is None:
        raise UsageError(f"--vehicle {how!r}: finds nothing in {log}; valid: file, folder, or a pattern of its path")
    name = found.group(1) if found.re.groups else found.group(0)
    if not name:
        raise UsageError(f"--vehicle {how!r}: finds an empty name in {log}")
    return name
